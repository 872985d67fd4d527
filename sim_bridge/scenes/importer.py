"""Reading parts from a mesh file, or from a folder laid out as in the thesis's Figure 4.2."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import PIL.Image
import trimesh
from numpy.typing import NDArray

from missions.errors import UserError
from sim_bridge.scenes.assets import Assets
from sim_bridge.scenes.repair import Repairs, mended, without_doubles
from sim_bridge.scenes.scene import Image, Part
from sim_bridge.scenes.surroundings import PREFIX

FORMATS = (".glb", ".gltf", ".obj", ".ply", ".stl")
GREY = (168, 166, 162)
Y_UP = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])

Array = NDArray[np.float64]
Box = tuple[Array, Array]


@dataclass(frozen=True)
class Imported:
    """Parts of a file in metres, the object's box where the folder states one, and what was found on the way."""

    name: str
    parts: list[Part]
    bounds: Box | None
    notes: list[str]


def import_parts(path: Path, units_per_metre: float, up: str = "z") -> Imported:
    """Read a GLB, OBJ, PLY or STL file, or a folder with one OBJ and bbox/*_bounds.obj.

    Coordinates stay as they are in the file, turned if y is up in it, divided by units_per_metre. Raises UserError.
    """
    turn = Y_UP if up == "y" else np.eye(4)
    file = _mesh_file(path)
    assets, repairs = Assets(file.parent), Repairs()
    world = _read(file, assets)
    pictures = Pictures()
    parts = []
    nodes = list(world.graph.nodes_geometry)
    for node in nodes if file.suffix.lower() != ".obj" else nodes[::-1]:
        transform, geometry = world.graph[node]
        mesh = world.geometry[geometry]
        if isinstance(mesh, trimesh.Trimesh):
            part = _part(str(geometry), mesh, turn @ transform, units_per_metre, pictures, repairs)
            if len(part.faces):
                parts.append(part)
    if not parts:
        found = "; ".join(repairs.notes()) or "it is empty"
        raise UserError(f"{file}: has no usable triangle ({found}); export the scene as a triangle mesh.")
    parts = without_doubles(parts, repairs)
    bare = sum(p.procedural for p in parts)
    notes = [*repairs.notes(), *assets.notes(), *pictures.notes()]
    if bare:
        notes.append(f"{bare} of {len(parts)} parts have no texture; a procedural one is put on them")
    return Imported(file.stem, parts, _stated_bounds(path, units_per_metre, turn), notes)


class Pictures:
    """Textures as arrays, one per picture however many parts share it."""

    def __init__(self) -> None:
        self._arrays: dict[tuple[int, tuple[int, ...]], Image] = {}
        self._kept: list[PIL.Image.Image] = []
        self._broken = 0

    def array(self, picture: PIL.Image.Image, factor_rgb: tuple[int, ...] = (255, 255, 255)) -> Image | None:
        """(h, w, 3) uint8 under a colour factor, or None where the picture cannot be decoded."""
        key = (id(picture), factor_rgb)
        if key not in self._arrays:
            try:
                pixels = np.asarray(picture.convert("RGB"), dtype=np.uint8)
            except (OSError, ValueError):
                self._broken += 1
                return None
            factor = np.array(factor_rgb, np.float32) / 255.0
            self._kept.append(picture)
            self._arrays[key] = pixels if (factor == 1.0).all() else np.round(pixels * factor).astype(np.uint8)
        return self._arrays[key]

    def notes(self) -> list[str]:
        """What could not be decoded."""
        return [f"{self._broken} embedded pictures cannot be decoded"] if self._broken else []


