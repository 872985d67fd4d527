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
WITNESS_DIRECTIONS, WITNESS_LINES = 32, 5
"""Directions in which an unopen sample looks for an open point, and the free lines that make such a point well open."""
WITNESS_NEAR_M, WITNESS_FAR_M = 1.3, 16.0
"""An open point lies at three quarters of the free length, of which at most WITNESS_FAR_M count."""
LIFT_M = 0.004
"""Rays start this far off the face: less than the thinnest member, more than Embree's single precision."""

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Surface:
    """Samples of a surface: points_enu_m (n, 3), unit normals (n, 3) towards the open side, and each sample's row (n,)
    in the faces of Scene.object_mesh()."""

    points_enu_m: Array
    normals: Array
    faces: NDArray[np.intp]


def exposed_surface(scene: Scene, samples: int, seed: int = 0) -> Surface:
    """Samples, uniform by area, of the object's faces that can be seen from outside at all.

    A point is open if, of 60 directions over the sphere, a free line leads 60 m away from it past the whole scene,
    ground included. A sample is exposed on a side if it is open just off that side, or sees a well open point 1-12 m
    away: the soffit of a bridge sees only ground, but a camera under it sees the soffit. The inside of a closed hall
    is not exposed. The same arguments give the same samples. Raises UserError where hardly anything is exposed.
    """
    vertices, faces = scene.object_mesh()
    everything = embree_scene(*scene.mesh())
    rng = np.random.default_rng([seed, 0x5EE])
    found: list[Surface] = []
    count, tried = 0, 0
    for _ in range(8):
        share = max(count / tried, 0.02) if tried else 1.0
        batch = _uniform_samples(rng, vertices, faces, max(int((samples - count) / share), 256))
        found.append(_exposed(everything, batch, scene.ground_up_m))
        count, tried = count + len(found[-1].points_enu_m), tried + len(batch.points_enu_m)
        if count >= samples:
            return Surface(np.concatenate([s.points_enu_m for s in found])[:samples],
                           np.concatenate([s.normals for s in found])[:samples],
                           np.concatenate([s.faces for s in found])[:samples])
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


def open_lines(vertices: Vertices, faces: Faces, rows: NDArray[np.intp]) -> NDArray[np.int64]:
    """How many free lines (k,) lead into the open from the front of some faces of a mesh, given by their rows (k,)."""
    a, b, c = (vertices[faces[rows, i]] for i in range(3))
    normals = np.cross(b - a, c - a)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    origins = (a + b + c) / 3.0 + LIFT_M * normals
    scene = embree_scene(vertices, faces)
    reach = float(np.ptp(vertices, axis=0).max()) * 2.0
    count = np.zeros(len(rows), dtype=np.int64)
    for direction in sphere_directions(DIRECTIONS):
        todo = np.flatnonzero(normals @ direction > 0.05)
        count[todo] += _distances(scene, origins[todo], direction) > reach
    return count


def _uniform_samples(rng: np.random.Generator, vertices: Vertices, faces: Faces, count: int) -> Surface:
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    normal = np.cross(b - a, c - a)
    area2 = np.linalg.norm(normal, axis=1)
    edges = np.cumsum(area2)
    face = np.minimum(np.searchsorted(edges, rng.uniform(0.0, edges[-1], count), side="right"), len(faces) - 1)
    u, v = np.sqrt(rng.random(count)), rng.random(count)
    weights = np.stack([1.0 - u, u * (1.0 - v), u * v], axis=1)
    points = np.einsum("nk,nkj->nj", weights, vertices[faces[face]])
    return Surface(points, normal[face] / area2[face][:, None], face)


def _exposed(everything: EmbreeScene, batch: Surface, ground_up_m: float) -> Surface:
    above = np.flatnonzero(batch.points_enu_m[:, 2] > ground_up_m)
    points, normals = batch.points_enu_m[above], batch.normals[above]
    seen = _visible(everything, points + LIFT_M * normals, normals, ground_up_m)
    unseen = np.flatnonzero(~seen)
    normals[unseen] *= -1.0
    seen[unseen] = _visible(everything, points[unseen] + LIFT_M * normals[unseen], normals[unseen], ground_up_m)
    return Surface(points[seen], normals[seen], batch.faces[above[seen]])


def _visible(everything: EmbreeScene, origins: Array, normals: Array, ground_up_m: float) -> NDArray[np.bool_]:
    """Which points (n, 3) are open themselves, or see an open point on the side that their normals (n, 3) show."""
    seen = _free_lines(everything, origins, normals, ground_up_m) > 0
    for direction in sphere_directions(WITNESS_DIRECTIONS):
        todo = np.flatnonzero(~seen & (normals @ direction > 0.1))
        reach = np.minimum(_distances(everything, origins[todo], direction), WITNESS_FAR_M)
        far = reach > WITNESS_NEAR_M
        todo, witness = todo[far], (origins[todo] + 0.75 * reach[:, None] * direction)[far]
        todo, witness = todo[witness[:, 2] > ground_up_m], witness[witness[:, 2] > ground_up_m]
        seen[todo] = _free_lines(everything, witness, None, ground_up_m) >= WITNESS_LINES
    return seen


def _free_lines(everything: EmbreeScene, origins: Array, normals: Array | None,
                ground_up_m: float) -> NDArray[np.int64]:
    """How many of the directions lead freely 60 m away from each origin (n, 3).

    With normals (n, 3) only directions to that side are tried, and each origin's first free line ends its search.
    """
    count = np.zeros(len(origins), dtype=np.int64)
    for direction in sphere_directions(DIRECTIONS):
        wanted = np.ones(len(origins), dtype=bool) if normals is None else (normals @ direction > 0.05) & (count == 0)
        if direction[2] < 0:
            wanted &= (origins[:, 2] - ground_up_m) / -direction[2] > REACH_M
        todo = np.flatnonzero(wanted)
        count[todo] += _distances(everything, origins[todo], direction) > REACH_M
    return count


def _distances(everything: EmbreeScene, origins: Array, direction: Array) -> Array:
    """Free length (n,) of rays from origins (n, 3) in one direction; very large where nothing is hit."""
    if not len(origins):
        return np.zeros(0)
    rays = np.broadcast_to(direction, origins.shape).astype(np.float32)
    return np.asarray(everything.run(origins.astype(np.float32), rays, query="DISTANCE"), dtype=np.float64)
