"""Triangles and lines as binary glTF, drawn without lights: shading is in the colours of the corners, which costs a
software renderer a third of what a lit material does. Lines are one pixel wide and cost next to nothing; viser's own
line segments are triangles with a shader of their own, which halve the frame rate where there are thousands.
"""

from __future__ import annotations

import json
import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

FLOAT, UINT, UBYTE = 5126, 5125, 5121
LINES, TRIANGLES = 1, 4


def unlit_glb(vertices: NDArray[np.float32], faces: NDArray[np.uint32], colours: NDArray[np.uint8],
              opacity: float = 1.0) -> bytes:
    """vertices (v, 3), faces (f, 3), sRGB colours (v, 3) to the bytes of a GLB file."""
    return _glb(vertices, faces, colours, TRIANGLES, opacity)


def lines_glb(segments: NDArray[np.float32], colour: tuple[int, int, int]) -> bytes:
    """Line segments (n, 2, 3), at least one."""
    points = segments.reshape(-1, 3)
    return _glb(points, np.arange(len(points), dtype=np.uint32), np.tile(np.array(colour, np.uint8), (len(points), 1)),
                LINES)


def ribbons_glb(segments: NDArray[np.float32], colour: tuple[int, int, int], width_m: float) -> bytes:
    """Line segments (n, 2, 3), at least one, as two crossed bands each: viser frees the geometry of meshes when they
    are replaced, and never that of lines. Seen from both sides without a second shader, which every browser would
    have to compile."""
    start, end = segments[:, 0], segments[:, 1]
    along = end - start
    aside = np.cross(along, np.where(np.abs(along[:, 2:]) > 0.9 * np.linalg.norm(along, axis=1, keepdims=True),
                                     (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)))
    bands = []
    for across in (aside, np.cross(along, aside)):
        half = 0.5 * width_m * across / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-9)
        bands.append(np.stack([start - half, end - half, end + half, start + half], axis=1))
    vertices = np.concatenate(bands).reshape(-1, 3).astype(np.float32)
    corners = np.array([(0, 1, 2), (0, 2, 3), (2, 1, 0), (3, 2, 0)], dtype=np.uint32)
    faces = (4 * np.arange(len(vertices) // 4, dtype=np.uint32)[:, None, None] + corners).reshape(-1, 3)
    return unlit_glb(vertices, faces, np.tile(np.array(colour, np.uint8), (len(vertices), 1)))


def _glb(vertices: NDArray[np.float32], indices: NDArray[np.uint32], colours: NDArray[np.uint8], mode: int,
         opacity: float = 1.0) -> bytes:
    linear = np.round(255.0 * (colours / 255.0) ** 2.2).astype(np.uint8)
    rgba = np.column_stack([linear, np.full(len(linear), round(255.0 * opacity), dtype=np.uint8)])
    parts = [np.ascontiguousarray(vertices, dtype="<f4").tobytes(), rgba.tobytes(),
             np.ascontiguousarray(indices, dtype="<u4").tobytes()]
    starts = np.cumsum([0, *map(len, parts)]).tolist()
    document: dict[str, Any] = {
        "asset": {"version": "2.0"}, "extensionsUsed": ["KHR_materials_unlit"], "scene": 0,
        "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "COLOR_0": 1}, "indices": 2, "material": 0,
                                    "mode": mode}]}],
        "materials": [{"extensions": {"KHR_materials_unlit": {}}, "doubleSided": False,
                       "alphaMode": "OPAQUE" if opacity == 1.0 else "BLEND"}],
        "buffers": [{"byteLength": starts[-1]}],
        "bufferViews": [{"buffer": 0, "byteOffset": s, "byteLength": len(p)}
                        for s, p in zip(starts, parts, strict=False)],
        "accessors": [
            {"bufferView": 0, "componentType": FLOAT, "count": len(vertices), "type": "VEC3",
             "min": vertices.min(axis=0).tolist(), "max": vertices.max(axis=0).tolist()},
            {"bufferView": 1, "componentType": UBYTE, "normalized": True, "count": len(vertices), "type": "VEC4"},
            {"bufferView": 2, "componentType": UINT, "count": int(indices.size), "type": "SCALAR"}],
    }
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    binary = b"".join(parts)
    head = struct.pack("<4sII", b"glTF", 2, 28 + len(text) + len(binary))
    return head + struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary
