"""A textured surface as OBJ with MTL and PNG, and as GLB."""

from __future__ import annotations

import io
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import cv2
import numpy as np
import trimesh
from numpy.typing import NDArray
from PIL import Image
from trimesh.visual.material import PBRMaterial

from missions.errors import UserError
from missions.frames import Array
from perception.products.atlas import Textured
from perception.products.surface import Surface

GLTF_FROM_ENU = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
"""glTF's y is up and its z towards the viewer."""
JPEG_QUALITY = 90
MATERIAL = "model"
OBJ, MTL, PNG, GLB = (f"{MATERIAL}.{kind}" for kind in ("obj", "mtl", "png", "glb"))
ROWS_AT_A_TIME = 10_000
Places = tuple[Array, NDArray[np.int64]]
"""Texture coordinates (m, 2), and which one each corner (f, 3) has."""


def write_model(model: Textured, folder: Path) -> None:
    """OBJ (with MTL and PNG) and, last, GLB. Raises UserError when they cannot be written."""
    places = _places(model)
    try:
        with ThreadPoolExecutor(1) as pool:  # the PNG takes as long as everything else
            picture = pool.submit(Image.fromarray(model.image).save, folder / PNG, compress_level=1)
            _write_obj(model, places, folder)
            glb = _glb(model, places)
            picture.result()
        (folder / GLB).write_bytes(glb)
    except OSError as e:
        raise UserError(f"{folder}: cannot be written ({e.strerror or e}); free some disk space or choose another run "
                        "folder.") from e


def _write_obj(model: Textured, places: Places, folder: Path) -> None:
    """OBJ in ENU metres and its MTL."""
    obj, mtl = folder / OBJ, folder / MTL
    mtl.write_text(f"newmtl {MATERIAL}\nKa 0 0 0\nKd 1 1 1\nKs 0 0 0\nillum 1\nmap_Kd {PNG}\n", encoding="ascii")
    uv, uv_of_corner = places
    corners = np.stack([model.surface.triangles + 1, uv_of_corner + 1], axis=2).reshape(-1, 6)
    with obj.open("w", encoding="ascii") as f:
        f.write(f"# East, North, Up in metres\nmtllib {mtl.name}\nusemtl {MATERIAL}\n")
        f.writelines(_lines("v %.4f %.4f %.4f\n", model.surface.vertices_enu_m))
        f.writelines(_lines("vt %.6f %.6f\n", uv))
        f.writelines(_lines("f %d/%d %d/%d %d/%d\n", corners))


def _lines(pattern: str, rows: NDArray[np.generic]) -> Iterator[str]:
    """One line per row, many formatted at a time, which is five times as fast as one by one."""
    for begin in range(0, len(rows), ROWS_AT_A_TIME):
        some = rows[begin:begin + ROWS_AT_A_TIME]
        yield pattern * len(some) % tuple(some.ravel().tolist())


def _glb(model: Textured, places: Places) -> bytes:
    """Binary glTF 2.0, y up, its texture a JPEG."""
    uv, uv_of_corner = places
    vertex_of_uv = np.zeros(len(uv), np.int64)
    vertex_of_uv[uv_of_corner] = model.surface.triangles
    stream = io.BytesIO()
    Image.fromarray(model.image).save(stream, "JPEG", quality=JPEG_QUALITY, subsampling=0)
    material = PBRMaterial(name=MATERIAL, baseColorTexture=Image.open(stream), metallicFactor=0.0,
                           roughnessFactor=1.0, doubleSided=True)
    mesh = trimesh.Trimesh((model.surface.vertices_enu_m @ GLTF_FROM_ENU.T)[vertex_of_uv], uv_of_corner, process=False,
                           visual=trimesh.visual.TextureVisuals(uv=uv, material=material))
    return bytes(mesh.export(file_type="glb"))


def has_model(folder: Path) -> bool:
    """Whether write_model was done with it."""
    return (folder / GLB).is_file() and (folder / PNG).is_file()


def read_model(folder: Path) -> Textured:
    """What write_model wrote, by its GLB, with the texture of the PNG. Raises UserError when there is none."""
    if not has_model(folder):
        raise UserError(f"{folder}: no textured model; run 'swarmscan reconstruct' with reconstruct.mesh and "
                        "reconstruct.texture in mission.toml.")
    mesh = next(iter(trimesh.load_scene(folder / GLB, process=False).geometry.values()))
    image = cv2.imread(str(folder / PNG), cv2.IMREAD_COLOR_RGB)
    if image is None:
        raise UserError(f"{folder / PNG}: not a readable picture; run 'swarmscan reconstruct' on the run folder.")
    uv = np.column_stack([mesh.visual.uv[:, 0], 1.0 - mesh.visual.uv[:, 1]]) * image.shape[1::-1]
    triangles = np.asarray(mesh.faces, np.int64)
    vertices = np.asarray(mesh.vertices, np.float64) @ GLTF_FROM_ENU
    surface = Surface(vertices, np.zeros((len(vertices), 3), np.uint8), triangles)
    return Textured(surface, np.asarray(image, np.uint8), uv[triangles].astype(np.float32))


def _places(model: Textured) -> Places:
    """(m, 2) different texture coordinates, 0 to 1 to the right and up, and (f, 3) which one each corner has.

    Two corners share one only where they share their vertex too.
    """
    vertex = model.surface.triangles.reshape(-1)
    key = np.column_stack([vertex, np.rint(model.corner_px.reshape(-1, 2) * 16.0).astype(np.int64)])
    _, first, which = np.unique(key, axis=0, return_index=True, return_inverse=True)
    side = np.array(model.image.shape[1::-1])
    uv = model.corner_px.reshape(-1, 2)[first] / side
    return np.column_stack([uv[:, 0], 1.0 - uv[:, 1]]), which.reshape(-1, 3)
