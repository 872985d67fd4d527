"""The surface that anybody could see: the object's skin without what is buried in solids or in the ground.

Completeness and coverage are measured on it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from numpy.typing import NDArray

from missions.errors import UserError
from sim_bridge.scenes.scene import Faces, Scene, Vertices

DIRECTIONS = 60
REACH_M = 60.0
LIFT_M = 0.004
"""Rays start this far off the face: less than the thinnest member, more than Embree's single precision."""

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Surface:
    """Samples of a surface: points_enu_m (n, 3) and normals (n, 3), unit, towards the open side."""

    points_enu_m: Array
    normals: Array


def exposed_surface(scene: Scene, samples: int, seed: int = 0) -> Surface:
    """Samples, uniform by area, of the object's faces that can be seen from outside at all.

    A sample is exposed on a side if, of 60 directions over the sphere, one free line leads from just off that side 60 m
    away past the whole scene, ground included. The same arguments give the same samples. Raises UserError where
    hardly anything is exposed.
    """
    vertices, faces = scene.object_mesh()
    everything = embree_scene(*scene.mesh())
    rng = np.random.default_rng([seed, 0x5EE])
    found: list[Surface] = []
    count = 0
    for _ in range(40):
        batch = _uniform_samples(rng, vertices, faces, max(samples - count, 256))
        found.append(_exposed(everything, batch, scene.ground_up_m))
        count += len(found[-1].points_enu_m)
        if count >= samples:
            return Surface(np.concatenate([s.points_enu_m for s in found])[:samples],
                           np.concatenate([s.normals for s in found])[:samples])
    raise UserError(f"{scene.name}: next to nothing of the object can be seen from outside; check that its box holds "
                    "the object and not its interior, and that site.ground_up_m is not above it.")


def embree_scene(vertices: Vertices, faces: Faces) -> EmbreeScene:
    """Triangles ready for ray casting."""
    scene = EmbreeScene()
    TriangleMesh(scene, vertices[faces].astype(np.float32))
    return scene


def sphere_directions(count: int) -> Array:
    """(count, 3) unit vectors spread evenly over the sphere, on a Fibonacci spiral."""
    k = np.arange(count) + 0.5
    z = 1.0 - 2.0 * k / count
    angle = k * np.pi * (3.0 - np.sqrt(5.0))
    r = np.sqrt(1.0 - z * z)
    return np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=1)


def _uniform_samples(rng: np.random.Generator, vertices: Vertices, faces: Faces, count: int) -> Surface:
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    normal = np.cross(b - a, c - a)
    area2 = np.linalg.norm(normal, axis=1)
    edges = np.cumsum(area2)
    face = np.minimum(np.searchsorted(edges, rng.uniform(0.0, edges[-1], count), side="right"), len(faces) - 1)
    u, v = np.sqrt(rng.random(count)), rng.random(count)
    weights = np.stack([1.0 - u, u * (1.0 - v), u * v], axis=1)
    points = np.einsum("nk,nkj->nj", weights, vertices[faces[face]])
    return Surface(points, normal[face] / area2[face][:, None])


def _exposed(everything: EmbreeScene, batch: Surface, ground_up_m: float) -> Surface:
    above = batch.points_enu_m[:, 2] > ground_up_m
    points, normals = batch.points_enu_m[above], batch.normals[above]
    front, back = (_escapes(everything, points, side * normals, ground_up_m) for side in (1.0, -1.0))
    outward = np.where(front[:, None], normals, -normals)
    seen = front | back
    return Surface(points[seen], outward[seen])


def _escapes(everything: EmbreeScene, points: Array, normals: Array, ground_up_m: float) -> NDArray[np.bool_]:
    """Which samples (n,) have a free line on the side that their normals (n, 3) point to."""
    origins = points + LIFT_M * normals
    free = np.zeros(len(points), dtype=bool)
    for direction in sphere_directions(DIRECTIONS):
        towards = normals @ direction > 0.05
        if direction[2] < 0:
            towards &= (origins[:, 2] - ground_up_m) / -direction[2] > REACH_M
        todo = np.flatnonzero(towards & ~free)
        if len(todo):
            rays = np.broadcast_to(direction, (len(todo), 3)).astype(np.float32)
            distance = everything.run(origins[todo].astype(np.float32), rays, query="DISTANCE")
            free[todo] = distance > REACH_M
    return free
