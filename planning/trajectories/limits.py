"""What a vehicle can do."""

from __future__ import annotations

import math
from dataclasses import dataclass

from missions.mission import FleetSpec
from planning.trajectories import profile


@dataclass(frozen=True)
class Limits:
    """Norms of speed, acceleration and jerk, and the slew rate of yaw and gimbal."""

    speed_m_s: float
    acceleration_m_s2: float
    jerk_m_s3: float
    slew_rad_s: float = math.inf

    @classmethod
    def of_fleet(cls, fleet: FleetSpec) -> Limits:
        """The limits of a mission's vehicles."""
        return cls(fleet.speed_m_s, fleet.acceleration_m_s2, fleet.jerk_m_s3, math.radians(fleet.yaw_rate_deg_s))

    @property
    def motion(self) -> tuple[float, float, float]:
        """Speed, acceleration, jerk."""
        return float(self.speed_m_s), float(self.acceleration_m_s2), float(self.jerk_m_s3)

    @property
    def stopping_distance_m(self) -> float:
        """From full speed to rest, starting at zero acceleration."""
        speed, *rates = self.motion
        return float(profile.ramp_m(speed, 0.0, *rates))


def shutter_speed_m_s(distance_m: float, focal_px: float, exposure_s: float, max_blur_px: float,
                      gsd_m: float) -> float:
    """How fast the camera may pass a surface at a distance while the shutter is open.

    A point of the surface moves v t f / d pixels over the picture, at most max_blur_px; the camera moves v t over the
    surface, at most one ground sample gsd_m. (The camera is at rest relative to the body then.)
    """
    return min(max_blur_px * distance_m / focal_px, gsd_m) / exposure_s
