"""Occupancy of a map with the unseen imagined."""

from __future__ import annotations

import math
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from missions.errors import UserError
from missions.frames import Array
from missions.grid import FREE, OCCUPIED, VoxelGrid
from perception.imagination.window import Window, known

if TYPE_CHECKING:
    from perception.imagination.network import ImaginationNet

WEIGHTS = Path(__file__).parent / "weights" / "imagination.safetensors"
OUTSIDE_PER_M = 0.03
"""Chance per metre that unknown space far from the object's box stops a ray."""


class Imagination:
    """A trained network. Torch is imported when it is first asked."""

    def __init__(self, path: Path, device: str = "cpu") -> None:
        self._path, self._device = path, device

    @classmethod
    def load(cls, path: Path | None = None, device: str = "cpu") -> Imagination:
        """With the weights that ship, or those in a safetensors file. Raises UserError when there is no such file."""
        path = path or WEIGHTS
        if not path.is_file():
            raise UserError(f"there are no weights at {path}; train some with python -m "
                            "perception.imagination.train.")
        return cls(path, device)

    def occupancy(self, grid: VoxelGrid, object_min_enu_m: Array, object_max_enu_m: Array,
                  ground_up_m: float) -> NDArray[np.float32]:
        """(i, j, k) probability that each voxel of the grid is solid: 0 where known free, 1 where known occupied.

        In the window around the object's box the network says; beyond it OUTSIDE_PER_M, and 1 under the ground. It was
        trained on voxels of 0.4 to 0.6 m where cameras see 25 m far.
        """
        result = np.full(grid.state.shape, 1.0 - math.exp(-OUTSIDE_PER_M * grid.voxel_m), dtype=np.float32)
        under = int(np.clip((ground_up_m - grid.origin_enu_m[2]) // grid.voxel_m, 0, grid.state.shape[2]))
        result[:, :, :under] = 1.0
        window = Window.around(grid, object_min_enu_m, object_max_enu_m, ground_up_m)
        place = window.place(grid, object_min_enu_m, object_max_enu_m, ground_up_m)
        part = window.within(grid.state.shape)
        imagined = self._infer(known(window.cut(grid.state)), place)
        result[part] = imagined[tuple(slice(0, p.stop - p.start) for p in part)]
        result[grid.state == FREE] = 0.0
        result[grid.state == OCCUPIED] = 1.0
        return result

    @cached_property
    def _net(self) -> ImaginationNet:
        from perception.imagination.checkpoint import load_net

        return load_net(self._path).to(self._device).eval()

    def _infer(self, known_: NDArray[np.float32], place: NDArray[np.float32]) -> NDArray[np.float32]:
        import torch

        with torch.inference_mode():
            given = (torch.from_numpy(a)[None].to(self._device) for a in (known_, place))
            chance = torch.sigmoid(self._net(*given))[0]
        result: NDArray[np.float32] = chance.cpu().numpy()
        return result
