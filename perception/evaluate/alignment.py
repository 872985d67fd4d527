"""Bringing a cloud into the frame of its reference, before it is measured, where it was not made in it."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import open3d as o3d

from missions.errors import UserError
from missions.frames import Array

ICP_REACH_M = (1.0, 0.3, 0.1)
"""Pairs farther apart than this are no pairs; one round for each."""
ICP_STEPS = 60
MARKER_COLUMNS = ("name", "cloud_x_m", "cloud_y_m", "cloud_z_m", "east_m", "north_m", "up_m")


@dataclass(frozen=True)
class Alignment:
    """reference_from_cloud (4, 4), and the RMS distance (m) that it leaves between its pairs."""

    method: str
    reference_from_cloud: Array
    rms_m: float | None
    pairs: int

    def apply(self, points_m: Array) -> Array:
        """Points (n, 3) in the reference's frame."""
        moved: Array = points_m @ self.reference_from_cloud[:3, :3].T + self.reference_from_cloud[:3, 3]
        return moved


UNMOVED = Alignment("none", np.eye(4), None, 0)


def by_icp(cloud_m: Array, samples_enu_m: Array, normals: Array) -> Alignment:
    """Rigid, point to plane with a robust (Tukey) weight, from where the cloud lies (Open3D).

    It takes away what a systematic error of the poses did, so it flatters: say that it was used.
    """
    source, target = o3d.geometry.PointCloud(), o3d.geometry.PointCloud()
    source.points = o3d.utility.Vector3dVector(cloud_m)
    target.points, target.normals = o3d.utility.Vector3dVector(samples_enu_m), o3d.utility.Vector3dVector(normals)
    transform = np.eye(4)
    for reach in ICP_REACH_M:
        weight = o3d.pipelines.registration.TukeyLoss(k=reach)
        found = o3d.pipelines.registration.registration_icp(
            source, target, reach, transform,
            o3d.pipelines.registration.TransformationEstimationPointToPlane(weight),
            o3d.pipelines.registration.ICPConvergenceCriteria(max_iteration=ICP_STEPS))
        transform = np.array(found.transformation)
    if not len(found.correspondence_set):
        raise UserError(f"--align icp: no point of the cloud lies within {ICP_REACH_M[0]:g} m of the reference; align "
                        "with markers, or bring both into one frame.")
    return Alignment("icp", transform, float(found.inlier_rmse), len(found.correspondence_set))


def by_markers(cloud_m: Array, reference_enu_m: Array, scale: bool = False) -> Alignment:
    """Least squares over pairs of markers (n, 3) each, n >= 3 and not on a line (Umeyama, PAMI 1991); with scale, a
    cloud of unknown size is brought to metres. Raises UserError."""
    cloud_mid, reference_mid = cloud_m.mean(axis=0), reference_enu_m.mean(axis=0)
    a, b = cloud_m - cloud_mid, reference_enu_m - reference_mid
    if len(cloud_m) < 3 or np.linalg.svd(a, compute_uv=False)[1] < 1e-6 * max(np.abs(a).max(), 1e-9):
        raise UserError(f"--align markers: {len(cloud_m)} markers do not fix a position; give at least three that do "
                        "not lie on a line.")
    u, s, vt = np.linalg.svd(b.T @ a)
    sign = np.array([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    factor = float((s * sign).sum() / np.sum(a**2)) if scale else 1.0
    transform = np.eye(4)
    transform[:3, :3] = factor * (u * sign) @ vt
    transform[:3, 3] = reference_mid - transform[:3, :3] @ cloud_mid
    left = cloud_m @ transform[:3, :3].T + transform[:3, 3] - reference_enu_m
    return Alignment("markers", transform, float(np.sqrt(np.mean(np.sum(left**2, axis=1)))), len(cloud_m))


def read_markers(path: Path) -> tuple[Array, Array]:
    """Places of the same markers (n, 3) in the cloud and (n, 3) in the reference, from a CSV with MARKER_COLUMNS.

    Raises UserError naming line and column.
    """
    if not path.is_file():
        raise UserError(f"{path}: no such file; give a CSV with the columns {', '.join(MARKER_COLUMNS)}.")
    with path.open(newline="", encoding="utf-8") as f:
        rows = list(csv.DictReader(f))
    missing = [c for c in MARKER_COLUMNS[1:] if not rows or c not in rows[0]]
    if missing:
        raise UserError(f"{path}: column {missing[0]} is missing; the columns are {', '.join(MARKER_COLUMNS)}.")
    places = np.zeros((len(rows), 6))
    for line, row in enumerate(rows):
        for k, column in enumerate(MARKER_COLUMNS[1:]):
            try:
                places[line, k] = float(row[column])
            except (TypeError, ValueError):
                raise UserError(f"{path}: line {line + 2}, {column}: {row[column]!r} is no number; give metres."
                                ) from None
    return places[:, :3], places[:, 3:]
