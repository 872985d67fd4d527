"""What alignment leaves in its folder.

poses.csv         one row per picture: `AlignedPose`
alignment.json    `Alignment.numbers`, and the key of what it was made from
cameras.txt, images.txt, points3D.txt
                  the same poses and the points as a COLMAP text model; world coordinates are ENU metres
"""

from __future__ import annotations

import csv
import json
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from missions.frames import Array, matrix_from_quaternion, quaternion_from_matrix
from perception.reconstruct.bundle import Adjusted
from perception.reconstruct.colmap_model import write_model
from perception.reconstruct.optics import Optics
from perception.reconstruct.pictures import SurveyPicture


class AlignedPose(msgspec.Struct, frozen=True):
    """The pose of a picture to go on with: position in ENU metres, quaternion of enu_from_camera."""

    view_id: int
    east_m: float
    north_m: float
    up_m: float
    qw: float
    qx: float
    qy: float
    qz: float
    state: str
    """"aligned", or why the measured pose was kept."""
    group: int
    """Pictures that share points; 0 is the largest group."""
    points: int
    """Points seen."""
    moved_m: float
    turned_deg: float

    @classmethod
    def of(cls, picture: SurveyPicture, state: str, group: int, points: int, moved_m: float,
           turned_deg: float) -> AlignedPose:
        """A row, numbers rounded as they are written."""
        east, north, up = (round(float(v), 9) for v in picture.position_enu_m)
        qw, qx, qy, qz = (round(float(v), 9) for v in quaternion_from_matrix(picture.enu_from_camera))
        return cls(picture.view_id, east, north, up, qw, qx, qy, qz, state, group, points, round(moved_m, 6),
                   round(turned_deg, 6))

    @property
    def position_enu_m(self) -> Array:
        """(3,)"""
        return np.array([self.east_m, self.north_m, self.up_m])

    @property
    def enu_from_camera(self) -> Array:
        """(3, 3) rotation."""
        return matrix_from_quaternion(np.array([self.qw, self.qx, self.qy, self.qz]))

    @property
    def trusted(self) -> bool:
        """Whether it was aligned together with most others."""
        return self.state == "aligned" and self.group == 0

    def applied(self, picture: SurveyPicture) -> SurveyPicture:
        """The picture with this pose."""
        return replace(picture, enu_from_camera=self.enu_from_camera, position_enu_m=self.position_enu_m)


@dataclass(frozen=True)
class Alignment:
    """Pictures with their aligned poses, the rows that say how they came by them, and all of it in numbers."""

    pictures: list[SurveyPicture]
    poses: list[AlignedPose]
    numbers: dict[str, Any]

    @property
    def optics(self) -> Optics:
        """The camera that the poses go with."""
        return Optics.from_numbers(self.numbers["camera"])


def write_alignment(folder: Path, key: str, pictures: list[SurveyPicture], poses: list[AlignedPose],
                    found: Adjusted) -> None:
    """All files; alignment.json last, so that an interrupted run leaves nothing that is taken for whole."""
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / "poses.csv").open("w", newline="", encoding="utf-8") as f:
        writer = csv.writer(f)
        writer.writerow(AlignedPose.__struct_fields__)
        writer.writerows(msgspec.structs.astuple(p) for p in poses)
    write_model(folder, [p.applied(q) for p, q in zip(poses, pictures, strict=True)], found)
    document = {"key": key, **_numbers(poses, found)}
    (folder / "alignment.json").write_text(json.dumps(document, indent=1), encoding="utf-8")


def read_alignment(folder: Path, pictures: list[SurveyPicture], key: str) -> Alignment | None:
    """What write_alignment left for the same key, else None."""
    numbers = alignment_numbers(folder)
    if numbers is None or numbers["key"] != key:
        return None
    poses = read_poses(folder)
    return Alignment([p.applied(q) for p, q in zip(poses, pictures, strict=True)], poses, numbers)


def read_poses(folder: Path) -> list[AlignedPose]:
    """The rows of poses.csv."""
    with (folder / "poses.csv").open(newline="", encoding="utf-8") as f:
        return [msgspec.convert(row, AlignedPose, strict=False) for row in csv.DictReader(f)]


def alignment_numbers(folder: Path) -> dict[str, Any] | None:
    """The content of alignment.json; None when nothing was aligned."""
    path = folder / "alignment.json"
    if not path.is_file():
        return None
    numbers: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return numbers


def _numbers(poses: list[AlignedPose], found: Adjusted) -> dict[str, Any]:
    aligned = [p for p in poses if p.state == "aligned"]
    moved, turned = ([getattr(p, name) for p in aligned] or [0.0] for name in ("moved_m", "turned_deg"))
    error = found.error_px()
    return {
        "pictures": len(poses), "registered": len(aligned), "registered_share": len(aligned) / len(poses),
        "kept": {str(p.view_id): p.state for p in poses if p.state != "aligned"},
        "groups": sorted(Counter(p.group for p in aligned).values(), reverse=True),
        "camera": found.optics.numbers, "control_points": [c.row for c in found.control],
 "points": len(found.points_enu_m), "observations": len(error),
        "reprojection_px": float(error.mean()) if len(error) else None,
        "moved_mean_m": float(np.mean(moved)), "moved_max_m": float(np.max(moved)),
        "turned_mean_deg": float(np.mean(turned)), "turned_max_deg": float(np.max(turned)),
    }
