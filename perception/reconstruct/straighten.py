"""Survey pictures without the distortion of their lens, which is what everything after alignment works on."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from pathlib import Path

import cv2

from missions.errors import UserError
from perception.lens import redrawn
from perception.reconstruct.optics import Optics
from perception.reconstruct.pictures import SurveyPicture, read_stored
from perception.reconstruct.settings import Progress

JPEG_QUALITY = 98


def straightened(pictures: list[SurveyPicture], optics: Optics, folder: Path,
                 progress: Progress = lambda stage, done, total: None) -> list[SurveyPicture]:
    """The pictures as a pinhole of the same focal length would have taken them, in the folder; those that are there
    already are not drawn again. The pictures themselves where they are a pinhole's.

    Raises UserError when one cannot be read or written.
    """
    if optics == Optics(pictures[0].camera):
        return pictures
    folder.mkdir(parents=True, exist_ok=True)
    lens = hashlib.sha256(repr(optics).encode()).hexdigest()[:8]
    straight = []
    for picture in pictures:
        found = replace(picture, path=folder / f"{picture.path.stem}-{lens}.jpg", camera=optics.pinhole)
        if not found.path.is_file():
            _draw(picture, optics, found.path)
        straight.append(found)
        progress("straighten", len(straight), len(pictures))
    for old in set(folder.glob("*.jpg")) - {p.path for p in straight}:
        old.unlink()
    return straight


def _draw(picture: SurveyPicture, optics: Optics, path: Path) -> None:
    drawn = redrawn(read_stored(picture), optics.camera, optics.lens, optics.pinhole)
    unfinished = path.with_name(f"part-{path.name}")
    if not cv2.imwrite(str(unfinished), drawn, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY]):
        raise UserError(f"{path}: cannot be written; free some disk space.")
    unfinished.replace(path)
