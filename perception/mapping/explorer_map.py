"""From pictures to map, one picture at a time: what the ground station holds while it explores."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray

from missions.camera import Camera, Pose
from missions.frames import Array
from missions.grid import SurfaceVoxels, VoxelGrid
from perception.depth.depth_map import DepthMap
from perception.depth.pictures import PictureDepths
from perception.depth.plane_sweep import SweepSettings
from perception.mapping.voxel_map import MapSettings, VoxelMap


class ExplorerMap:
    """Pictures with poses in, voxel map out. Deterministic: the same calls give the same map.

    body_m: half edge of the box around a camera that its vehicle's own presence proves free.
    """

    def __init__(self, lower_enu_m: Array, upper_enu_m: Array, voxel_m: float, body_m: float,
                 map_settings: MapSettings | None = None, sweep_settings: SweepSettings | None = None, sources: int = 4,
                 min_sources: int = 2, workers: int = 4) -> None:
        self.voxels = VoxelMap(lower_enu_m, upper_enu_m, voxel_m, map_settings)
        self._depths = PictureDepths(sweep_settings, sources, min_sources, workers)
        self._integrated: dict[int, DepthMap] = {}
        self._body_m, self._workers = body_m, workers

    def add_picture(self, rgb: NDArray[np.uint8], camera: Camera, pose: Pose) -> int:
        """Takes a picture (h, w, 3) in; returns its index. Nothing is mapped before `update`."""
        at = np.array(pose.position_enu_m)
        self.voxels.mark_free(at - self._body_m, at + self._body_m)
        return self._depths.add(rgb, camera, pose)

    def update(self) -> list[int]:
        """Maps every picture that has enough sources by now; indices of pictures mapped or mapped anew."""
        mapped = self._depths.update()
        now = {i: depth for i in mapped if (depth := self._depths.depth(i)) is not None}
        out = [self._integrated[i] for i in mapped if i in self._integrated]
        with ThreadPoolExecutor(self._workers) as pool:
            for evidence, sign in zip(pool.map(self.voxels.evidence, [*out, *now.values()]),
                                      [-1] * len(out) + [1] * len(now), strict=True):
                self.voxels.add(evidence, sign)
        self._integrated |= now
        return mapped

    def depth(self, index: int) -> DepthMap | None:
        """What was integrated for a picture, if anything."""
        return self._integrated.get(index)

    def mark_free(self, lower_enu_m: Array, upper_enu_m: Array) -> None:
        """Declares a box free that is known to be, such as a take-off column."""
        self.voxels.mark_free(lower_enu_m, upper_enu_m)

    def hold_free(self, known: VoxelGrid, from_enu_m: Array, to_enu_m: Array, radius_m: float) -> None:
        """What an earlier map knew to be free around a way that was flown stays so until it is seen to be solid."""
        self.voxels.hold_free(known, from_enu_m, to_enu_m, radius_m)

    def grid(self) -> VoxelGrid:
        """Free, occupied, unknown."""
        return self.voxels.grid()

    def surface(self) -> SurfaceVoxels:
        """Known surface."""
        return self.voxels.surface()

    def surface_points(self) -> Array:
        """(n, 3) where known surface was measured."""
        return self.voxels.surface_points()

    def adrift(self) -> NDArray[np.bool_]:
        """(n,) which of `surface_points` are likelier stray depth than something solid."""
        return self.voxels.adrift()
