"""What of the object no picture has shown yet, on the map with the unseen imagined."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from missions.camera import Pose
from missions.frames import Array
from missions.grid import VoxelGrid
from missions.messages import SiteBrief
from missions.mission import Mission
from missions.pads import surface_box
from perception.imagination.adapt import make_imagination
from planning.nbv.coverage import SurfaceTally, surface_tally
from planning.nbv.shown import ShownFaces
from planning.nbv.sights import ImaginedMap

RAYS_ACROSS = 60
"""Rays by which a picture is counted: a voxel of half a metre apart at the end of the sensing range."""


class Novelty:
    """Keeps what the pictures have shown."""

    def __init__(self, mission: Mission, site: SiteBrief) -> None:
        self._mission, self._site = mission, site
        camera = mission.camera.explore_camera()
        self._coarse = camera.scaled(RAYS_ACROSS, math.ceil(RAYS_ACROSS * camera.height_px / camera.width_px))
        self._range_m = mission.explore.sensing_range_m
        self._imagination = make_imagination(mission.explore.adapt)
        self._shown = ShownFaces(self._coarse, self._range_m)

    def add(self, pose: Pose) -> None:
        """A picture was taken."""
        self._shown.add(pose)

    def imagined(self, grid: VoxelGrid) -> ImaginedMap:
        """The map, with as new what no picture has shown."""
        object_min, object_max = np.array(self._site.object_min_enu_m), np.array(self._site.object_max_enu_m)
        occupancy = self._imagination.occupancy(grid, object_min, object_max, self._site.ground_up_m)
        imagined = ImaginedMap.new(grid.origin_enu_m, grid.voxel_m, occupancy, self._box(grid))
        self._shown.take_out(imagined)
        return imagined

    def tally(self, grid: VoxelGrid, imagined: ImaginedMap, positions_enu_m: Array) -> SurfaceTally:
        """What of the object's surface was seen, and what views from positions (p, 3) are expected to show of it."""
        return surface_tally(imagined, self._box(grid), positions_enu_m, self._range_m)

    def without(self, imagined: ImaginedMap, claimed: list[Pose]) -> ImaginedMap:
        """The same map, with nothing new in what pictures will show that vehicles are on their way to take."""
        result = replace(imagined, unseen=imagined.unseen.copy())
        for pose in claimed:
            result.show(pose, self._coarse, self._range_m)
        return result

    def _box(self, grid: VoxelGrid) -> tuple[slice, ...]:
        return _indices(grid, *surface_box(self._mission, self._site))


def _indices(grid: VoxelGrid, lower_enu_m: Array, upper_enu_m: Array) -> tuple[slice, ...]:
    """The voxels that a box touches."""
    first, last = np.maximum(grid.index(lower_enu_m), 0), grid.index(upper_enu_m) + 1
    return tuple(slice(int(a), int(b)) for a, b in zip(first, last, strict=True))
