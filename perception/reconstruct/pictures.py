"""A survey picture with its pose, as reconstruction sees it."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path

import cv2
import msgspec
import numpy as np
from numpy.typing import NDArray

from missions.camera import Camera, Pose
from missions.errors import UserError
from missions.frames import Array, yaw_elevation_from_forward


@dataclass(frozen=True)
class SurveyPicture:
    """One picture: `camera` holds the intrinsics at the file's own resolution."""

    view_id: int
    path: Path
    camera: Camera
    enu_from_camera: Array
    position_enu_m: Array

    @property
    def forward_enu(self) -> Array:
        """(3,) unit optical axis."""
        return np.asarray(self.enu_from_camera[:, 2])

    @property
    def pose(self) -> Pose:
        """The same pose by its angles, without roll."""
        e, n, u = (float(c) for c in self.position_enu_m)
        return Pose((e, n, u), *yaw_elevation_from_forward(self.forward_enu))

    def camera_at(self, width_px: int) -> Camera:
        """Intrinsics of the picture when it is reduced to this width."""
        height_px = round(self.camera.height_px * width_px / self.camera.width_px)
        return self.camera.scaled(width_px, height_px)


def read_stored(picture: SurveyPicture) -> NDArray[np.uint8]:
    """(height, width, 3) BGR as in the file. Raises UserError when the file is missing or no such picture."""
    data = cv2.imread(str(picture.path), cv2.IMREAD_COLOR)
    if data is None:
        raise UserError(f"{picture.path}: not a readable picture; fly again or remove its row from views.csv.")
    expected = (picture.camera.height_px, picture.camera.width_px)
    if data.shape[:2] != expected:
        raise UserError(f"{picture.path}: {data.shape[1]}x{data.shape[0]} pixels where camera.survey_px says "
                        f"{expected[1]}x{expected[0]}; correct camera.survey_px in mission.toml.")
    return np.asarray(data)


def read_colour(picture: SurveyPicture, width_px: int) -> NDArray[np.uint8]:
    """(height, width_px, 3) RGB, reduced by area averaging. Raises UserError when the file is missing or no picture."""
    data = read_stored(picture)
    camera = picture.camera_at(width_px)
    reduced = cv2.resize(data, (camera.width_px, camera.height_px), interpolation=cv2.INTER_AREA)
    return np.ascontiguousarray(reduced[:, :, ::-1])


def grey(colour: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """(height, width) luma of an RGB picture."""
    return np.asarray(cv2.cvtColor(colour, cv2.COLOR_RGB2GRAY))


def picture_key(pictures: list[SurveyPicture]) -> str:
    """Hash of pictures, intrinsics and poses."""
    digest = hashlib.sha256()
    for p in pictures:
        digest.update(f"{p.view_id} {p.path.stat().st_size if p.path.is_file() else 0}".encode())
        digest.update(msgspec.json.encode(p.camera))
        digest.update(np.ascontiguousarray(p.enu_from_camera).tobytes() + np.asarray(p.position_enu_m).tobytes())
    return digest.hexdigest()


def require_enough(pictures: list[SurveyPicture]) -> None:
    """Raises UserError when there are fewer than three."""
    if len(pictures) < 3:
        raise UserError(f"views.csv: {len(pictures)} survey pictures, and a reconstruction needs at least 3; "
                        "raise survey.max_views or look in flight.json why views were not flown.")
