"""What motion takes out of a battery, in percent: by the power model, or by Algorithm 1 of the thesis.

Both answer the same questions, so whoever plans or flies need not know which one a mission has chosen.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Protocol

import numpy as np
from scipy.ndimage import map_coordinates

from missions.frames import Array
from missions.mission import AirframeSpec, Mission, WindSpec
from planning.trajectories import Curve, Limits, State, Via, fly_run, leg_time_s
from planning.trajectories.power import PowerModel, fit

STEP_S = 0.5
"""Longest interval of one quadrature; its error is below 1e-6 of the energy."""
NODES, WEIGHTS = np.polynomial.legendre.leggauss(4)
LENGTHS_M = np.geomspace(0.1, 300.0, 25)
ELEVATIONS = 13
HEADINGS = 17


class Energy(Protocol):
    """Battery consumption, percent of a full battery."""

    def curve_percent(self, curve: Curve, from_s: float = 0.0, to_s: float | None = None) -> float:
        """Of flying this part of a curve; from its end on it is hovered."""

    def leg_percent(self, displacement_enu_m: Array, length_m: Array, seconds: Array) -> Array:
        """(...) of flying from rest to rest over displacements (..., 3) on paths of these lengths in these seconds.

        Seconds beyond what the straight leg needs are reckoned as hovering: turning, settling, waiting, slow detours.
        """

    def rest_percent(self, seconds: float) -> float:
        """Of hovering."""


@dataclass(frozen=True)
class DistanceEnergy:
    """Algorithm 1 of the thesis: percent per metre flown."""

    percent_per_m: float

    def curve_percent(self, curve: Curve, from_s: float = 0.0, to_s: float | None = None) -> float:
        """By the length of the curve."""
        t_s, weight_s = quadrature(curve, from_s, to_s)
        return self.percent_per_m * float(weight_s @ np.linalg.norm(curve.at(t_s)[1], axis=-1))

    def leg_percent(self, displacement_enu_m: Array, length_m: Array, seconds: Array) -> Array:
        """By the length alone."""
        return np.asarray(self.percent_per_m * (length_m + np.zeros_like(seconds)))

    def rest_percent(self, seconds: float) -> float:
        """Hovering costs nothing."""
        return 0.0


@dataclass(frozen=True)
class PowerEnergy:
    """The power model integrated over motion, in a steady wind (3,)."""

    model: PowerModel
    battery_j: float
    wind_enu_m_s: Array
    limits: Limits
    """Of the legs in `leg_percent`."""
    _mean_w: Array = field(init=False, repr=False, compare=False)
    """(lengths, elevations, headings): mean power over straight legs from rest to rest."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "_mean_w", self._tabulated())

    def curve_percent(self, curve: Curve, from_s: float = 0.0, to_s: float | None = None) -> float:
        """Integrated over every piece of the curve."""
        t_s, weight_s = quadrature(curve, from_s, to_s)
        _, velocity, acceleration = curve.at(t_s)
        return self._percent(float(weight_s @ self.model.power_w(velocity, acceleration, self.wind_enu_m_s)))

    def leg_percent(self, displacement_enu_m: Array, length_m: Array, seconds: Array) -> Array:
        """Mean power by length, climb and heading, interpolated in a table."""
        flying_s = np.minimum(seconds, leg_time_s(length_m, self.limits))
        watts = self._leg_w(np.asarray(displacement_enu_m, dtype=np.float64), np.asarray(length_m, dtype=np.float64))
        joules = watts * flying_s + self._hover_w * (seconds - flying_s)
        return np.asarray(joules * (100.0 / self.battery_j))

    def rest_percent(self, seconds: float) -> float:
        """Power at rest in the wind."""
        return self._percent(self._hover_w * seconds)

    @property
    def _hover_w(self) -> float:
        return float(self.model.power_w(np.zeros(3), np.zeros(3), self.wind_enu_m_s))

    def _percent(self, joules: float) -> float:
        return 100.0 * joules / self.battery_j

    def _leg_w(self, displacement_m: Array, length_m: Array) -> Array:
        span = np.log(LENGTHS_M[-1] / LENGTHS_M[0])
        length = np.log(np.maximum(length_m, LENGTHS_M[0]) / LENGTHS_M[0]) / span * (len(LENGTHS_M) - 1)
        flat = np.hypot(displacement_m[..., 0], displacement_m[..., 1])
        up = displacement_m[..., 2]
        climb = np.arctan2(up, np.sqrt(np.maximum(length_m**2 - up**2, flat**2)))
        heading = np.arctan2(displacement_m[..., 1], displacement_m[..., 0])
        at = np.stack(np.broadcast_arrays(length, (climb / math.pi + 0.5) * (ELEVATIONS - 1),
                                          (heading / (2.0 * math.pi) + 0.5) * (HEADINGS - 1)))
        watts = map_coordinates(self._mean_w, at.reshape(3, -1), order=1, mode="nearest")
        return np.asarray(watts.reshape(at.shape[1:]))

    def _tabulated(self) -> Array:
        up = np.linspace(-0.5 * math.pi, 0.5 * math.pi, ELEVATIONS)[:, None]
        around = np.linspace(-math.pi, math.pi, HEADINGS)
        directions = np.stack(np.broadcast_arrays(np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)),
                              axis=-1)
        return np.stack([self._mean_power_w(float(length), directions) for length in LENGTHS_M])

    def _mean_power_w(self, length_m: float, directions: Array) -> Array:
        goal = Via(np.array([length_m, 0.0, 0.0]), 0.0)
        leg = fly_run(State.at_rest(np.zeros(3)), 0.0, 0.0, [goal], self.limits).curve
        t_s, weight_s = quadrature(leg, 0.0, None)
        _, velocity, acceleration = leg.at(t_s)
        watts = self.model.power_w(velocity[:, 0, None, None, None] * directions,
                                   acceleration[:, 0, None, None, None] * directions, self.wind_enu_m_s)
        return np.asarray(np.tensordot(weight_s, watts, axes=1) / leg.duration_s)


