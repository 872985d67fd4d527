"""Writing a scene: in the layout of the thesis's Figure 4.2 (NAME.obj, NAME.mtl, textures, bbox/NAME_bbox_bounds.obj),
or its bare triangles in one file."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import PIL.Image
import trimesh
from numpy.typing import NDArray

from missions.errors import UserError
from sim_bridge.scenes.scene import Part, Scene
from sim_bridge.scenes.solids import box
from sim_bridge.scenes.surroundings import PREFIX


def export_scene(scene: Scene, folder: Path) -> Path:
    """Write the scene into folder/NAME and return that folder; load_scene reads the same scene back from it.

    Vertices are written to the nanometre, textures as PNG under relative names. Parts that do not belong to the object
    have names beginning with surroundings_. Raises UserError where the folder cannot be written.
    """
    home = folder / _plain(scene.name)
    names = _part_names(scene.parts)
    try:
        (home / "bbox").mkdir(parents=True, exist_ok=True)
        pictures = _write_textures(scene.parts, names, home)
        (home / f"{home.name}.mtl").write_text(_materials(scene.parts, pictures), encoding="utf-8")
        (home / f"{home.name}.obj").write_text(_geometry(scene.parts, names, home.name), encoding="utf-8")
        (home / "bbox" / f"{home.name}_bbox_bounds.obj").write_text(_bounds(scene), encoding="utf-8")
    except OSError as e:
        raise UserError(f"{home}: cannot be written ({e.strerror}); choose another folder.") from e
    return home


def export_mesh(scene: Scene, path: Path) -> None:
    """Write all triangles of a scene, surroundings included, ENU metres, in the format that the path's suffix names."""
    trimesh.Trimesh(*scene.mesh(), process=False).export(path)


def _plain(name: str) -> str:
    return re.sub(r"[^A-Za-z0-9_.-]+", "_", name) or "scene"


def _part_names(parts: list[Part]) -> list[str]:
    """A name per part that is unique, free of blanks, and prefixed where the part is not of the object."""
    names: list[str] = []
    for part in parts:
        name = _plain(part.name)
        if part.is_object:
            name = name.removeprefix(PREFIX) or "part"
        elif not name.startswith(PREFIX):
            name = PREFIX + name
        number, candidate = 1, name
        while candidate in names:
            number, candidate = number + 1, f"{name}-{number}"
        names.append(candidate)
    return names


def _write_textures(parts: list[Part], names: list[str], home: Path) -> list[str]:
    """PNG file name of each part, empty where it has none; parts that share a picture share the file."""
    written: dict[int, str] = {}
    pictures = []
    for part, name in zip(parts, names, strict=True):
        if part.texture is None:
            pictures.append("")
            continue
        if id(part.texture) not in written:
            written[id(part.texture)] = f"{name}.png"
            PIL.Image.fromarray(part.texture).save(home / f"{name}.png", compress_level=1)
        pictures.append(written[id(part.texture)])
    return pictures


def _materials(parts: list[Part], pictures: list[str]) -> str:
    lines = []
    for i, (part, picture) in enumerate(zip(parts, pictures, strict=True)):
        kd = " ".join(f"{c / 255:.6f}" for c in part.color_rgb)
        lines += [f"newmtl material_{i}", f"Kd {kd}", *([f"map_Kd {picture}"] if picture else [])]
    return "\n".join(lines) + "\n"


def _geometry(parts: list[Part], names: list[str], name: str) -> str:
    lines = [f"mtllib {name}.mtl"]
    for part in parts:
        lines += ["v {:.9f} {:.9f} {:.9f}".format(*v) for v in part.vertices_enu_m.tolist()]
    for part in parts:
        if part.uv is not None:
            lines += ["vt {:.9g} {:.9g}".format(*t) for t in part.uv.tolist()]
    v, vt = 1, 1
    for i, (part, label) in enumerate(zip(parts, names, strict=True)):
        lines += [f"o {label}", f"usemtl material_{i}", *_face_lines(part.faces, v, vt, part.uv is not None)]
        v += len(part.vertices_enu_m)
        vt += len(part.vertices_enu_m) if part.uv is not None else 0
    return "\n".join(lines) + "\n"


def _face_lines(faces: NDArray[np.int32], v: int, vt: int, mapped: bool) -> list[str]:
    if not mapped:
        return ["f {} {} {}".format(*f) for f in (faces + v).tolist()]
    both = np.stack([faces + v, faces + vt], axis=2).reshape(-1, 6)
    return ["f {}/{} {}/{} {}/{}".format(*f) for f in both.tolist()]


def _bounds(scene: Scene) -> str:
    solid = box(scene.object_min_enu_m, scene.object_max_enu_m)
    lines = ["o bounds", *("v {:.9f} {:.9f} {:.9f}".format(*v) for v in solid.vertices_m.tolist())]
    return "\n".join([*lines, *_face_lines(solid.faces, 1, 1, mapped=False)]) + "\n"
