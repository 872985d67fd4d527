"""A scene flattened into one indexed triangle list, its faces grouped by texture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from sim_bridge.render.light import GRAIN_PROCEDURAL, GRAIN_TEXTURED, Bytes, Floats
from sim_bridge.scenes.scene import Part

MAX_TEXTURE_PX = 4096
TEXTURE_BUDGET_TEXELS = 120_000_000
"""All textures together; with their mipmaps at 4 bytes a texel this is 640 MB."""

Box = tuple[Sequence[float], Sequence[float]]
"""Centre (3,) and size (3,) of an axis-aligned box, ENU, metres."""


@dataclass(frozen=True)
class Batch:
    """Faces first_face .. first_face + face_count, all with one texture (None: vertex colour alone), or all water."""

    first_face: int
    face_count: int
    texture: Bytes | None
    water: bool = False


@dataclass(frozen=True)
class Geometry:
    """positions_enu_m (n, 3); uv (n, 2), v up; color (n, 4) uint8: RGB and grain strength; faces (m, 3) int32."""

    positions_enu_m: Floats
    uv: Floats
    color: Bytes
    faces: NDArray[np.int32]
    batches: tuple[Batch, ...]


def geometry_of(parts: Sequence[Part]) -> Geometry:
    """Flatten parts; those that share a texture end up in one batch, untextured ones first."""
    shown = [p for p in parts if len(p.faces)]
    order = sorted(range(len(shown)), key=lambda i: _first_user(shown, i))
    ordered = [shown[i] for i in order]
    textures = limit_textures([t for p in ordered if (t := _texture(p)) is not None])
    offsets = np.cumsum([0] + [len(p.vertices_enu_m) for p in ordered])
    faces = [p.faces + offset for p, offset in zip(ordered, offsets, strict=False)]
    return Geometry(
        positions_enu_m=_stack([p.vertices_enu_m for p in ordered], 3, np.float32),
        uv=_stack([_uv(p) for p in ordered], 2, np.float32),
        color=_stack([_color(p) for p in ordered], 4, np.uint8),
        faces=_stack(faces, 3, np.int32),
        batches=_batches(ordered, textures),
    )


def boxes_geometry(boxes: Sequence[Box]) -> Geometry:
    """Obstacles as boxes with red and white stripes of 0.3 m."""
    return geometry_of([_box_part(np.asarray(c, dtype=float), np.asarray(s, dtype=float)) for c, s in boxes])


def merged(a: Geometry, b: Geometry) -> Geometry:
    """Both in one list, a first."""
    moved = [replace(x, first_face=x.first_face + len(a.faces)) for x in b.batches]
    return Geometry(
        np.concatenate([a.positions_enu_m, b.positions_enu_m]), np.concatenate([a.uv, b.uv]),
        np.concatenate([a.color, b.color]), np.concatenate([a.faces, b.faces + np.int32(len(a.positions_enu_m))]),
        (*a.batches, *moved))


def limit_textures(textures: Sequence[Bytes]) -> dict[int, Bytes]:
    """Textures by id of the array given, halved where they exceed MAX_TEXTURE_PX or the common budget."""
    unique = {id(t): t for t in textures}
    side = MAX_TEXTURE_PX
    while sum(_limited_texels(t, side) for t in unique.values()) > TEXTURE_BUDGET_TEXELS:
        side //= 2
    return {key: _shrunk(t, side) for key, t in unique.items()}


def _texture(part: Part) -> Bytes | None:
    return part.texture if part.uv is not None else None


def _first_user(parts: Sequence[Part], index: int) -> tuple[int, int]:
    texture = _texture(parts[index])
    if parts[index].water:
        return (-2, index)
    if texture is None:
        return (-1, index)
    return (next(i for i, p in enumerate(parts) if _texture(p) is texture), index)


def _uv(part: Part) -> Floats:
    uv = part.uv if part.uv is not None else np.zeros((len(part.vertices_enu_m), 2))
    return np.asarray(uv, dtype=np.float32)


def _color(part: Part) -> Bytes:
    grain = GRAIN_PROCEDURAL if part.procedural or _texture(part) is None else GRAIN_TEXTURED
    rgb = part.color_rgb if _texture(part) is None else (255, 255, 255)
    return np.tile(np.array([*rgb, round(255 * grain)], dtype=np.uint8), (len(part.vertices_enu_m), 1))


def _stack(arrays: Sequence[NDArray[Any]], width: int, dtype: type) -> NDArray[Any]:
    return np.concatenate([np.zeros((0, width), dtype), *[np.asarray(a, dtype) for a in arrays]])


def _batches(parts: Sequence[Part], textures: dict[int, Bytes]) -> tuple[Batch, ...]:
    batches: list[Batch] = []
    key: tuple[int, bool] | None = None
    first = 0
    for part in parts:
        texture = _texture(part)
        count = len(part.faces)
        if batches and key == (id(texture), part.water):
            batches[-1] = replace(batches[-1], face_count=batches[-1].face_count + count)
        else:
            key = id(texture), part.water
            batches.append(Batch(first, count, None if texture is None else textures[id(texture)], part.water))
        first += count
    return tuple(batches)


def _limited_texels(texture: Bytes, side: int) -> int:
    h, w = texture.shape[:2]
    shrink = min(1.0, side / max(h, w))
    return int(h * shrink) * int(w * shrink)


def _shrunk(texture: Bytes, side: int) -> Bytes:
    h, w = texture.shape[:2]
    shrink = side / max(h, w)
    if shrink >= 1.0:
        return np.ascontiguousarray(texture)
    size = max(1, round(w * shrink)), max(1, round(h * shrink))
    return np.asarray(cv2.resize(texture, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def _box_part(center: NDArray[np.float64], size: NDArray[np.float64]) -> Part:
    vertices: list[NDArray[np.float64]] = []
    uv: list[NDArray[np.float64]] = []
    faces: list[list[int]] = []
    for axis in range(3):
        b, c = (axis + 1) % 3, (axis + 2) % 3
        for side in (-0.5, 0.5):
            corner = np.full((4, 3), side)
            corner[:, b] = (-0.5, 0.5, 0.5, -0.5)
            corner[:, c] = (-0.5, -0.5, 0.5, 0.5)
            faces += [[len(vertices) * 4 + i for i in triangle] for triangle in ((0, 1, 2), (0, 2, 3))]
            vertices.append(center + corner * size)
            uv.append((corner * size)[:, [b, c]] / 0.6)
    return Part("obstacle", np.concatenate(vertices), np.array(faces, np.int32), np.concatenate(uv).astype(np.float32),
                STRIPES, (255, 255, 255), False, False)


def _stripes() -> Bytes:
    x, y = np.meshgrid(np.arange(64), np.arange(64))
    red = ((x + y) // 32 % 2 == 0)[..., None]
    return np.where(red, np.array([200, 30, 25], np.uint8), np.array([235, 235, 230], np.uint8))


STRIPES = _stripes()
