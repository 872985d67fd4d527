"""The course of a run: a polyline of corners, what is asked for along it, and the quickest motion that does it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from missions.frames import Array
from planning.trajectories import profile
from planning.trajectories.blend import blend, outline
from planning.trajectories.curve import Curve
from planning.trajectories.leg import straight
from planning.trajectories.limits import Limits

EXACT_M = 0.02
"""MAVLink rounds positions to about 1 cm, so a waypoint that is passed this near counts as passed exactly."""
SAME_M = 1e-7
TIGHTER = 3
"""A blend that is not free is halved until it is, so often at most; else the vehicle stops there."""
Clear = Callable[[Array], bool]


@dataclass(frozen=True)
class Via:
    """A point to fly through: position (3,), the camera's yaw and elevation there, whether to come to rest.

    One that is no stop may be passed pass_m beside, at speed_m_s or slower.
    """

    position: Array
    yaw_rad: float
    elevation_rad: float = 0.0
    stop: bool = True
    settle_s: float = 0.0
    pass_m: float = 0.0
    speed_m_s: float = math.inf


@dataclass(frozen=True)
class Motion:
    """How a course is flown: when each via is reached, and when each straight begins and ends."""

    curve: Curve
    reached_s: Array
    straights_s: Array


class Course:
    """Points are counted from 0, the start; via i is point i + 1.

    Nodes are the points at which the speed is chosen: corners, and points on straights that turned out to need it.
    """

    def __init__(self, start_enu_m: Array, vias: list[Via], turn_s: Array, limits: Limits) -> None:
        """turn_s (n,): what the camera needs from point i to via i."""
        self._limits, self._vias, self._turn_s, self._rates = limits, vias, turn_s, limits.motion[1:]
        self._points = np.array([start_enu_m, *(v.position for v in vias)], dtype=np.float64)
        n = len(self._points)
        self._corners = _corners(self._points)
        self._along, self._direction = _measured(self._points, self._corners)
        self._flown_through = _on_straights(self._points, self._along, self._direction, self._corners)
        self._nodes = set(self._corners)
        self._bend, self._highest, self._least_s = np.zeros(n), np.zeros(n), np.zeros(n - 1)
        self._tight: set[int] = set()
        self._free: dict[tuple[int, float], Curve] = {}
        for i, via in enumerate(vias[:-1], 1):
            self._highest[i] = 0.0 if via.stop else min(limits.speed_m_s, via.speed_m_s)
        for a, b in pairwise(self._corners):
            self._least_s[a] = turn_s[a] if b == a + 1 else 0.0
        for i in self._corners[1:-1]:
            self._bend[i] = 0.5 * float(np.linalg.norm(self._direction[i + 1] - self._direction[i]))
            self._highest[i] = self._corner_speed(i, float(np.diff(self._along[i - 1:i + 2]).min()))

    def motion(self, clear: Clear | None) -> Motion:
        """The quickest motion: planned again with what turned out to be too fast, too quick to turn or not free."""
        while True:
            nodes = sorted(self._nodes)
            speed, least_s = self._planned(nodes)
            if clear is not None and self._tighten(speed, clear):
                continue
            motion = self._flown(nodes, speed, least_s)
            if not (self._slow_down(motion) or self._stretch(motion)):
                return motion

    def _planned(self, nodes: list[int]) -> tuple[Array, Array]:
        """Speeds at all points (n,), 0 at those that are no nodes, and what each way between nodes takes at least."""
        least = np.array([self._least_s[a] if b == a + 1 else 0.0 for a, b in pairwise(nodes)])
        speed = np.zeros(len(self._points))
        speed[nodes] = profile.plan_speeds(self._highest[nodes], self._bend[nodes], np.diff(self._along[nodes]), least,
                                           self._beyond(nodes), *self._limits.motion)
        return speed, least

    def _slow_down(self, motion: Motion) -> bool:
        """Take up the points on straights that are passed too fast; whether there are any."""
        passed = np.setdiff1d(np.arange(1, len(self._points)), list(self._nodes))
        speed = np.linalg.norm(motion.curve.at(motion.reached_s[passed - 1])[1], axis=1)
        fast = passed[speed > self._highest[passed] * (1.0 + 1e-6)]
        self._nodes.update(int(i) for i in fast)
        return len(fast) > 0

    def _stretch(self, motion: Motion) -> bool:
        """Take up the stretches from via to via on which the camera cannot turn in time; whether there are any."""
        late = np.flatnonzero((np.diff(motion.reached_s, prepend=0.0) < self._turn_s - 1e-9) & (self._least_s == 0.0))
        self._least_s[late] = self._turn_s[late]
        self._nodes.update(int(i) for i in late)
        self._nodes.update(int(i) + 1 for i in late)
        return len(late) > 0

    def _tighten(self, speed: Array, clear: Clear) -> bool:
        """Fly the blends that are not free more tightly, or not at all; whether there are any."""
        blends = [(i, float(speed[i])) for i in self._corners if self._half_s(i, speed[i]) > 0.0]
        blocked = [(i, v) for i, v in blends if not self._is_free(i, v, clear)]
        for i, v in blocked:
            self._highest[i] = 0.0 if i in self._tight else self._clear_speed(i, v, clear)
            self._tight.add(i)
        return len(blocked) > 0

    def _is_free(self, i: int, speed: float, clear: Clear) -> bool:
        if (i, speed) not in self._free:
            curve = self._blend(i, speed)
            if not clear(outline(curve, self._limits)):
                return False
            self._free[i, speed] = curve
        return True

    def _clear_speed(self, i: int, speed: float, clear: Clear) -> float:
        """Of the widest free blend, each passing the corner half as far away as the one before; 0 where none is."""
        deviation = profile.deviation_m(speed * self._bend[i], *self._rates)
        for halved in range(1, TIGHTER + 1):
            tighter = float(profile.lateral_speed_m_s(deviation / 2.0**halved, *self._rates) / self._bend[i])
            if self._is_free(i, tighter, clear):
                return tighter
        return 0.0

    def _blend(self, i: int, speed: float) -> Curve:
        return blend(self._points[i], self._direction[i], self._direction[i + 1], speed, self._limits)

    def _corner_speed(self, i: int, room_m: float) -> float:
        via, bend = self._vias[i - 1], self._bend[i]
        within = profile.lateral_speed_m_s(max(via.pass_m, EXACT_M), *self._rates) / bend
        nearest = via.speed_m_s / max(math.sqrt(max(1.0 - bend * bend, 0.0)), 1e-9)
        allowed = 0.0 if via.stop else self._limits.speed_m_s
        return float(min(allowed, within, nearest, profile.fitting_speed_m_s(room_m, bend, *self._rates)))

    def _beyond(self, nodes: list[int]) -> Array:
        """(n,) for each node on a straight, how much of it is left before the next blend at its largest."""
        out = np.zeros(len(nodes))
        for n, i in enumerate(nodes):
            if i not in self._corners:
                after = min(c for c in self._corners if c > i)
                blend_m = self._highest[after] * self._half_s(after, self._highest[after])
                out[n] = self._along[after] - self._along[i] - blend_m
        return out

    def _half_s(self, i: int, speed: float) -> float:
        if speed * self._bend[i] == 0.0:
            return 0.0
        return 0.5 * float(profile.ramp_s(2.0 * speed * self._bend[i], *self._rates))

    def _flown(self, nodes: list[int], speed: Array, least_s: Array) -> Motion:
        parts: list[Curve] = []
        straights: list[tuple[float, float]] = []
        reached = np.zeros(len(self._points))
        now = begun = 0.0
        for (a, b), least in zip(pairwise(nodes), least_s, strict=True):
            v1, v2 = float(speed[a]), float(speed[b])
            legs = self._leg(a, b, v1, v2, float(least))
            parts += legs
            left, now = now, now + sum(leg.duration_s for leg in legs)
            reached[b] = now + self._half_s(b, v2)
            if a + 1 < b:
                self._pass(a, b, legs, left, reached)
            if b in self._corners:
                straights.append((begun, now))
                begun = now
            if reached[b] > now:
                parts.append(self._free.get((b, v2)) or self._blend(b, v2))
                begun = now = now + parts[-1].duration_s
        return Motion(Curve.chain(parts), reached[1:], np.array(straights))

    def _leg(self, a: int, b: int, v1: float, v2: float, least_s: float) -> list[Curve]:
        """From node to node without their blends, waiting at a rest where it cannot be flown slowly enough."""
        direction = self._direction[b]
        half1, half2 = self._half_s(a, v1), self._half_s(b, v2)
        first = self._along[a] + v1 * half1
        room = self._along[b] - v2 * half2 - first
        origin = self._flown_through[b] - (self._along[b] - first) * direction
        least_s -= half1 + half2
        cruise = profile.cruise_for(v1, v2, room, least_s, *self._limits.motion)
        leg = Curve.hold(origin, 0.0)
        if room > SAME_M:
            leg = straight(origin, direction, room, v1, v2, self._limits, cruise)
        wait = least_s - leg.duration_s
        if wait <= 1e-6:
            return [leg]
        return [leg, Curve.hold(leg.end, wait)] if v2 == 0.0 else [Curve.hold(origin, wait), leg]

    def _pass(self, a: int, b: int, legs: list[Curve], left_s: float, reached: Array) -> None:
        """When the points between two nodes are passed."""
        leg = Curve.chain(legs)
        for i in range(a + 1, b):
            wanted = self._along[i] - self._along[b]
            reached[i] = left_s + leg.crossing_s(0.0, leg.duration_s, self._flown_through[b], self._direction[b],
                                                 wanted)


def _on_straights(points: Array, along: Array, direction: Array, corners: list[int]) -> Array:
    """(n, 3) where the polyline through its corners passes each point: points between corners may lie beside it by as
    much as counts as passed exactly, and a flight that aimed at them one after the other would jump."""
    out = points.copy()
    for a, b in pairwise(corners):
        between = np.arange(a + 1, b)
        out[between] = points[b] - (along[b] - along[between])[:, None] * direction[b]
    return out


def _corners(points: Array) -> list[int]:
    """Where the polyline through (n, 3) points turns, both ends included."""
    out = [0]
    while out[-1] < len(points) - 1:
        far = out[-1] + 1
        while far < len(points) - 1 and _on_line(points[out[-1]:far + 2]):
            far += 1
        out.append(far)
    return out


def _on_line(points: Array) -> bool:
    """Whether points (n, 3) lie on the segment from the first to the last, in order."""
    span = points[-1] - points[0]
    length = max(float(np.linalg.norm(span)), SAME_M)
    along = np.clip((points - points[0]) @ span / length, 0.0, length)
    off = points - points[0] - along[:, None] * span / length
    return bool(np.all((off * off).sum(axis=1) <= EXACT_M**2) and np.all(np.diff(along) >= 0.0))


def _measured(points: Array, corners: list[int]) -> tuple[Array, Array]:
    """For each point its distance along the polyline (n,), and the unit direction (n, 3) in which it is approached."""
    along, direction = np.zeros(len(points)), np.zeros((len(points), 3))
    for a, b in pairwise(corners):
        span = points[b] - points[a]
        length = float(np.linalg.norm(span))
        direction[a + 1:b + 1] = span / length if length > SAME_M else 0.0
        along[a + 1:b + 1] = along[a] + np.clip((points[a + 1:b + 1] - points[a]) @ direction[b], 0.0, length)
        along[b] = along[a] + length
    return along, direction
