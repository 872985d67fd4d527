"""From posed pictures to a cloud: a depth map per picture, what the depth maps agree on, what neighbours agree on."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from perception.reconstruct.cloud import Cloud, on_grid, without_islands
from perception.reconstruct.depth_stage import depth_maps
from perception.reconstruct.free_space import FARTHEST_DISTANCES, not_looked_through
from perception.reconstruct.fuse_stage import fused
from perception.reconstruct.fusion import PosedDepth
from perception.reconstruct.open_sky import sky_votes
from perception.reconstruct.outliers import without_outliers
from perception.reconstruct.pictures import SurveyPicture, require_enough
from perception.reconstruct.resources import single_threaded_libraries
from perception.reconstruct.settings import Progress, Region, Settings
from perception.wires.stage import thin_members

ISLAND_SPACINGS = 5.0
"""What touches nothing else at this coarse a resolution is an island."""

SKY_REACH = 3.0
"""Pictures from within so many usual distances are asked whether they show sky in the place of a point."""
LEAST_TRUSTED = 3


def reconstruct(pictures: list[SurveyPicture], region: Region, settings: Settings, depth_folder: Path,
                progress: Progress = lambda stage, done, total: None) -> Cloud:
    """Dense cloud of what lies in the region, at most one point per voxel of settings.spacing_m.

    Depth maps, and the points that each picture adds, are kept as .npy files in depth_folder and taken from there when
    the same pictures and settings come again. No more than settings.memory_gib is in memory at a time.
    `progress` is told the stage ("depth", "fuse", "merge"), how much is done, and of how much.
    Raises UserError when there are fewer than three pictures, one cannot be read, or the memory is too little.
    """
    require_enough(pictures)
    with single_threaded_libraries():
        paths = depth_maps(pictures, settings, depth_folder, progress)
        cloud = fused(pictures, paths, region, settings, progress)
        cloud = not_looked_through(cloud, _posed(pictures, paths), pictures[0].camera_at(settings.depth_width_px),
                                   FARTHEST_DISTANCES * settings.distance_m, settings.threads)
    cloud = without_outliers(cloud, settings.spacing_m, settings.threads)
    return without_islands(cloud, ISLAND_SPACINGS * settings.spacing_m)


def _posed(pictures: list[SurveyPicture], paths: list[Path]) -> Iterator[PosedDepth]:
    """One depth map after the other, so that no two are in memory."""
    for picture, path in zip(pictures, paths, strict=True):
        yield PosedDepth(np.load(path), picture.enu_from_camera, picture.position_enu_m)


def with_thin_members(cloud: Cloud, pictures: list[SurveyPicture], region: Region, settings: Settings,
                      progress: Progress = lambda stage, done, total: None) -> Cloud:
    """The cloud with points on wires and other thin members, without what has open sky in its place.

    pictures: those whose poses can be trusted to a pixel; with fewer than three the cloud stays as it is.
    `progress` is told "lines", "wires" and "sky".
    """
    if len(pictures) < LEAST_TRUSTED:
        return cloud
    reach_m, island_m = SKY_REACH * settings.distance_m, ISLAND_SPACINGS * settings.spacing_m
    with single_threaded_libraries():
        thin = thin_members(pictures, region, settings, progress)
        both = Cloud.concatenate([cloud, thin])
        solid = sky_votes(both.points_enu_m.astype(np.float64), pictures, reach_m, settings.threads, progress) == 0
    dense = without_islands(cloud.select(solid[:len(cloud)]), island_m)
    return on_grid(Cloud.concatenate([dense, thin.select(solid[len(cloud):])]), settings.spacing_m)
