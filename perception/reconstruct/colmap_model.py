"""Poses and points as a COLMAP text model.

Format: https://colmap.github.io/format.html. World coordinates are ENU metres; pixel centres lie at integer + 0.5,
there as here. Poses are written to the last digit of a double.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from missions.frames import quaternion_from_matrix
from perception.reconstruct.bundle import Adjusted
from perception.reconstruct.optics import Optics
from perception.reconstruct.pictures import SurveyPicture

MODEL_FILES = ("cameras.txt", "images.txt", "points3D.txt")


def write_model(folder: Path, pictures: list[SurveyPicture], found: Adjusted | Optics) -> None:
    """MODEL_FILES of pictures that share one camera. found: its optics, alone or with points of the same pictures and
    who saw them."""
    seen = _no_points(pictures, found) if isinstance(found, Optics) else found
    camera = seen.optics.colmap(with_lens=False)
    intrinsics = " ".join(repr(float(v)) for v in camera.params)
    (folder / "cameras.txt").write_text(f"1 {camera.model_name} {camera.width} {camera.height} {intrinsics}\n",
                                        encoding="ascii")
    tracks: list[list[str]] = [[] for _ in seen.points_enu_m]
    with (folder / "images.txt").open("w", encoding="utf-8") as f:
        for i, p in enumerate(pictures):
            q = quaternion_from_matrix(p.enu_from_camera.T)
            t = -p.enu_from_camera.T @ p.position_enu_m
            mine = np.flatnonzero(seen.picture_of == i)
            for at, o in enumerate(mine):
                tracks[seen.point_of[o]].append(f"{i + 1} {at}")
            f.write(" ".join([str(i + 1), *(repr(float(v)) for v in (*q, *t)), "1", p.path.name]) + "\n")
            f.write(" ".join(f"{x:.3f} {y:.3f} {k + 1}" for (x, y), k in
                             zip(seen.seen_px[mine], seen.point_of[mine], strict=True)) + "\n")
    error = np.bincount(seen.point_of, seen.error_px(), len(tracks)) / np.maximum(
        np.bincount(seen.point_of, minlength=len(tracks)), 1)
    with (folder / "points3D.txt").open("w", encoding="ascii") as f:
        for k, (point, track) in enumerate(zip(seen.points_enu_m, tracks, strict=True)):
            where = [f"{v:.6f}" for v in point]
            f.write(" ".join([str(k + 1), *where, "128 128 128", f"{error[k]:.4f}", *track]) + "\n")


def _no_points(pictures: list[SurveyPicture], optics: Optics) -> Adjusted:
    """The poses alone."""
    nobody = np.zeros(0, np.int64)
    return Adjusted(np.array([p.enu_from_camera for p in pictures]), np.array([p.position_enu_m for p in pictures]),
                    np.zeros((0, 3)), nobody, nobody, nobody, np.zeros((0, 2)), optics)
