"""Motion with piecewise constant jerk, evaluated exactly at any time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from missions.frames import Array
from planning.trajectories import profile


@dataclass(frozen=True)
class State:
    """Position, velocity and acceleration of a point, each (3,), SI."""

    position: Array
    velocity: Array
    acceleration: Array

    @classmethod
    def at_rest(cls, position: Array) -> State:
        """Standing still."""
        return cls(np.asarray(position, dtype=np.float64), np.zeros(3), np.zeros(3))

    @property
    def moving(self) -> bool:
        """Whether this is anything but rest."""
        return bool(np.abs(self.velocity).max() > 1e-9 or np.abs(self.acceleration).max() > 1e-9)


class Curve:
    """Pieces of constant jerk: piece i starts at start_s[i] with position, velocity, acceleration [i], (k, 3) each.

    Before the start and after the end the curve stays in its first and last state, at rest if it ends at rest.
    """

    def __init__(self, start_s: Array, position: Array, velocity: Array, acceleration: Array, jerk: Array,
                 duration_s: float) -> None:
        self._start, self._p, self._v, self._a, self._j = start_s, position, velocity, acceleration, jerk
        self.duration_s = duration_s

    @classmethod
    def hold(cls, position: Array, duration_s: float) -> Curve:
        """Standing still for a while."""
        zero = np.zeros((1, 3))
        return cls(np.zeros(1), np.array(position, dtype=np.float64)[None], zero, zero, zero, duration_s)

    @classmethod
    def integrated(cls, start: State, spans_s: Array, jerks: Array) -> Curve:
        """From a state on with jerks (n, 3), each for its span (n,), n at least 1."""
        times, p, v, a = profile.integrate(start.position, start.velocity, start.acceleration, spans_s, jerks)
        return cls(times, p, v, a, jerks, float(spans_s.sum()))

    @classmethod
    def chain(cls, curves: list[Curve]) -> Curve:
        """One after the other; each starts where the one before ends."""
        offsets = np.concatenate([[0.0], np.cumsum([c.duration_s for c in curves])])
        start = np.concatenate([c._start + o for c, o in zip(curves, offsets, strict=False)])
        p, v, a, j = (np.concatenate([getattr(c, name) for c in curves]) for name in ("_p", "_v", "_a", "_j"))
        return cls(start, p, v, a, j, float(offsets[-1]))

    def part(self, from_s: float, to_s: float) -> Curve:
        """What lies between two times, as a curve of its own."""
        inside = np.flatnonzero((self._start > from_s) & (self._start < to_s))
        first = max(int(np.searchsorted(self._start, from_s, side="right")) - 1, 0)
        keep = np.concatenate([[first], inside[inside > first]])
        start = np.maximum(self._start[keep] - from_s, 0.0)
        p, v, a = self._p[keep].copy(), self._v[keep].copy(), self._a[keep].copy()
        p[0], v[0], a[0] = self.at(from_s)
        return Curve(start, p, v, a, self._j[keep], to_s - from_s)

    def crossing_s(self, from_s: float, to_s: float, origin: Array, direction: Array, wanted_m: float) -> float:
        """When motion that does not turn back is wanted_m from origin (3,) along direction (3,), between two times."""
        pieces = (self._start, self._p, self._v, self._a, self._j)
        return float(profile.crossing_s(*pieces, from_s, to_s, origin, direction, wanted_m))

    def at(self, t_s: Array | float) -> tuple[Array, Array, Array]:
        """(position, velocity, acceleration) at times (...), each (..., 3)."""
        t = np.clip(np.asarray(t_s, dtype=np.float64), 0.0, self.duration_s)
        i = np.maximum(np.searchsorted(self._start, t, side="right") - 1, 0)
        dt = (t - self._start[i])[..., None]
        p, v, a, j = self._p[i], self._v[i], self._a[i], self._j[i]
        return (p + dt * (v + dt * (a / 2.0 + dt * j / 6.0)), v + dt * (a + dt * j / 2.0), a + dt * j)

    def state(self, t_s: float) -> State:
        """The state at one time."""
        return State(*self.at(t_s))

    @property
    def knots_s(self) -> Array:
        """(k + 1,) where the pieces begin, and the end."""
        return np.append(self._start, self.duration_s)

    @property
    def end(self) -> Array:
        """(3,) where the curve ends."""
        return self.at(self.duration_s)[0]

    def sample(self, step_s: float, from_s: float = 0.0) -> tuple[Array, Array]:
        """Times (n,) at this step from from_s, the end included, and positions (n, 3)."""
        t = np.append(np.arange(from_s, self.duration_s - 1e-9, step_s), self.duration_s)
        return t, self.at(t)[0]
