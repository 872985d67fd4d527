"""What perception knows of the distances in one picture."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from missions.camera import Camera, Pose

Image = NDArray[np.float32]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class DepthMap:
    """Depth of one picture at the resolution of `camera` (which may be smaller than the picture's own)."""

    camera: Camera
    pose: Pose
    depth_m: Image
    """(h, w) distance along the optical axis; meaningful where valid."""
    valid: Mask
    """(h, w) trusted pixels."""
    confidence: Image
    """(h, w) 0 to 1; after the check against neighbours the chance that the relative error is below 5 %."""
    sky: Mask
    """(h, w) pixels that show open sky beyond doubt; never valid at the same time."""
    sigma_per_depth2: float
    """Standard deviation of depth over depth squared, 1/m: pixel error / (focal length x baseline)."""
    beyond: Mask = field(default_factory=lambda: np.zeros((1, 1), np.bool_))
    """(h, w), or (1, 1) for all alike: pixels without a trusted depth that likely show nothing within any sensing
    range; never valid."""

    sight: Image = field(default_factory=lambda: np.ones((1, 1), np.float32))
    """(h, w), or (1, 1) for all alike: the inverse depth, 1/m, up to which the pixel's ray was looked along from
    elsewhere; what is nearer went unseen."""

    def sigma_m(self) -> Image:
        """(h, w) standard deviation of depth."""
        result: Image = (self.sigma_per_depth2 * self.depth_m**2).astype(np.float32)
        return result
