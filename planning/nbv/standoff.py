"""How near a picture's nearest surface is, by the map: what motion blur depends on."""

from __future__ import annotations

import numpy as np

from missions.camera import Camera, Pose
from missions.frames import Array
from missions.grid import OCCUPIED, VoxelGrid
from planning.nbv.rays import first_hits

RAYS_PX = (17, 9)
"""Rays over the picture's width and height; at 8 m and 72 degrees they lie 0.6 m apart."""
REACH_M = 40.0


def nearest_depth_m(grid: VoxelGrid, poses: list[Pose], camera: Camera) -> Array:
    """(n,) depth along the optical axis of the nearest occupied voxel in each picture; inf where there is none."""
    rays = camera.scaled(*RAYS_PX).rays_camera().reshape(-1, 3)
    length = np.linalg.norm(rays, axis=1)
    out = np.full(len(poses), np.inf)
    for n, pose in enumerate(poses):
        directions = (rays / length[:, None]) @ pose.enu_from_camera.T
        start = (np.array(pose.position_enu_m) - grid.origin_enu_m) / grid.voxel_m
        reached = first_hits(grid.state, OCCUPIED, start, directions, REACH_M / grid.voxel_m)
        out[n] = (reached * grid.voxel_m / length).min()
    return out
