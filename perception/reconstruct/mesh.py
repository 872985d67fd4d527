"""A coloured surface through the cloud: screened Poisson reconstruction (Kazhdan and Hoppe 2013, in Open3D)."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import open3d as o3d

from missions.errors import UserError
from perception.reconstruct.cloud import Cloud, on_grid

MESH_SPACING_M = 0.06
MAX_DEPTH = 10


def poisson_mesh(cloud: Cloud, spacing_m: float = MESH_SPACING_M, trim_m: float = 0.15) -> o3d.geometry.TriangleMesh:
    """Triangles with vertex colours; surface farther than trim_m from any point is the solver's guess and is cut."""
    thinned = on_grid(cloud, spacing_m)
    data = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(thinned.points_enu_m.astype(np.float64)))
    data.normals = o3d.utility.Vector3dVector(thinned.normals.astype(np.float64))
    data.colors = o3d.utility.Vector3dVector(thinned.colours / 255.0)
    extent = float(np.ptp(thinned.points_enu_m, axis=0).max())
    depth = min(MAX_DEPTH, max(5, math.ceil(math.log2(1.1 * extent / spacing_m)) - 1))
    with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
        mesh, _ = o3d.geometry.TriangleMesh.create_from_point_cloud_poisson(data, depth=depth, n_threads=3)
    vertices = o3d.geometry.PointCloud(mesh.vertices)
    distance = np.asarray(vertices.compute_point_cloud_distance(data))
    mesh.remove_vertices_by_mask((distance > trim_m).tolist())
    return mesh


def write_mesh(mesh: o3d.geometry.TriangleMesh, path: Path) -> None:
    """Binary PLY with vertex colours and normals."""
    mesh.compute_vertex_normals()
    if not o3d.io.write_triangle_mesh(path, mesh):
        raise UserError(f"{path}: cannot be written; free some disk space or choose another run folder.")
