"""Camera poses as Blender has them: location, and XYZ Euler angles of a camera that looks along its own -z, y up.

Blender's world is right-handed with z up, as ours: only the camera's axes differ (thesis, sections 3.4 and 4.3.2). Our
cameras do not roll, so their second angle is 0.
"""

from __future__ import annotations

import csv
import math
from pathlib import Path

import numpy as np

from missions.camera import Pose
from missions.errors import UserError
from missions.frames import Array, wrap_pi, yaw_elevation_from_forward

COLUMNS = ("name", "location_x", "location_y", "location_z", "rotation_x", "rotation_y", "rotation_z")
"""Metres and radians, as `camera.location` and `camera.rotation_euler` take them."""


def euler_from_pose(pose: Pose) -> tuple[float, float, float]:
    """`rotation_euler` (XYZ, radians) of a pose."""
    return pose.elevation_rad + math.pi / 2.0, 0.0, wrap_pi(pose.yaw_enu_rad - math.pi / 2.0)


def matrix_from_euler(euler_rad: tuple[float, float, float]) -> Array:
    """(3, 3) world from camera of XYZ Euler angles: first about x, then y, then z."""
    out = np.eye(3)
    for axis, angle in enumerate(euler_rad):
        c, s = math.cos(angle), math.sin(angle)
        a, b = (axis + 1) % 3, (axis + 2) % 3
        turn = np.eye(3)
        turn[[a, b], [a, b]], turn[a, b], turn[b, a] = c, -s, s
        out = turn @ out
    return out


def pose_from_blender(location: tuple[float, float, float], euler_rad: tuple[float, float, float]) -> Pose:
    """The pose of a Blender camera; roll is dropped. Straight up or down, yaw is where the picture's top or bottom
    points."""
    world_from_camera = matrix_from_euler(euler_rad)
    forward, up = -world_from_camera[:, 2], world_from_camera[:, 1]
    yaw, elevation = yaw_elevation_from_forward(forward)
    if math.hypot(forward[0], forward[1]) < 1e-9:
        yaw = math.atan2(-forward[2] * up[1], -forward[2] * up[0])
    return Pose(location, yaw, elevation)


def write_blender(poses: list[Pose], path: Path) -> None:
    """One camera per row, named View_1 and so on."""
    with path.open("w", newline="", encoding="utf-8") as f:
        writer = csv.writer(f)
        writer.writerow(COLUMNS)
        for number, pose in enumerate(poses, start=1):
            writer.writerow([f"View_{number}", *(f"{v:.9f}" for v in (*pose.position_enu_m, *euler_from_pose(pose)))])


def read_blender(path: Path) -> list[Pose]:
    """The poses of a file as `write_blender` leaves it. Raises UserError naming the line."""
    try:
        with path.open(newline="", encoding="utf-8") as f:
            rows = list(csv.DictReader(f))
    except (OSError, UnicodeDecodeError, csv.Error) as e:
        raise UserError(f"{path}: cannot be read ({e}); give a CSV file of Blender cameras.") from e
    poses = []
    for line, row in enumerate(rows, start=2):
        try:
            x, y, z, a, b, c = (float(row[name]) for name in COLUMNS[1:])
        except (KeyError, TypeError, ValueError) as e:
            raise UserError(f"{path}: line {line}: {e}; write numbers in the columns {', '.join(COLUMNS[1:])}.") from e
        poses.append(pose_from_blender((x, y, z), (a, b, c)))
    return poses
