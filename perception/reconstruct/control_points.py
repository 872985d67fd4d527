"""Points whose place somebody has surveyed and whose image somebody has marked in pictures.

Control points hold a bundle adjustment: their places do not move. Check points only say how good the result is.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pycolmap

from missions.frames import Array
from missions.lens import pixels
from perception.reconstruct.optics import Optics

LEAST_MARKS = 2
LEAST_CONTROL = 3
STEPS = 10


@dataclass(frozen=True)
class ControlPoint:
    """place_enu_m (3,). marks: where it is seen, (x, y) in pixels of the file, by picture's number."""

    name: str
    place_enu_m: Array
    check: bool
    marks: dict[int, Array]


@dataclass(frozen=True)
class Found:
    """Where the pictures put a point, what that differs from its place, and how far marks are from where it should be
    seen; None where fewer than LEAST_MARKS of its pictures are known."""

    point: ControlPoint
    pictures: int
    position_enu_m: Array | None
    error_px: float | None

    @property
    def row(self) -> dict[str, Any]:
        """For people and programs: errors East, North, Up and in all, metres."""
        role = "check" if self.point.check else "control"
        row: dict[str, Any] = {"name": self.point.name, "role": role, "pictures": self.pictures,
                               "error_enu_m": None, "error_m": None, "error_px": self.error_px}
        if self.position_enu_m is not None:
            error = self.position_enu_m - self.point.place_enu_m
            row |= {"error_enu_m": error.tolist(), "error_m": float(np.linalg.norm(error))}
        return row


def find(points: list[ControlPoint], model: pycolmap.Reconstruction) -> list[Found]:
    """Each point from its marks alone, at the model's poses: least squares of the reprojection. Picture i is image
    i + 1."""
    return [_find(p, model) for p in points]


def hold(model: pycolmap.Reconstruction, points: list[ControlPoint]) -> list[int]:
    """Put the control points into the model, with their marks as observations; returns their ids, to be held constant.

    The model has to lie where they are already.
    """
    held = []
    for point in points:
        seen = [i for i in point.marks if model.exists_image(i + 1) and model.image(i + 1).has_pose]
        if point.check or len(seen) < LEAST_MARKS:
            continue
        track = pycolmap.Track()
        for i in seen:
            image = model.image(i + 1)
            image.points2D.append(pycolmap.Point2D(point.marks[i]))
            track.add_element(i + 1, image.num_points2D() - 1)
        held.append(model.add_point3D(point.place_enu_m, track))
    return held


def similarity(found: list[Found]) -> pycolmap.Sim3d | None:
    """What carries the control points from where they were found to where they are; None with too few, or in a row."""
    control = [(f.position_enu_m, f.point.place_enu_m) for f in found
               if not f.point.check and f.position_enu_m is not None]
    if len(control) < LEAST_CONTROL:
        return None
    source, target = (np.array(v) for v in zip(*control, strict=True))
    extent = np.linalg.svd(target - target.mean(axis=0))[1].tolist()
    return pycolmap.estimate_sim3d(source, target) if extent[1] > 0.01 * extent[0] else None


def _find(point: ControlPoint, model: pycolmap.Reconstruction) -> Found:
    seen = [i for i in point.marks if model.exists_image(i + 1) and model.image(i + 1).has_pose]
    if len(seen) < LEAST_MARKS:
        return Found(point, len(seen), None, None)
    optics = [Optics.of(model.camera(model.image(i + 1).camera_id)) for i in seen]
    ideal = np.array([o.ideal(point.marks[i][None].astype(np.float32))[0] for i, o in zip(seen, optics, strict=True)],
                     np.float64)
    poses = np.array([model.image(i + 1).cam_from_world().matrix() for i in seen])
    k = np.array([o.camera.matrix for o in optics])
    position = _triangulated(k @ poses, ideal)
    local = poses[:, :, :3] @ position + poses[:, :, 3]
    shown = np.array([pixels(p[:2] / p[2], o.camera) for p, o in zip(local, optics, strict=True)])
    return Found(point, len(seen), position, float(np.linalg.norm(shown - ideal, axis=1).mean()))


def _triangulated(projection: Array, seen_px: Array) -> Array:
    """(3,) by Gauss-Newton on the reprojection, from the linear solution. projection (n, 3, 4), seen_px (n, 2)."""
    rows = (seen_px[:, :, None] * projection[:, None, 2] - projection[:, :2]).reshape(-1, 4)
    rows = rows / np.linalg.norm(rows, axis=1, keepdims=True)
    position = np.asarray(np.linalg.lstsq(rows[:, :3], -rows[:, 3], rcond=None)[0])
    for _ in range(STEPS):
        at = projection[:, :, :3] @ position + projection[:, :, 3]
        off = at[:, :2] / at[:, 2:] - seen_px
        slope = (projection[:, :2, :3] - (at[:, :2] / at[:, 2:])[:, :, None] * projection[:, 2:, :3]) / at[:, 2:, None]
        position = position - np.linalg.lstsq(slope.reshape(-1, 3), off.ravel(), rcond=None)[0]
    return np.asarray(position)
