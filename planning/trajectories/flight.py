"""What is flown: motion of body and camera, and how to stop it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from missions.frames import Array, wrap_pi
from planning.trajectories.curve import Curve
from planning.trajectories.leg import brake
from planning.trajectories.limits import Limits

STOP_SPARE_M = 1e-6


@dataclass(frozen=True)
class Flight:
    """Motion of body and camera. `reached_s[i]` is when via i is reached or passed nearest; settling follows."""

    curve: Curve
    reached_s: Array
    turn_s: Array
    """(m,) knots of the camera's turn."""
    yaw_rad: Array
    """(m,) yaw at the knots, unwrapped; linear in between."""
    elevation_rad: Array
    limits: Limits | None = None
    """What it was planned with; None where nothing is left to brake."""
    straights_s: Array = field(default_factory=lambda: np.zeros((0, 2)))
    """(k, 2) when each straight begins and ends; in between corners are blended, or turned at rest."""

    @property
    def duration_s(self) -> float:
        """Settling included."""
        return self.curve.duration_s

    def attitude(self, t_s: float) -> tuple[float, float]:
        """(yaw, elevation) at a time, radians."""
        yaw = float(np.interp(t_s, self.turn_s, self.yaw_rad))
        return wrap_pi(yaw), float(np.interp(t_s, self.turn_s, self.elevation_rad))

    def stop(self, t_s: float) -> Flight:
        """From t_s on the earliest rest without leaving the planned path; the camera stays as it is.

        On a straight the vehicle brakes; what cannot stop before the next blend flies through it and brakes on the
        straight after it, which is always long enough.
        """
        t_s = min(max(t_s, 0.0), self.duration_s)
        parts = self._stopping(t_s, self.limits) if self.limits is not None else []
        curve = Curve.chain(parts or [self.curve.part(t_s, self.duration_s)])
        yaw, elevation = self.attitude(t_s)
        return Flight(curve, np.array([curve.duration_s]), np.zeros(1), np.array([yaw]), np.array([elevation]))

    def _stopping(self, t_s: float, limits: Limits) -> list[Curve]:
        for begin, end in self.straights_s[self.straights_s[:, 1] > t_s]:
            followed_s = max(t_s, float(begin))
            stop = brake(self.curve.state(followed_s), limits)
            needed, room = (float(np.linalg.norm(p - stop.at(0.0)[0])) for p in (stop.end, self.curve.at(end)[0]))
            if needed <= room + STOP_SPARE_M:
                return [self.curve.part(t_s, followed_s), stop]
        return []


def joined(flights: list[Flight]) -> Flight:
    """One after the other; each starts where the one before ends."""
    offsets = np.cumsum([0.0, *(f.duration_s for f in flights[:-1])])

    def shifted(name: str) -> Array:
        return np.concatenate([getattr(f, name) + o for f, o in zip(flights, offsets, strict=True)])

    yaw = np.unwrap(np.concatenate([f.yaw_rad for f in flights]))
    elevation = np.concatenate([f.elevation_rad for f in flights])
    return Flight(Curve.chain([f.curve for f in flights]), shifted("reached_s"), shifted("turn_s"), yaw, elevation,
                  flights[0].limits, shifted("straights_s"))
