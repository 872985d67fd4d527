"""Triangles as arrays, who their neighbours are, and rays against them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import open3d as o3d
from numpy.typing import NDArray

from missions.frames import Array


@dataclass(frozen=True)
class Surface:
    """Vertices (n, 3) ENU metres with colours (n, 3) uint8 RGB, and triangles (f, 3) that face outwards."""

    vertices_enu_m: Array
    colours: NDArray[np.uint8]
    triangles: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.triangles)

    @cached_property
    def corners_enu_m(self) -> Array:
        """(f, 3 corners, 3)."""
        return np.asarray(self.vertices_enu_m[self.triangles])

    @cached_property
    def centres_enu_m(self) -> Array:
        """(f, 3)."""
        return np.asarray(self.corners_enu_m.mean(axis=1))

    @cached_property
    def normals_enu(self) -> Array:
        """(f, 3) unit normals; zero where a triangle has no area."""
        a, b, c = (self.corners_enu_m[:, k] for k in range(3))
        normal = np.cross(b - a, c - a)
        return np.asarray(normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12))

    @cached_property
    def shared_edges(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """(e, 2) pairs of triangles that share an edge, and (e, 2) the vertices of that edge."""
        count = len(self.vertices_enu_m)
        ends = np.sort(self.triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
        key = ends[:, 0] * count + ends[:, 1]
        order = np.argsort(key, kind="stable")
        same = np.flatnonzero(key[order[1:]] == key[order[:-1]])
        pairs = np.column_stack([order[same], order[same + 1]])
        return pairs // 3, ends[pairs[:, 0]]

    @cached_property
    def rays(self) -> o3d.t.geometry.RaycastingScene:
        """Embree's tree."""
        scene = o3d.t.geometry.RaycastingScene()
        scene.add_triangles(o3d.core.Tensor.from_numpy(self.vertices_enu_m.astype(np.float32)),
                            o3d.core.Tensor.from_numpy(self.triangles.astype(np.uint32)))
        return scene

    @classmethod
    def of(cls, mesh: o3d.geometry.TriangleMesh) -> Surface:
        """The same as Open3D has it."""
        colours = np.rint(255.0 * np.asarray(mesh.vertex_colors)).astype(np.uint8)
        return cls(np.asarray(mesh.vertices).astype(np.float64), colours.reshape(-1, 3),
                   np.asarray(mesh.triangles).astype(np.int64))

    def open3d(self) -> o3d.geometry.TriangleMesh:
        """The same for Open3D."""
        mesh = o3d.geometry.TriangleMesh(o3d.utility.Vector3dVector(self.vertices_enu_m),
                                         o3d.utility.Vector3iVector(self.triangles.astype(np.int32)))
        mesh.vertex_colors = o3d.utility.Vector3dVector(self.colours / 255.0)
        return mesh

    def select(self, which: NDArray[np.bool_]) -> Surface:
        """The triangles (f,) that are true, and the vertices that they need."""
        used, index = np.unique(self.triangles[which], return_inverse=True)
        return Surface(self.vertices_enu_m[used], self.colours[used], index.reshape(-1, 3))
