"""Walks around a structure with true depth and true solid space: what imagination is trained on, never flown on.

Lengths are in metres of a copy of the structure that is scaled so that pictures count as far as they do in a mission.
"""

from __future__ import annotations

import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from missions.camera import Camera, Pose
from missions.errors import UserError
from missions.frames import Array

SUFFIX = ".walk.npz"


@dataclass(frozen=True)
class TrainingWalk:
    """n frames of one or more vehicles that take turns, and the voxels of the space around."""

    scene: str
    camera: Camera
    object_min_enu_m: Array
    object_max_enu_m: Array
    ground_up_m: float
    origin_enu_m: Array
    """Lower corner of the voxels."""
    voxel_m: float
    solid: NDArray[np.bool_]
    """(i, j, k) voxels that hold surface, or that nothing from outside can see into."""
    poses: Array
    """(n, 5) position ENU, yaw, elevation, in the order of capture."""
    key_poses: NDArray[np.int64]
    """(n,) number of key poses taken once this frame is."""
    depth_m: NDArray[np.float16]
    """(n, h, w) along the optical axis, inf where there is only sky."""
    rgb: NDArray[np.uint8] | None = None
    """(n, 2 h, 2 w, 3) pictures, where the walk was written with some."""

    def pose(self, frame: int) -> Pose:
        """Where a frame was taken."""
        x, y, z, yaw, elevation = (float(v) for v in self.poses[frame])
        return Pose((x, y, z), yaw, elevation)

    def save(self, path: Path) -> None:
        """Write as npz without pickle."""
        c = self.camera
        camera = np.array([c.width_px, c.height_px, c.fx_px, c.fy_px, c.cx_px, c.cy_px])
        pictures: dict[str, Any] = {} if self.rgb is None else {"rgb": self.rgb}
        np.savez_compressed(
            path, scene=np.array(self.scene), camera=camera,
            box=np.stack([self.object_min_enu_m, self.object_max_enu_m]), ground_up_m=np.array(self.ground_up_m),
            origin_enu_m=self.origin_enu_m, voxel_m=np.array(self.voxel_m), solid=np.packbits(self.solid),
            shape=np.array(self.solid.shape), poses=self.poses, key_poses=self.key_poses, depth_m=self.depth_m,
            **pictures)

    @classmethod
    def load(cls, path: Path) -> TrainingWalk:
        """Read what `save` wrote. Raises UserError naming the file when it is not that."""
        try:
            with np.load(path, allow_pickle=False) as d:
                width, height, *lens = (float(v) for v in d["camera"])
                shape = tuple(int(n) for n in d["shape"])
                solid = np.unpackbits(d["solid"], count=int(np.prod(shape))).reshape(shape).astype(np.bool_)
                return cls(str(d["scene"]), Camera(int(width), int(height), *lens), d["box"][0], d["box"][1],
                           float(d["ground_up_m"]), d["origin_enu_m"], float(d["voxel_m"]), solid, d["poses"],
                           d["key_poses"], d["depth_m"], d.get("rgb"))
        except (OSError, KeyError, ValueError, zipfile.BadZipFile) as e:
            raise UserError(f"{path} is no training walk ({e}); write it anew with `swarmscan scenes walks`.") from e


def walk_files(folder: Path) -> list[Path]:
    """The walks in a folder by name. Raises UserError when there are none."""
    found = sorted(folder.glob(f"*{SUFFIX}"))
    if not found:
        raise UserError(f"{folder} holds no training walks (*{SUFFIX}); write some with `swarmscan scenes walks`.")
    return found
