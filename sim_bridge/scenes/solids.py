"""Solids that the built-in structures are made of, each with texture coordinates in metres.

Faces are wound counter-clockwise seen from outside. Flat faces are mapped by their world coordinates, so that a texture
runs on from one solid to the next.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sim_bridge.scenes.scene import Part
from sim_bridge.scenes.textures import Tile

Array = NDArray[np.float64]
Ints = NDArray[np.int32]

_PLANES = np.array([[1, 2], [0, 2], [0, 1]])
"""The two world axes that a face is mapped by, for a normal along x, y and z."""


@dataclass(frozen=True, eq=False)
class Solid:
    """Triangles: vertices_m (n, 3), faces (m, 3) and uv_m (n, 2), the texture coordinates in metres."""

    vertices_m: Array
    faces: Ints
    uv_m: Array


def joined(solids: Iterable[Solid]) -> Solid:
    """All solids in one, in their order."""
    parts = list(solids)
    starts = np.cumsum([0] + [len(s.vertices_m) for s in parts[:-1]])
    faces = [s.faces + np.int32(start) for s, start in zip(parts, starts, strict=True)]
    return Solid(np.concatenate([s.vertices_m for s in parts]), np.concatenate(faces),
                 np.concatenate([s.uv_m for s in parts]))


def textured(name: str, solids: Iterable[Solid], tile: Tile, *, is_object: bool = True) -> Part:
    """A part of these solids, covered with a tile."""
    solid = joined(solids)
    red, green, blue = (int(c) for c in tile.rgb[::16, ::16].reshape(-1, 3).mean(axis=0))
    return Part(name, solid.vertices_m, solid.faces, (solid.uv_m / tile.size_m).astype(np.float32), tile.rgb,
                (red, green, blue), is_object, procedural=False)


def quads(corners_m: ArrayLike) -> Solid:
    """Flat quadrilaterals from corners (n, 4, 3), counter-clockwise seen from outside."""
    corners = np.asarray(corners_m, dtype=np.float64)
    normals = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
    planes = _PLANES[np.argmax(np.abs(normals), axis=1)]
    uv = np.take_along_axis(corners, np.repeat(planes[:, None, :], 4, axis=1), axis=2)
    first = 4 * np.arange(len(corners), dtype=np.int32)[:, None, None]
    faces = (first + np.array([[0, 1, 2], [0, 2, 3]], np.int32)).reshape(-1, 3)
    return Solid(corners.reshape(-1, 3), faces, uv.reshape(-1, 2))


def box(lo: Sequence[float], hi: Sequence[float], omit: str = "") -> Solid:
    """An axis-aligned box without the faces named in omit, such as "-z +x"."""
    return quads(box_corners(lo, hi, omit))


def box_corners(lo: Sequence[float], hi: Sequence[float], omit: str = "") -> Array:
    """Corners (n, 4, 3) of the faces of an axis-aligned box, without the faces named in omit."""
    (x0, y0, z0), (x1, y1, z1) = lo, hi
    sides = {
        "-x": [(x0, y1, z0), (x0, y0, z0), (x0, y0, z1), (x0, y1, z1)],
        "+x": [(x1, y0, z0), (x1, y1, z0), (x1, y1, z1), (x1, y0, z1)],
        "-y": [(x0, y0, z0), (x1, y0, z0), (x1, y0, z1), (x0, y0, z1)],
        "+y": [(x1, y1, z0), (x0, y1, z0), (x0, y1, z1), (x1, y1, z1)],
        "-z": [(x0, y1, z0), (x1, y1, z0), (x1, y0, z0), (x0, y0, z0)],
        "+z": [(x0, y0, z1), (x1, y0, z1), (x1, y1, z1), (x0, y1, z1)],
    }
    return np.array([corners for name, corners in sides.items() if name not in omit.split()], dtype=np.float64)


def cells(lo: Sequence[float], hi: Sequence[float], holes: Iterable[Sequence[float]] = ()) -> Array:
    """A rectangle without rectangular holes (u0, v0, u1, v1), cut into rectangles (n, 4, 2), counter-clockwise."""
    cut = np.array(list(holes), dtype=np.float64).reshape(-1, 4)
    u, v = (np.unique(np.round(np.clip([lo[i], hi[i], *cut[:, i], *cut[:, i + 2]], lo[i], hi[i]), 9)) for i in (0, 1))
    u0, v0 = (a.ravel() for a in np.meshgrid(u[:-1], v[:-1], indexing="ij"))
    u1, v1 = (a.ravel() for a in np.meshgrid(u[1:], v[1:], indexing="ij"))
    um, vm = (u0 + u1)[:, None] / 2, (v0 + v1)[:, None] / 2
    inside = (um > cut[:, 0]) & (um < cut[:, 2]) & (vm > cut[:, 1]) & (vm < cut[:, 3])
    keep = ~inside.any(axis=1)
    corners = np.stack([np.stack(c, axis=-1) for c in ((u0, v0), (u1, v0), (u1, v1), (u0, v1))], axis=1)
    return np.asarray(corners[keep])


def plate(lo: Sequence[float], hi: Sequence[float], z_m: float, holes: Iterable[Sequence[float]] = (), *,
          facing_up: bool = True) -> Solid:
    """A horizontal rectangle at height z_m without rectangular holes (x0, y0, x1, y1)."""
    flat = cells(lo, hi, holes)
    corners = np.concatenate([flat, np.full((*flat.shape[:2], 1), z_m)], axis=2)
    return quads(corners if facing_up else corners[:, ::-1])


def tube(path_m: ArrayLike, radius_m: float | Array, sides: int = 8, *, capped: bool = False) -> Solid:
    """A round tube along a path (n, 3) with one radius, or one radius per path point."""
    path = np.asarray(path_m, dtype=np.float64)
    right, up = _path_frames(path)
    angle = np.linspace(0.0, 2.0 * np.pi, sides + 1)
    radius = np.broadcast_to(np.asarray(radius_m, dtype=np.float64), len(path))[:, None, None]
    ring = right[:, None] * np.cos(angle)[:, None] - up[:, None] * np.sin(angle)[:, None]
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    u, v = np.meshgrid(angle * float(radius.mean()), length)
    shell = _grid_solid(path[:, None] + radius * ring, np.stack([u, v + 7.3 * path[0, 0]], axis=-1))
    if not capped:
        return shell
    return joined([shell, _cap(shell.vertices_m[:sides][::-1]), _cap(shell.vertices_m[-sides - 1:-1])])


def beam(start_m: ArrayLike, end_m: ArrayLike, profile_m: ArrayLike, towards: ArrayLike = (0.0, 0.0, 1.0)) -> Solid:
    """A straight member with a closed profile (k, 2), counter-clockwise, without end faces.

    The profile's second axis points as far towards the given direction as the member's own direction allows.
    """
    start, end = np.asarray(start_m, dtype=np.float64), np.asarray(end_m, dtype=np.float64)
    along = end - start
    length = float(np.linalg.norm(along))
    along = along / length
    across = np.cross(np.asarray(towards, dtype=np.float64), along)
    if np.linalg.norm(across) < 1e-6:
        across = np.cross((1.0, 0.0, 0.0), along)
    across = across / np.linalg.norm(across)
    profile = np.asarray(profile_m, dtype=np.float64)
    offsets = profile[:, :1] * -across + profile[:, 1:] * np.cross(along, across)
    a, b = start + offsets, end + offsets
    corners = np.stack([np.roll(a, -1, axis=0), a, b, np.roll(b, -1, axis=0)], axis=1)
    solid = quads(corners)
    perimeter = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.roll(profile, -1, axis=0) - profile, axis=1))])
    u0, u1 = perimeter[:-1] + 3.1 * start[0], perimeter[1:] + 3.1 * start[0]
    v0, v1 = np.full_like(u0, start[2]), np.full_like(u0, start[2] + length)
    uv = np.stack([np.stack(c, axis=-1) for c in ((u1, v0), (u0, v0), (u0, v1), (u1, v1))], axis=1)
    return Solid(solid.vertices_m, solid.faces, uv.reshape(-1, 2))


def lathe(profile_m: ArrayLike, foot_m: ArrayLike, sides: int = 24) -> Solid:
    """A solid of revolution about the vertical through foot_m from a profile (n, 2) of radius and height, upwards."""
    profile = np.asarray(profile_m, dtype=np.float64)
    angle = np.linspace(0.0, 2.0 * np.pi, sides + 1)
    r, z = profile[:, :1], profile[:, 1:]
    ring = np.stack([r * np.cos(angle), r * np.sin(angle), np.broadcast_to(z, (len(r), sides + 1))], axis=-1)
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(profile, axis=0), axis=1))])
    u, v = np.meshgrid(angle * float(r.max()), along)
    return _grid_solid(ring + np.asarray(foot_m, dtype=np.float64), np.stack([u, v], axis=-1))


def planar_mapped(vertices_m: Array, faces: Ints) -> Solid:
    """A free-form mesh whose faces are mapped along the world axis nearest to their normal.

    Vertices are doubled where the axis changes.
    """
    corners = vertices_m[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    axis = np.argmax(np.abs(normals), axis=1)
    pairs = (faces.astype(np.int64) * 3 + axis[:, None]).ravel()
    kept, index = np.unique(pairs, return_inverse=True)
    vertices = vertices_m[kept // 3]
    uv = np.take_along_axis(vertices, _PLANES[kept % 3], axis=1)
    return Solid(vertices, index.reshape(-1, 3).astype(np.int32), uv)


def _path_frames(path: Array) -> tuple[Array, Array]:
    tangent = np.gradient(path, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    level = np.array([0.0, 0.0, 1.0]) if abs(tangent[:, 2]).max() < 0.99 else np.array([1.0, 0.0, 0.0])
    right = np.cross(tangent, level)
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    return right, np.cross(right, tangent)


def _grid_solid(points: Array, uv: Array) -> Solid:
    """Points (rows, columns, 3) of a curved surface; columns run counter-clockwise, rows along the axis."""
    rows, columns = points.shape[:2]
    index = np.arange(rows * columns, dtype=np.int32).reshape(rows, columns)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    faces = np.stack([np.stack([a, b, c], axis=-1), np.stack([a, c, d], axis=-1)], axis=2).reshape(-1, 3)
    flat = points.reshape(-1, 3)
    doubled = faces[_areas(flat, faces) > 0.0]
    return Solid(flat, doubled, uv.reshape(-1, 2))


def _cap(ring: Array) -> Solid:
    index = np.arange(1, len(ring) - 1, dtype=np.int32)
    faces = np.stack([np.zeros_like(index), index, index + 1], axis=1)
    return planar_mapped(ring, faces)


def _areas(vertices: Array, faces: Ints) -> Array:
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    return np.asarray(np.linalg.norm(np.cross(b - a, c - a), axis=1))