def energy_of(mission: Mission) -> Energy:
    """What a mission's vehicles consume. Raises UserError when the airframe's figures contradict each other."""
    if mission.battery.model == "distance":
        return DistanceEnergy(mission.battery.percent_per_m)
    return _power_energy(mission.airframe, mission.wind, Limits.of_fleet(mission.fleet))


@lru_cache(maxsize=16)
def _power_energy(airframe: AirframeSpec, wind: WindSpec, limits: Limits) -> PowerEnergy:
    return PowerEnergy(fit(airframe), 3600.0 * airframe.battery_wh, np.array(wind.velocity_enu_m_s), limits)


def stops_percent(energy: Energy, points_enu_m: Array, rest_s: Array | float, limits: Limits) -> Array:
    """(k,) of flying from each of the points (k + 1, 3) straight to the next, stopping at each for rest_s (k,).

    That is the most that a flight over these points takes: what is passed at speed costs less.
    """
    displacement = np.diff(points_enu_m, axis=0)
    length = np.linalg.norm(displacement, axis=1)
    return energy.leg_percent(displacement, length, leg_time_s(length, limits) + rest_s)


def quadrature(curve: Curve, from_s: float, to_s: float | None) -> tuple[Array, Array]:
    """Times (n,) and weights (n,) that integrate what is smooth on every piece of a curve (Gauss-Legendre)."""
    to_s = curve.duration_s if to_s is None else to_s
    inside = curve.knots_s[(curve.knots_s > from_s) & (curve.knots_s < to_s)]
    breaks = np.concatenate([[from_s], inside, [max(to_s, from_s)]])
    parts = np.maximum(np.ceil(np.diff(breaks) / STEP_S), 1.0).astype(np.int64)
    step = np.repeat(np.diff(breaks) / parts, parts)
    nth = np.arange(len(step)) - np.repeat(np.cumsum(parts) - parts, parts)
    start = np.repeat(breaks[:-1], parts) + nth * step
    t_s = start[:, None] + 0.5 * step[:, None] * (NODES + 1.0)
    return t_s.ravel(), (0.5 * step[:, None] * WEIGHTS).ravel()
