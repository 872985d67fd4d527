"""A coloured surface through the cloud: screened Poisson reconstruction (Kazhdan and Hoppe 2013, in Open3D)."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import open3d as o3d
from numpy.typing import NDArray

from missions.errors import UserError
from perception.products.surface import Surface
from perception.reconstruct.cloud import Cloud, on_grid

METHOD = 1
"""Raised whenever the mesh changes for the same cloud."""
MAX_DEPTH = 10
TRIM_SPACINGS = 2.0
"""Surface farther from any point than this many spacings is the solver's guess, and is cut."""
LEAST_FRAGMENT = 12.0
"""Smaller pieces (in squares of the spacing) that hang on nothing are left out."""


def poisson_mesh(cloud: Cloud, spacing_m: float) -> Surface:
    """Triangles with vertex colours, only where the cloud is; details of spacing_m are kept."""
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
    mesh.remove_vertices_by_mask((distance > TRIM_SPACINGS * spacing_m).tolist())
    surface = Surface.of(mesh)
    return surface.select(standing(surface, spacing_m))


def standing(surface: Surface, spacing_m: float) -> NDArray[np.bool_]:
    """(f,) which triangles belong to connected pieces that are no fragments."""
    with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
        piece, _, area = surface.open3d().cluster_connected_triangles()
    return np.asarray(np.asarray(area)[np.asarray(piece)] >= LEAST_FRAGMENT * spacing_m**2)


def simplified(surface: Surface, triangles: int) -> Surface:
    """With at most so many triangles: the flattest edges go first (quadric errors, Garland and Heckbert 1997)."""
    if len(surface) <= triangles:
        return surface
    return Surface.of(surface.open3d().simplify_quadric_decimation(triangles))


def write_mesh(surface: Surface, path: Path) -> None:
    """Binary PLY with vertex colours and normals."""
    mesh = surface.open3d()
    mesh.compute_vertex_normals()
    if not o3d.io.write_triangle_mesh(path, mesh):
        raise UserError(f"{path}: cannot be written; free some disk space or choose another run folder.")


def read_mesh(path: Path) -> Surface:
    """What write_mesh wrote. Raises UserError when there is none."""
    mesh = o3d.io.read_triangle_mesh(path) if path.is_file() else o3d.geometry.TriangleMesh()
    if not mesh.has_triangles() or not mesh.has_vertex_colors():
        raise UserError(f"{path}: no mesh with colours; run 'swarmscan reconstruct' on the run folder.")
    return Surface.of(mesh)
