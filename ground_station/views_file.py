"""Survey views from a CSV file: view_id, east_m, north_m, up_m and either qw, qx, qy, qz or yaw_deg, elevation_deg."""

from __future__ import annotations

import csv
import math
from pathlib import Path

import numpy as np

from ground_station.csv_table import read_table
from missions.camera import Pose, View
from missions.errors import UserError
from missions.frames import matrix_from_quaternion, wrap_pi, yaw_elevation_from_forward
from missions.mission_file import MISSIONS_FOLDER

QUATERNION = ("qw", "qx", "qy", "qz")
ANGLES = ("yaw_deg", "elevation_deg")
PLACE = ("east_m", "north_m", "up_m")


def read_views(path: Path) -> list[View]:
    """The views of a file, in its order; a relative path that is not there is looked for beside the missions that come
    with swarmscan. Quaternions are enu_from_camera, yaw is counter-clockwise from East; roll is dropped.

    Raises UserError naming file, line and remedy.
    """
    if not path.is_file() and (MISSIONS_FOLDER / path).is_file():
        path = MISSIONS_FOLDER / path
    rows, columns = read_table(path, "survey.views_path")
    missing = [c for c in ("view_id", *PLACE) if c not in columns]
    if missing or not (columns.issuperset(QUATERNION) or columns.issuperset(ANGLES)):
        raise UserError(f"survey.views_path {path}: columns {', '.join(missing) or 'of orientation'} are missing; add "
                        f"them ({', '.join(QUATERNION)} or {', '.join(ANGLES)} for orientation).")
    views = [_view(path, n, row) for n, row in enumerate(rows, start=2)]
    seen: set[int] = set()
    for n, view in enumerate(views, start=2):
        if view.view_id in seen:
            raise UserError(f"survey.views_path {path}: line {n}: view_id {view.view_id} occurs twice; number it anew.")
        seen.add(view.view_id)
    if not views:
        raise UserError(f"survey.views_path {path}: holds no views; add some.")
    return views


def write_views(poses: list[Pose], path: Path) -> Path:
    """Write views with yaw and elevation, numbered from 1; returns the path."""
    with path.open("w", newline="", encoding="utf-8") as f:
        writer = csv.writer(f)
        writer.writerow(("view_id", *PLACE, *ANGLES))
        for number, pose in enumerate(poses, start=1):
            angles = (math.degrees(pose.yaw_enu_rad), math.degrees(pose.elevation_rad))
            writer.writerow([number, *(f"{v:.6f}" for v in (*pose.position_enu_m, *angles))])
    return path


def _view(path: Path, line: int, row: dict[str, str]) -> View:
    try:
        east, north, up = (float(row[c]) for c in PLACE)
        if row.get(QUATERNION[0]):
            quaternion = np.array([float(row[c]) for c in QUATERNION])
            yaw, elevation = yaw_elevation_from_forward(matrix_from_quaternion(quaternion)[:, 2])
        else:
            yaw, elevation = (math.radians(float(row[c])) for c in ANGLES)
        view_id = int(row["view_id"])
    except (TypeError, ValueError) as e:
        raise UserError(f"survey.views_path {path}: line {line}: {e}; write numbers there.") from e
    if not all(map(math.isfinite, (east, north, up, yaw, elevation))) or abs(elevation) > math.pi / 2 + 1e-9:
        raise UserError(f"survey.views_path {path}: line {line}: not a finite view with an elevation in ±90°; mend it.")
    return View(view_id, Pose((east, north, up), wrap_pi(yaw), elevation))
