"""A model without scale and direction put on the Earth: by the positions that its pictures carry, else set upright."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pycolmap
from numpy.typing import NDArray

from missions.frames import Array, enu_from_camera, yaw_enu_from_heading_deg
from perception.reconstruct.matching import SEED

Indices = NDArray[np.intp]

LIMITS_M = (0.1, 0.3, 1.0, 3.0, 10.0, 30.0)
"""Positions agree within the first of these that most of them keep."""
MOST = 0.6
LEAST_PLACED = 3
IN_A_ROW = 0.03
"""Positions whose second extent is less than this of the first say nothing of the turn about their line."""
FAR_MEDIANS = 4.0
SAME_WAY = 0.05
USUAL_DISTANCE_M = 10.0
"""What stands for the median distance of the surface where nothing tells a scale."""


@dataclass(frozen=True)
class Stations:
    """Where the pictures of a model stand, in its own coordinates, and what they say of themselves."""

    world_from_camera: Array
    """(n, 3, 3), axes of the picture as it is shown upright."""
    position: Array
    """(n, 3)"""
    placed_enu_m: Array
    """(n, 3) from GNSS; NaN where unknown."""
    gimbal_deg: list[tuple[float, float, float] | None]


@dataclass(frozen=True)
class Placement:
    """enu_from_model, and how well it is known."""

    enu_from_model: pycolmap.Sim3d
    by: str
    """"control points", "GPS", "GPS in a row" (levelled by the cameras), "attitudes" or "nothing": upright as cameras
    are held, with a scale made up."""
    agreeing: int = 0
    outliers: tuple[int, ...] = ()
    error_m: float | None = None
    """Mean distance between positions that agree and their GNSS positions."""

    @property
    def scaled(self) -> bool:
        """Whether metres are metres."""
        return self.by.startswith(("GPS", "control"))


def place(stations: Stations, distance: float) -> Placement:
    """The most that GNSS positions and attitudes allow. distance: median distance of the surface, model's units."""
    known = np.flatnonzero(np.all(np.isfinite(stations.placed_enu_m), axis=1))
    if len(known) >= LEAST_PLACED:
        in_a_row = _in_a_row(stations.placed_enu_m[known])
        agree = known[(_agreeing_in_a_row if in_a_row else _agreeing)(stations, known)]
        if len(agree) >= LEAST_PLACED:
            return _placed(stations, known, agree)
    rotation, told = _upright(stations)
    scale = USUAL_DISTANCE_M / distance
    middle = np.median(stations.position, axis=0)
    return Placement(_sim3(scale, rotation, -scale * rotation @ middle), "attitudes" if told else "nothing")


def _in_a_row(placed_enu_m: Array) -> bool:
    """Whether positions lie on a line, or in one place."""
    extent = np.linalg.svd(placed_enu_m - np.median(placed_enu_m, axis=0))[1].tolist()
    return bool(extent[1] < IN_A_ROW * extent[0])


def _agreeing(stations: Stations, known: Indices) -> Indices:
    """Those of the known that agree within twice the smallest limit that most keep; none when they never do."""
    source, target = stations.position[known], stations.placed_enu_m[known]
    for limit in LIMITS_M:
        options = pycolmap.RANSACOptions(max_error=limit, random_seed=SEED, min_num_trials=200, max_num_trials=5000)
        found: Any = pycolmap.estimate_sim3d_robust(source, target, options)
        if found is not None and np.sum(found["inlier_mask"]) >= MOST * len(source):
            return np.flatnonzero(_distances(found["tgt_from_src"], source, target) <= 2.0 * limit)
    return np.zeros(0, np.intp)


def _agreeing_in_a_row(stations: Stations, known: Indices) -> Indices:
    """The same for positions that lie on a line, whose similarity the cameras complete."""
    source, target = stations.position[known], stations.placed_enu_m[known]
    away = _distances(_levelled(stations, source, target), source, target)
    return np.flatnonzero(away <= max(LIMITS_M[0], FAR_MEDIANS * float(np.median(away))))


def _distances(sim: pycolmap.Sim3d, source: Array, target: Array) -> Array:
    matrix = sim.matrix()
    return np.asarray(np.linalg.norm(source @ matrix[:, :3].T + matrix[:, 3] - target, axis=1))


def _placed(stations: Stations, known: Indices, agree: Indices) -> Placement:
    source, target = stations.position[agree], stations.placed_enu_m[agree]
    free = None if _in_a_row(target) else pycolmap.estimate_sim3d(source, target)
    sim = free or _levelled(stations, source, target)
    return Placement(sim, "GPS" if free else "GPS in a row", len(agree),
                     tuple(sorted(set(known.tolist()) - set(agree.tolist()))),
                     float(_distances(sim, source, target).mean()))


def _levelled(stations: Stations, source: Array, target: Array) -> pycolmap.Sim3d:
    """Upright by the cameras; scale, heading and place by the positions."""
    rotation, _ = _upright(stations)
    level, wanted = source @ rotation.T, target
    own, goal = level - level.mean(axis=0), wanted - wanted.mean(axis=0)
    a, b = own[:, 0] + 1j * own[:, 1], goal[:, 0] + 1j * goal[:, 1]
    turn = np.angle(np.vdot(a, b))
    scale = float(np.linalg.norm(goal)) / max(float(np.linalg.norm(own)), 1e-12)
    c, s = np.cos(turn), np.sin(turn)
    rotation = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ rotation
    return _sim3(scale, rotation, target.mean(axis=0) - scale * rotation @ source.mean(axis=0))


def _upright(stations: Stations) -> tuple[Array, bool]:
    """enu_from_model rotation (3, 3), and whether attitudes gave it; else only its vertical means anything."""
    told = [(enu_from_camera(yaw_enu_from_heading_deg(g[0]), np.radians(g[1]), np.radians(g[2])), r)
            for g, r in zip(stations.gimbal_deg, stations.world_from_camera, strict=True) if g is not None]
    if 2 * len(told) > len(stations.gimbal_deg):
        total = np.sum([enu @ world.T for enu, world in told], axis=0)
        u, _, v = np.linalg.svd(total)
        return np.asarray(u @ np.diag([1.0, 1.0, np.linalg.det(u @ v)]) @ v), True
    up = _up(stations.world_from_camera)
    east = np.cross([0.0, 1.0, 0.0] if abs(up[1]) < 0.9 else [1.0, 0.0, 0.0], up)
    east = east / float(np.linalg.norm(east))
    return np.array([east, np.cross(up, east), up]), False


def _up(rotation: Array) -> Array:
    """(3,) what the pictures' sides are level to: people and gimbals do not roll their cameras.

    Where all sides run the same way, what is above in most pictures; behind them where that changes, as in a strip
    flown to and fro that looks down.
    """
    values, vectors = np.linalg.eigh(np.einsum("ni,nj->ij", rotation[:, :, 0], rotation[:, :, 0]))
    above, behind = -rotation[:, :, 1].mean(axis=0), -rotation[:, :, 2].mean(axis=0)
    if values[1] < SAME_WAY * values[2]:
        up = above if np.linalg.norm(above) > 0.5 else behind
        return np.asarray(up / float(np.linalg.norm(up)))
    up = vectors[:, 0]
    return np.asarray(up if up @ (above + 0.5 * behind) > 0.0 else -up)


def _sim3(scale: float, rotation: Array, translation: Array) -> pycolmap.Sim3d:
    return pycolmap.Sim3d(scale, pycolmap.Rotation3d(rotation), translation)
