"""Worlds for `swarmscan bench paths`: narrow passages made up at random, and given structures."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh

from missions.frames import Array
from missions.prior_file import load_prior
from planning.paths import MeshField, ObstacleField, VoxelField, voxelised

VOXEL_M = 0.5
CLEARANCE_M = 1.0
LOWER, UPPER = np.zeros(3), np.array([24.0, 16.0, 12.0])
MARGIN_M, REACH_M = 10.0, (5.0, 25.0)
"""Around a given structure; and the straight distance between the two ends of a query there."""

Boxes = list[tuple[Array, Array]]


@dataclass(frozen=True)
class Query:
    """One question: a way from start to goal. mesh is what the structure's triangles say, map what their voxels say."""

    world: str
    mesh: MeshField
    map: VoxelField
    triangles: Array
    ends_enu_m: Array
    lower_enu_m: Array
    upper_enu_m: Array


def made_up(count: int, seed: int) -> Iterator[Query]:
    """`count` queries per kind of passage, each in a world of its own: nothing lines up with the voxels."""
    for name, (build, _) in PASSAGES.items():
        rng = np.random.default_rng([seed, len(name), ord(name[0])])
        for _ in range(count):
            boxes = build(rng)
            mesh = trimesh.util.concatenate([trimesh.creation.box(bounds=np.array(b)) for b in boxes])
            yield _query(name, mesh, LOWER, UPPER, _sides(rng, boxes))


def in_structure(path: Path, count: int, seed: int) -> Iterator[Query]:
    """`count` queries near a structure from a file, none of which the straight line answers."""
    mesh = load_prior(path)
    lower, upper = _box_of(mesh)
    rng, made = np.random.default_rng(seed), 0
    first = _query(path.stem, mesh, lower, upper, np.zeros((2, 3)))
    while made < count:
        start = rng.uniform(lower, upper)
        step = rng.normal(size=3)
        ends = np.stack([start, start + step / np.linalg.norm(step) * rng.uniform(*REACH_M)])
        if asks_something(first.map, ends):
            made += 1
            yield Query(path.stem, first.mesh, first.map, first.triangles, ends, lower, upper)


def asks_something(field: ObstacleField, ends_enu_m: Array) -> bool:
    """Whether both ends are free and the straight line is not."""
    free = bool(np.all(field.clearance_m(ends_enu_m) >= CLEARANCE_M))
    return free and not field.segments_clear(ends_enu_m[0], ends_enu_m[1], CLEARANCE_M)[0]


def _box_of(mesh: trimesh.Trimesh) -> tuple[Array, Array]:
    """The structure's box and some room, without the ground around it: half the triangles' middles span it."""
    middles = mesh.triangles_center
    low, high = np.quantile(middles, 0.02, axis=0), np.quantile(middles, 0.98, axis=0)
    lower, upper = low - MARGIN_M, high + MARGIN_M
    lower[2], upper[2] = max(mesh.bounds[0][2], low[2] - MARGIN_M), mesh.bounds[1][2] + MARGIN_M
    return lower, upper


def _query(name: str, mesh: trimesh.Trimesh, lower: Array, upper: Array, ends: Array) -> Query:
    grid = voxelised(mesh.vertices, mesh.faces, lower, upper, VOXEL_M)
    field = MeshField.from_mesh(mesh.vertices, mesh.faces, grid)
    return Query(name, field, VoxelField.from_grid(grid), np.asarray(mesh.triangles), ends, lower, upper)


def _sides(rng: np.random.Generator, boxes: Boxes) -> Array:
    """A start before and a goal behind what stands in the middle, both clear of it."""
    while True:
        ends = rng.uniform([[2.0, 2.0, 2.0], [17.0, 2.0, 2.0]], [[7.0, 14.0, 10.0], [22.0, 14.0, 10.0]])
        gap = [np.linalg.norm(np.maximum(np.maximum(b[0] - ends, ends - b[1]), 0.0), axis=1).min() for b in boxes]
        if min(gap) > CLEARANCE_M + VOXEL_M:
            return ends


def _wall(rng: np.random.Generator, width_m: float, height_m: float) -> Boxes:
    """A wall across the world with one opening."""
    x0 = rng.uniform(9.0, 12.0)
    x1 = x0 + rng.uniform(0.3, 2.0)
    y, z = rng.uniform(4.0, 12.0), rng.uniform(2.0, 10.0 - height_m) + 0.5 * height_m
    y0, y1, z0, z1 = y - 0.5 * width_m, y + 0.5 * width_m, z - 0.5 * height_m, z + 0.5 * height_m
    return _boxes([(x0, 0, 0, x1, 16, z0), (x0, 0, z1, x1, 16, 12), (x0, 0, z0, x1, y0, z1), (x0, y1, z0, x1, 16, z1)])


def _corridor(rng: np.random.Generator) -> Boxes:
    """Two walls whose openings lie apart, with a passage 3 m wide between them."""
    x = rng.uniform(8.0, 9.0)
    width = 3.0 + rng.uniform(0.0, 0.4)
    shift = rng.uniform(-0.5, 0.5)
    return _boxes([(x, 4.0 + shift, 0, x + 1, 16, 12), (x + 1 + width, 0, 0, x + 2 + width, 12.0 + shift, 12)])


def _truss(rng: np.random.Generator) -> Boxes:
    """Two planes of posts and chords, 0.2 m thick, with openings of 3.2 m, shifted against each other."""
    out = []
    for x in (10.0, 13.4):
        y0, z0 = rng.uniform(-3.2, 0.0, 2)
        out += [(x, y, 0, x + 0.2, y + 0.2, 12) for y in np.arange(y0, 16.0, 3.4)]
        out += [(x, 0, z, x + 0.2, 16, z + 0.2) for z in np.arange(z0, 12.0, 3.4)]
    return _boxes(out)


def _bridge(rng: np.random.Generator) -> Boxes:
    """A deck on piers over the ground, closed above: the only way leads through an opening 2.8 m high."""
    x, low, pier = rng.uniform(9.0, 10.0), 2.8 + rng.uniform(0.0, 0.3), rng.uniform(0.0, 3.0)
    piers = [(x, y, 0, x + 1.5, y + 1.2, low) for y in np.arange(pier, 16.0, 5.0)]
    return _boxes([(x, 0, low, x + 4.0, 16, 12), *piers])


def _conductors(rng: np.random.Generator) -> Boxes:
    """Wires of 3 cm across the world, 2.7 m apart."""
    out = []
    for x in (10.0, 12.9):
        out += [(x, 0, z, x + 0.03, 16, z + 0.03) for z in np.arange(rng.uniform(-2.6, 0.0), 12.0, 2.7)]
    return _boxes(out)


def _boxes(rows: Sequence[Sequence[float]]) -> Boxes:
    return [(np.array(r[:3]), np.array(r[3:])) for r in rows if all(a < b for a, b in zip(r[:3], r[3:], strict=True))]


PASSAGES: dict[str, tuple[Callable[[np.random.Generator], Boxes], str]] = {
    "hole 3.0 m": (lambda rng: _wall(rng, 3.0, 3.0), "a square hole in a wall"),
    "hole 2.4 m": (lambda rng: _wall(rng, 2.4, 2.4), "a square hole that leaves 0.2 m to spare on each side"),
    "corridor": (_corridor, "two offset openings"),
    "truss": (_truss, "two planes of members"),
    "under a bridge": (_bridge, "between deck, piers and ground"),
    "between conductors": (_conductors, "two layers of wires"),
}
