"""The referee: true collisions, clearances and separations of the flown paths, judged against the true scene.

Between two states a vehicle's path is the quintic that meets position, velocity and acceleration at both ends. Paths
are sampled on one time grid for the whole fleet, finer than 0.02 s and than 5 cm at the fleet's speed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from missions.clock import SECOND_NS
from missions.frames import Array
from missions.messages import Vector, VehicleState
from missions.mission import FleetSpec
from sim_bridge.truth import Mask, Truth

Times = NDArray[np.int64]

SAMPLE_S = 0.02
SAMPLE_M = 0.05
PAD_COLUMN_M = 1.5
"""Within this horizontal distance of its own pad a vehicle takes off and lands."""
PAD_CONTACT_M = 1.0
"""Up to this height above the parked position, nearness to the ground is no collision in the column."""
SINKING_M_S = 0.2
"""Who moves slower than this over ground takes off or lands straight: an emergency landing makes its own column."""
PAD_HEIGHT_M = 3.0
"""In the column, up to this height above the parked position, clearance is not counted."""
BATCH_NS = 5 * SECOND_NS


@dataclass
class _Track:
    """States of one vehicle that have not been judged yet, the last judged one first."""

    pad_enu_m: Array
    states: list[VehicleState] = field(default_factory=list)
    touching: bool = False


@dataclass(frozen=True)
class _Samples:
    position_enu_m: Array
    """(T, 3)"""
    flying: Mask
    """(T,)"""


class Referee:
    """Feed it every VehicleState; read the verdict at the end."""

    def __init__(self, truth: Truth, fleet: FleetSpec) -> None:
        self._truth, self._fleet = truth, fleet
        self._step_ns = round(min(SAMPLE_S, SAMPLE_M / fleet.speed_m_s) * SECOND_NS)
        self._tracks: dict[int, _Track] = {}
        self._near: dict[tuple[int, int], bool] = {}
        self._judged = 0
        self.collision_events: list[dict[str, object]] = []
        self.min_clearance_m = math.inf
        self.min_separation_m = math.inf

    def see(self, state: VehicleState) -> None:
        """Take note of a state; judges a batch when enough flight has gathered."""
        track = self._tracks.setdefault(state.vehicle_id, _Track(np.array(state.position_enu_m)))
        if track.states and state.t_ns <= track.states[-1].t_ns:
            return
        track.states.append(state)
        horizon = min(t.states[-1].t_ns for t in self._tracks.values())
        if horizon - self._judged * self._step_ns >= BATCH_NS:
            self._judge(horizon)

    def finish(self) -> None:
        """Judge everything that is still waiting."""
        if self._tracks:
            self._judge(max(t.states[-1].t_ns for t in self._tracks.values()))

    def summary(self) -> dict[str, object]:
        """The numbers for referee.json; a distance that never was is null."""
        return {"collisions": len(self.collision_events), "collision_events": self.collision_events,
                "min_clearance_m": _finite(self.min_clearance_m), "min_separation_m": _finite(self.min_separation_m)}

    def _judge(self, until_ns: int) -> None:
        """Judge the samples after the last judged one up to until_ns."""
        last = until_ns // self._step_ns
        times: Times = np.arange(self._judged, last + 1, dtype=np.int64) * self._step_ns
        self._judged = last + 1
        samples = {k: _sample(track.states, times) for k, track in sorted(self._tracks.items())}
        for vehicle_id, s in samples.items():
            self._judge_scene(vehicle_id, s, times)
        self._judge_pairs(samples, times)
        for track in self._tracks.values():
            keep = sum(s.t_ns <= self._judged * self._step_ns for s in track.states) - 1
            del track.states[:max(0, keep)]

    def _judge_scene(self, vehicle_id: int, samples: _Samples, times: Times) -> None:
        track = self._tracks[vehicle_id]
        index = np.flatnonzero(samples.flying)
        if not len(index):
            return
        position, t = samples.position_enu_m[index], times[index]
        distance = self._truth.distance(position, t)
        aside = np.linalg.norm(position[:, :2] - track.pad_enu_m[:2], axis=1) > PAD_COLUMN_M
        height = position[:, 2] - track.pad_enu_m[2]
        drift = np.linalg.norm(np.diff(position[:, :2], axis=0, prepend=position[:1, :2]), axis=1)
        straight = drift < SINKING_M_S * self._step_ns / SECOND_NS
        free = aside | (height > PAD_HEIGHT_M)
        self.min_clearance_m = min(self.min_clearance_m, float(distance[free].min(initial=math.inf)))
        touching = (distance < self._fleet.radius_m) & ((aside & ~straight) | (height > PAD_CONTACT_M))
        if touching.any() or track.touching:  # flight deep inside a solid goes on with the event that led there
            touching |= ~touching & free & self._truth.inside(position)
        for k in _onsets(touching, track.touching):
            self._collision(vehicle_id, "scene", int(t[k]), position[k])
        track.touching = bool(touching[-1])

    def _judge_pairs(self, samples: dict[int, _Samples], times: Times) -> None:
        ids = list(samples)
        for i, a in enumerate(ids):
            for b in ids[i + 1:]:
                both = samples[a].flying & samples[b].flying
                apart = np.linalg.norm(samples[a].position_enu_m - samples[b].position_enu_m, axis=1)
                apart = np.where(both, apart, math.inf)
                self.min_separation_m = min(self.min_separation_m, float(apart.min(initial=math.inf)))
                near = apart < 2.0 * self._fleet.radius_m
                for k in _onsets(near, self._near.get((a, b), False)):
                    self._collision(a, f"uav{b}", int(times[k]), samples[a].position_enu_m[k])
                if len(near):
                    self._near[a, b] = bool(near[-1])

    def _collision(self, vehicle_id: int, other: str, t_ns: int, position_enu_m: Array) -> None:
        e, n, u = (round(float(c), 3) for c in position_enu_m)
        where: Vector = (e, n, u)
        self.collision_events.append({"vehicle_id": vehicle_id, "with": other, "t_s": t_ns / SECOND_NS,
                                      "position_enu_m": where})


def _sample(states: list[VehicleState], times: Times) -> _Samples:
    """A vehicle's path at these times; before its first and after its last state it does not fly."""
    t = np.array([s.t_ns for s in states], dtype=np.int64)
    p = np.array([s.position_enu_m for s in states])
    v = np.array([s.velocity_enu_m_s for s in states])
    a = np.array([s.acceleration_enu_m_s2 for s in states])
    flying = np.array([s.flying for s in states])
    i = np.clip(np.searchsorted(t, times, side="right") - 1, 0, max(0, len(t) - 2))
    j = np.minimum(i + 1, len(t) - 1)
    h = np.maximum(t[j] - t[i], 1)[:, None] / SECOND_NS
    u = np.clip((times - t[i])[:, None] / SECOND_NS / h, 0.0, 1.0)
    inside = (times >= t[0]) & (times <= t[-1])
    return _Samples(quintic(u, h, (p[i], v[i], a[i]), (p[j], v[j], a[j])), inside & flying[i] & flying[j])


def quintic(u: Array, h_s: Array, start: tuple[Array, Array, Array], end: tuple[Array, Array, Array]) -> Array:
    """Position (n, 3) at shares u (n, 1) of spans h_s (n, 1) between two (position, velocity, acceleration)."""
    u2, u3, u4, u5 = u**2, u**3, u**4, u**5
    rise = 10 * u3 - 15 * u4 + 6 * u5
    result: Array = (
        (1 - rise) * start[0] + rise * end[0]
        + h_s * ((u - 6 * u3 + 8 * u4 - 3 * u5) * start[1] + (-4 * u3 + 7 * u4 - 3 * u5) * end[1])
        + 0.5 * h_s**2 * ((u2 - 3 * u3 + 3 * u4 - u5) * start[2] + (u3 - 2 * u4 + u5) * end[2]))
    return result


def _onsets(on: Mask, before: bool) -> NDArray[np.int64]:
    """Indices where a condition begins to hold."""
    result: NDArray[np.int64] = np.flatnonzero(on & ~np.concatenate([[before], on[:-1]]))
    return result


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
