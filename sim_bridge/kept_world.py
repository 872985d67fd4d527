"""Scene and light as they were made, in a file: whoever takes a bridge's place neither makes nor imports them again.

Read back, every array is the same, bit by bit.
"""

from __future__ import annotations

import io
import zipfile
from dataclasses import fields
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from missions.messages import Vector
from sim_bridge.render.light import Light
from sim_bridge.scenes.scene import Part, Scene

LIGHT = tuple(f.name for f in fields(Light))


class _PartHead(msgspec.Struct, frozen=True):
    name: str
    color_rgb: tuple[int, int, int]
    is_object: bool
    procedural: bool
    water: bool
    mapped: bool
    texture: int
    """Which of the file's pictures it wears; -1 for none."""


class _Head(msgspec.Struct, frozen=True):
    name: str
    object_min_enu_m: Vector
    object_max_enu_m: Vector
    ground_up_m: float
    notes: list[str]
    parts: list[_PartHead]


def world_bytes(scene: Scene, light: Light) -> bytes:
    """The content of such a file (npz)."""
    textures = {id(p.texture): p.texture for p in scene.parts if p.texture is not None}
    number = {key: n for n, key in enumerate(textures)}
    heads = [_PartHead(p.name, p.color_rgb, p.is_object, p.procedural, p.water, p.uv is not None,
                       number.get(id(p.texture), -1)) for p in scene.parts]
    arrays: dict[str, NDArray[Any]] = {f"texture_{n}": texture for n, texture in enumerate(textures.values())}
    for n, part in enumerate(scene.parts):
        arrays |= {f"vertices_{n}": part.vertices_enu_m, f"faces_{n}": part.faces}
        if part.uv is not None:
            arrays[f"uv_{n}"] = part.uv
    arrays |= {f"light_{name}": getattr(light, name) for name in LIGHT}
    head = _Head(scene.name, scene.object_min_enu_m, scene.object_max_enu_m, scene.ground_up_m, scene.notes, heads)
    file = io.BytesIO()
    np.savez(file, head=np.frombuffer(msgspec.json.encode(head), np.uint8), **arrays)  # type: ignore[arg-type]
    return file.getvalue()


def read_world(path: Path) -> tuple[Scene, Light] | None:
    """None where no whole one is."""
    try:
        with path.open("rb") as file:
            arrays: dict[str, NDArray[Any]] = dict(np.load(file))
        head = msgspec.json.decode(arrays["head"].tobytes(), type=_Head)
        light = Light(**{name: arrays[f"light_{name}"] for name in LIGHT})
    except (OSError, ValueError, KeyError, zipfile.BadZipFile, msgspec.DecodeError):
        return None
    parts = [_part(n, p, arrays) for n, p in enumerate(head.parts)]
    return Scene(head.name, parts, head.object_min_enu_m, head.object_max_enu_m, head.ground_up_m, head.notes), light


def _part(n: int, head: _PartHead, arrays: dict[str, NDArray[Any]]) -> Part:
    uv = arrays[f"uv_{n}"] if head.mapped else None
    texture = arrays[f"texture_{head.texture}"] if head.texture >= 0 else None
    return Part(head.name, arrays[f"vertices_{n}"], arrays[f"faces_{n}"], uv, texture,
                head.color_rgb, head.is_object, head.procedural, head.water)