def _mesh_file(path: Path) -> Path:
    if path.is_dir():
        candidates = sorted(path.glob("*.obj")) or sorted(path.glob("*.glb"))
        named = [c for c in candidates if c.stem == path.name]
        if not candidates:
            raise UserError(f"{path}: holds no OBJ file; give a folder with NAME.obj, or a mesh file.")
        if len(candidates) > 1 and not named:
            raise UserError(f"{path}: holds {len(candidates)} OBJ files; name the scene's {path.name}.obj, or give "
                            "the file itself.")
        return (named or candidates)[0]
    if not path.is_file():
        raise UserError(f"{path}: no such file or folder; check scene.path.")
    if path.suffix.lower() not in FORMATS:
        raise UserError(f"{path}: cannot read {path.suffix or 'a file without extension'}; give "
                        f"{', '.join(FORMATS)} or a folder.")
    return path


def _read(file: Path, assets: Assets) -> trimesh.Scene:
    kind = file.suffix.lower()[1:]
    splitting = {"split_objects": True, "group_material": True} if kind == "obj" else {}
    try:
        with file.open("rb") as stream:
            world = trimesh.load_scene(stream, file_type=kind, resolver=assets, process=False, **splitting)
    except Exception as e:  # the readers raise whatever a broken file makes them raise
        raise UserError(f"{file}: cannot be read as {kind.upper()} ({type(e).__name__}: {e}); export it again.") from e
    return world


def _part(name: str, mesh: trimesh.Trimesh, transform: Array, units_per_metre: float, pictures: Pictures,
          repairs: Repairs) -> Part:
    vertices = np.asarray(mesh.vertices, dtype=np.float64)
    if not np.array_equal(transform, np.eye(4)):
        vertices = vertices @ transform[:3, :3].T + transform[:3, 3]
    if units_per_metre != 1.0:
        vertices = vertices / units_per_metre
    faces = np.asarray(mesh.faces, dtype=np.int64).reshape(-1, 3)
    if np.linalg.det(transform[:3, :3]) < 0:
        faces = faces[:, ::-1]
    texture, color, material = _material(mesh.visual, pictures)
    uv = None if texture is None else getattr(mesh.visual, "uv", None)
    uv = np.asarray(uv, dtype=np.float32) if uv is not None and len(uv) == len(vertices) else None
    vertices, small, uv = mended(vertices, faces, uv, repairs)
    texture = None if uv is None else texture
    name = name.removesuffix(f"_{material}")
    return Part(name, vertices, small, uv, texture, color, not name.startswith(PREFIX), procedural=texture is None)


def _material(visual: Any, pictures: Pictures) -> tuple[Image | None, tuple[int, int, int], str]:
    """Texture, plain colour and name of a mesh's material."""
    material = getattr(visual, "material", None)
    if material is None:
        colors = getattr(visual, "vertex_colors", None) if getattr(visual, "defined", False) else None
        mean = GREY if colors is None or not len(colors) else np.asarray(colors)[:, :3].mean(axis=0)
        return None, _rgb(mean), ""
    physical = hasattr(material, "baseColorTexture")
    factor = material.baseColorFactor if physical else material.diffuse
    color = GREY if factor is None else _rgb(np.asarray(factor)[:3])
    picture = material.baseColorTexture if physical else material.image
    if picture is None:
        return None, color, str(material.name)
    tint = color if physical and factor is not None else (255, 255, 255)
    return pictures.array(picture, tint), color, str(material.name)


def _rgb(values: Any) -> tuple[int, int, int]:
    red, green, blue = (round(float(v)) for v in values)
    return red, green, blue


def _stated_bounds(path: Path, units_per_metre: float, turn: Array) -> Box | None:
    """The object's box from bbox/*_bounds.obj, where a folder has one."""
    files = sorted(path.glob("bbox/*bounds.obj")) if path.is_dir() else []
    if not files:
        return None
    corners = _read(files[0], Assets(files[0].parent)).bounds
    if corners is None or not np.isfinite(corners).all() or (corners[1] - corners[0] <= 0).any():
        raise UserError(f"{files[0]}: the object's box has no size; export the box again or delete the file.")
    corners = corners @ turn[:3, :3].T / units_per_metre
    return corners.min(axis=0), corners.max(axis=0)
