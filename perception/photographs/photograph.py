"""A photograph in a folder: its file, what it says of itself, and whether it is fit for use."""

from __future__ import annotations

import hashlib
import os
import warnings
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import UnidentifiedImageError

from missions.errors import UserError
from missions.frames import Array, enu_from_camera, yaw_enu_from_heading_deg
from perception.photographs.metadata import Metadata, read_metadata
from perception.photographs.pixels import LARGEST_PX, decoded
from perception.photographs.quality import Look, look_at

READABLE = (".jpg", ".jpeg", ".jpe", ".mpo", ".png", ".tif", ".tiff", ".bmp", ".webp", ".jp2")
TO_CONVERT = (".heic", ".heif", ".dng", ".cr2", ".cr3", ".nef", ".arw", ".raw", ".orf", ".rw2", ".raf", ".pef", ".srw",
              ".avif", ".jxl", ".gif", ".mp4", ".mov", ".mkv", ".avi", ".insp", ".insv", ".rjpeg")
LEAST_PX = 240
STORED_FROM_UPRIGHT = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""Camera axes before from after a quarter turn clockwise of the picture."""

Tell = Callable[[int, int], None]


@dataclass(frozen=True)
class Photograph:
    """name: path inside the folder, with slashes. metadata and look are None for a file that cannot be read."""

    name: str
    path: Path
    sha256: str
    metadata: Metadata | None
    look: Look | None
    fault: str = ""
    """Why the file cannot be used at all."""

    @property
    def size_px(self) -> tuple[int, int]:
        """(width, height) of the stored pixels."""
        assert self.metadata is not None
        return self.metadata.width_px, self.metadata.height_px

    @property
    def enu_from_stored(self) -> Array | None:
        """(3, 3) how the gimbal says that the camera was turned, axes of the stored pixels."""
        m = self.metadata
        if m is None or m.gimbal_deg is None:
            return None
        yaw, pitch, roll = m.gimbal_deg
        upright = enu_from_camera(yaw_enu_from_heading_deg(yaw), np.radians(pitch), np.radians(roll))
        return np.asarray(upright @ np.linalg.matrix_power(STORED_FROM_UPRIGHT, m.upright_turn_deg // 90).T)

    @property
    def row(self) -> dict[str, Any]:
        """For people and programs."""
        m, look = self.metadata, self.look
        known: dict[str, Any] = {"name": self.name}
        if m is not None:
            known |= {"width_px": m.width_px, "height_px": m.height_px, "camera": f"{m.make} {m.model}".strip(),
                      "taken": m.taken, "gps": m.placed, "focal_px": m.focal_px}
        if look is not None:
            known |= {"blur": round(look.blur, 3), "brightness": round(look.brightness, 1),
                      "contrast": round(look.contrast, 1), "clipped_share": round(look.clipped, 3)}
        return known


def photographs_in(folder: Path, threads: int, tell: Tell = lambda done, total: None) -> list[Photograph]:
    """Every picture in the folder and below it, by name, those that cannot be used with their faults.

    Raises UserError when there is none.
    """
    paths = sorted(p for p in folder.rglob("*") if p.suffix.lower() in (*READABLE, *TO_CONVERT) and p.is_file()
                   and not any(part.startswith(".") for part in p.relative_to(folder).parts))
    if not paths:
        raise UserError(f"{folder}: holds no pictures ({', '.join(READABLE)}); give the folder that they are in.")
    found = []
    with warnings.catch_warnings(), ThreadPoolExecutor(threads) as pool:
        warnings.simplefilter("ignore")  # Pillow's, of EXIF that is damaged here and there
        for photograph in pool.map(lambda path: _photograph(path, folder), paths):
            found.append(photograph)
            tell(len(found), len(paths))
    return found


def _photograph(path: Path, folder: Path) -> Photograph:
    name = os.fsencode(path.relative_to(folder).as_posix()).decode("utf-8", "replace")
    if path.suffix.lower() in TO_CONVERT:
        return Photograph(name, path, "", None, None, f"{path.suffix} is not read: convert it to JPEG, TIFF or PNG")
    try:
        sha256 = hashlib.sha256(path.read_bytes()).hexdigest()
        metadata = read_metadata(path)
        if fault := _fault(metadata):
            return Photograph(name, path, sha256, metadata, None, fault)
        return Photograph(name, path, sha256, metadata, look_at(path))
    except UnidentifiedImageError:
        return Photograph(name, path, "", None, None, "cannot be read: not a picture, whatever its name says")
    except Exception as e:  # Pillow's decoders raise whatever a damaged file makes them raise
        return Photograph(name, path, "", None, None, f"cannot be read: {e}")


def _fault(metadata: Metadata) -> str:
    """Why a picture is of no use, whatever it shows."""
    width, height = metadata.width_px, metadata.height_px
    if min(width, height) < LEAST_PX:
        return f"smaller than {LEAST_PX} pixels"
    if width * height > LARGEST_PX:
        return f"larger than {LARGEST_PX // 1_000_000} million pixels: a mosaic, not a photograph"
    if metadata.panorama:
        return "a panorama: put together from pictures of several directions"
    return ""


def read_pixels(photograph: Photograph) -> NDArray[np.uint8]:
    """(height, width, 3) BGR as stored. Raises UserError when the file has gone or changed since it was looked at."""
    try:
        pixels = decoded(photograph.path)
    except Exception as e:  # as above
        raise UserError(f"{photograph.path}: cannot be read any more ({e}); put the file back or remove it, and start "
                        "again.") from e
    if pixels.shape[1::-1] != photograph.size_px:
        raise UserError(f"{photograph.path}: was {photograph.size_px[0]}x{photograph.size_px[1]} pixels and has "
                        "changed; put the file back or remove it, and start again.")
    return pixels


def camera_groups(photographs: Iterable[Photograph]) -> dict[tuple[Any, ...], list[int]]:
    """Indices of photographs that one camera with one focal length took, by order of appearance.

    What says nothing of its camera is told apart by its size alone.
    """
    groups: dict[tuple[Any, ...], list[int]] = {}
    for i, p in enumerate(photographs):
        m = p.metadata
        assert m is not None
        focal = None if m.focal_px is None else round(m.focal_px / max(p.size_px), 2)
        groups.setdefault((m.make, m.model, *p.size_px, focal), []).append(i)
    return groups
