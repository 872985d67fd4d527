"""From pictures to map, one picture at a time: what the ground station holds while it explores."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from missions.camera import Camera, Pose
from missions.frames import Array
from missions.grid import FREE, OCCUPIED, UNKNOWN, SurfaceVoxels, VoxelGrid
from perception.depth.consistency import votes
from perception.depth.depth_map import DepthMap
from perception.depth.plane_sweep import Frame, SweepSettings, estimate, make_frame
from perception.depth.sources import choose_sources, source_scores
from perception.mapping.voxel_map import MapSettings, VoxelMap

CANDIDATES = 48
"""Nearest pictures considered as sources."""
NEAR_M = 7.0
"""New pictures further away than this are no reason to look for better sources."""
BODY_M = 0.3
"""Half edge of the box that a camera's own presence proves free."""
BETTER = 1.5
"""A picture is estimated anew when its sources' total score has grown by this factor."""


@dataclass
class _Picture:
    frame: Frame
    depth: DepthMap | None = None
    integrated: DepthMap | None = None
    score: float = 0.0
    estimates: int = 0


class ExplorerMap:
    """Pictures with poses in, voxel map out. Deterministic: the same calls give the same map."""

    def __init__(self, lower_enu_m: Array, upper_enu_m: Array, voxel_m: float, map_settings: MapSettings | None = None,
                 sweep_settings: SweepSettings | None = None, sources: int = 4, min_sources: int = 2,
                 workers: int = 4) -> None:
        self.voxels = VoxelMap(lower_enu_m, upper_enu_m, voxel_m, map_settings)
        self._sweep = sweep_settings or SweepSettings()
        self._count, self._least = sources, min_sources
        self._pictures: list[_Picture] = []
        self._considered = 0
        self._workers = ThreadPoolExecutor(workers)

    def add_picture(self, rgb: NDArray[np.uint8], camera: Camera, pose: Pose) -> int:
        """Takes a picture (h, w, 3) in; returns its index. Nothing is mapped before `update`."""
        self._pictures.append(_Picture(make_frame(rgb, camera, pose, self._sweep.shrink)))
        at = np.array(pose.position_enu_m)
        self.voxels.mark_free(at - BODY_M, at + BODY_M)
        return len(self._pictures) - 1

    def update(self) -> list[int]:
        """Maps every picture that has enough sources by now; indices of pictures mapped or mapped anew."""
        work = [(i, sources) for i in self._affected() if (sources := self._new_sources(i))]
        self._considered = len(self._pictures)
        frames = [(self._pictures[i].frame, [self._pictures[k].frame for k in sources]) for i, sources in work]
        depths = self._workers.map(lambda pair: estimate(pair[0], pair[1], self._sweep), frames)
        mapped = [i for i, _ in work]
        for i, depth in zip(mapped, depths, strict=True):
            self._pictures[i].depth = depth
        for i, depth in zip(mapped, self._workers.map(self._checked, mapped), strict=True):
            self._integrate(self._pictures[i], depth)
        return mapped

    def depth(self, index: int) -> DepthMap | None:
        """What was integrated for a picture, if anything."""
        return self._pictures[index].integrated

    def mark_free(self, lower_enu_m: Array, upper_enu_m: Array) -> None:
        """Declares a box free that is known to be, such as a take-off column."""
        self.voxels.mark_free(lower_enu_m, upper_enu_m)

    def grid(self) -> VoxelGrid:
        """Free, occupied, unknown."""
        return self.voxels.grid()

    def surface(self) -> SurfaceVoxels:
        """Known surface."""
        return self.voxels.surface()

    def predicted_coverage(self, lower_enu_m: Array, upper_enu_m: Array) -> float:
        """Share of the surface in a box believed to be mapped, from the map alone."""
        return predicted_coverage(self.grid(), lower_enu_m, upper_enu_m)

    def _affected(self) -> list[int]:
        """Pictures that may be estimated for the first or second time because of those added since the last update."""
        position = np.array([p.frame.pose.position_enu_m for p in self._pictures]).reshape(-1, 3)
        new = position[self._considered :]
        return [i for i, p in enumerate(self._pictures)
                if p.estimates < 2 and (np.linalg.norm(new - position[i], axis=1) < NEAR_M).any()]

    def _new_sources(self, index: int) -> list[int]:
        """Sources for a picture that has no depth yet, or that can have a much better one; else nothing."""
        picture = self._pictures[index]
        if picture.estimates >= 2:
            return []
        near = self._near(index)
        poses = [self._pictures[i].frame.pose for i in near]
        chosen = choose_sources(picture.frame.pose, poses, picture.frame.camera, self._count)
        if len(chosen) < self._least:
            return []
        score = float(source_scores(picture.frame.pose, [poses[i] for i in chosen], picture.frame.camera).sum())
        if picture.estimates == 1 and score < BETTER * picture.score:
            return []
        picture.score, picture.estimates = score, picture.estimates + 1
        return [near[i] for i in chosen]

    def _checked(self, index: int) -> DepthMap:
        """A picture's depth map checked against those of its neighbours."""
        depth = self._pictures[index].depth
        assert depth is not None
        return checked(depth, [d for i in self._near(index)[:12] if (d := self._pictures[i].depth) is not None])

    def _integrate(self, picture: _Picture, depth: DepthMap) -> None:
        """Puts a depth map into the map in place of the picture's older one."""
        if picture.integrated is not None:
            self.voxels.integrate(picture.integrated, sign=-1)
        picture.integrated = depth
        self.voxels.integrate(depth)

    def _near(self, index: int) -> list[int]:
        """Other pictures, nearest first."""
        position = np.array([p.frame.pose.position_enu_m for p in self._pictures])
        order = np.argsort(np.linalg.norm(position - position[index], axis=1), kind="stable")
        return [int(i) for i in order if i != index][:CANDIDATES]


def checked(depth: DepthMap, others: list[DepthMap]) -> DepthMap:
    """The depth map without pixels that more of the others see through than confirm, or that none confirms."""
    agree, against = votes(depth, others)
    good = depth.valid & (agree >= 1) & (agree >= against)
    return replace(depth, valid=good, confidence=np.where(good, depth.confidence, np.float32(0.0)))


def predicted_coverage(grid: VoxelGrid, lower_enu_m: Array, upper_enu_m: Array) -> float:
    """Occupied voxels in a box over those plus its frontier, the unknown voxels that touch free space; 0 at first."""
    low = np.maximum(grid.index(np.asarray(lower_enu_m, float)), 0)
    high = np.maximum(grid.index(np.asarray(upper_enu_m, float)) + 1, 0)
    rim = np.minimum(low, 1)
    around = grid.state[tuple(slice(int(a), int(b)) for a, b in zip(low - rim, high + 1, strict=True))]
    box = tuple(slice(int(a), int(b)) for a, b in zip(rim, high - low + rim, strict=True))
    frontier = (around == UNKNOWN) & ndimage.binary_dilation(around == FREE)
    known = int((around[box] == OCCUPIED).sum())
    return known / max(known + int(frontier[box].sum()), 1)
