"""The voxel grid that perception fills, planning reads and the bus carries."""

from __future__ import annotations

import zlib
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from missions.errors import ProtocolError, UserError
from missions.frames import Array
from missions.messages import MapSnapshot

UNKNOWN, FREE, OCCUPIED = 0, 1, 2
MOST_VOXELS = 30_000_000
"""The ground station holds about 120 bytes per voxel."""


@dataclass(frozen=True)
class VoxelGrid:
    """State of space: `state[i, j, k]` is UNKNOWN, FREE or OCCUPIED for the cube whose lower corner is
    origin_enu_m + (i, j, k) * voxel_m. Outside the grid everything is UNKNOWN, and unknown is not free."""

    origin_enu_m: Array
    voxel_m: float
    state: NDArray[np.uint8]

    @classmethod
    def unknown(cls, lower_enu_m: Array, upper_enu_m: Array, voxel_m: float) -> VoxelGrid:
        """A grid that covers the box and knows nothing. Raises UserError when it would not fit into memory."""
        lower = np.asarray(lower_enu_m, dtype=np.float64)
        shape = np.maximum(1, np.ceil((np.asarray(upper_enu_m) - lower) / voxel_m).astype(int))
        millions = float(np.prod(shape.astype(np.float64))) / 1e6
        if millions > MOST_VOXELS / 1e6:
            told = " x ".join(f"{voxel_m * n:.0f}" for n in shape)
            enough_m = np.ceil(20.0 * 1.02 * voxel_m * (1e6 * millions / MOST_VOXELS) ** (1 / 3)) / 20.0
            raise UserError(f"mission: explore.voxel_m = {voxel_m:g} cuts the geofence of {told} m into {millions:.0f} "
                            f"million voxels, more than {MOST_VOXELS / 1e6:.0f}; raise it to {enough_m:g} or more.")
        return cls(lower, voxel_m, np.full(tuple(shape), UNKNOWN, dtype=np.uint8))

    def index(self, points_enu_m: Array) -> NDArray[np.int64]:
        """(..., 3) integer indices of points; may lie outside the grid."""
        return np.floor((points_enu_m - self.origin_enu_m) / self.voxel_m).astype(np.int64)

    def inside(self, index: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Which indices (..., 3) lie in the grid."""
        result: NDArray[np.bool_] = np.all((index >= 0) & (index < np.array(self.state.shape)), axis=-1)
        return result

    def centers(self, index: NDArray[np.int64]) -> Array:
        """(..., 3) centres of voxels."""
        result: Array = self.origin_enu_m + (index + 0.5) * self.voxel_m
        return result

    def state_at(self, points_enu_m: Array) -> NDArray[np.uint8]:
        """(...) states at points; UNKNOWN outside."""
        index = self.index(np.asarray(points_enu_m, dtype=np.float64))
        ok = self.inside(index)
        i = np.where(ok[..., None], index, 0)
        result: NDArray[np.uint8] = np.where(ok, self.state[i[..., 0], i[..., 1], i[..., 2]], UNKNOWN).astype(np.uint8)
        return result

    def to_message(self, t_ns: int) -> MapSnapshot:
        """The grid as it travels."""
        o, s = self.origin_enu_m, self.state.shape
        return MapSnapshot(t_ns=t_ns, origin_enu_m=(float(o[0]), float(o[1]), float(o[2])), voxel_m=self.voxel_m,
                           shape=(s[0], s[1], s[2]), state_zlib=zlib.compress(self.state.tobytes(), 1))

    @classmethod
    def from_message(cls, message: MapSnapshot) -> VoxelGrid:
        """The grid of a received snapshot. Raises ProtocolError when size and content disagree."""
        count = int(np.prod(message.shape))
        raw = zlib.decompressobj().decompress(message.state_zlib, count + 1)
        if len(raw) != count:
            raise ProtocolError(f"map snapshot of shape {message.shape} holds {len(raw)} voxels")
        state = np.frombuffer(raw, dtype=np.uint8).reshape(message.shape)
        return cls(np.array(message.origin_enu_m), message.voxel_m, state)


@dataclass(frozen=True)
class SurfaceVoxels:
    """What perception believes to be surface, one row per occupied voxel."""

    position_enu_m: Array
    """(n, 3) mean measured position in the voxel."""
    normal_enu: Array
    """(n, 3) unit outward normals, estimated from the points and oriented towards the cameras that saw them."""
    seen_count: NDArray[np.int64]
    """(n,) pictures that measured this voxel."""
