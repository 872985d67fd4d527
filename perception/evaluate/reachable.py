"""What pictures from anywhere in reach could show of a surface: the bound that a reconstruction is held against."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import open3d as o3d
from numpy.typing import NDArray

from missions.frames import Array
from perception.evaluate.ray_scene import hidden, ray_scene
from perception.evaluate.reference import Reference


@dataclass(frozen=True)
class Stand:
    """Where a camera may stand, and what it then shows."""

    clearance_m: float
    """Least distance to the surface."""
    range_m: float
    """From farther away a place is shown too coarsely to count."""
    incidence_deg: float = 80.0
    """Between a place's normal and the way to the camera, at most."""


def reachable_pictures(reference: Reference, positions_enu_m: Array, stand: Stand, enough: int) -> NDArray[np.int64]:
    """(n,) from how many of the places (p, 3) a camera that is turned there shows each sample, counted up to `enough`.

    The places are taken in a shuffled order (seeded), so that most samples are done after a few hundred of them.
    """
    scene = ray_scene(reference.vertices_enu_m, reference.triangles)
    room = scene.compute_distance(o3d.core.Tensor.from_numpy(positions_enu_m.astype(np.float32))).numpy()
    places = positions_enu_m[room >= stand.clearance_m]
    count = np.zeros(len(reference.samples_enu_m), dtype=np.int64)
    least_facing = math.cos(math.radians(stand.incidence_deg))
    for place in np.random.default_rng(0).permutation(places):
        open_ = np.flatnonzero(count < enough)
        away = place - reference.samples_enu_m[open_]
        distance = np.linalg.norm(away, axis=1)
        facing = np.sum(away * reference.normals[open_], axis=1)
        near = open_[(distance <= stand.range_m) & (facing >= least_facing * distance)]
        count[near[~hidden(scene, place, reference.samples_enu_m[near])]] += 1
    return count
