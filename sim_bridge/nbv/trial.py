"""One trial: vehicles fly from view to view as a pilot chooses, each asked anew when it arrives."""

from __future__ import annotations

import heapq
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from missions.camera import Pose
from missions.errors import ProtocolError
from missions.frames import wrap_pi
from missions.nbv_trial import Answer, Ask, Frame, TrialBrief
from missions.pose_lattice import Index5
from planning.trajectories import Limits
from sim_bridge.nbv.score import Score, flight_s
from sim_bridge.render.renderer import Renderer

TOGETHER_DIGITS = 6
"""Vehicles that arrive in the same microsecond arrive together: all of their pictures come before any decision."""


class Pilot(Protocol):
    """Who chooses: a method in a process of its own, or an oracle."""

    wants_pictures: bool

    def see(self, frame: Frame) -> None:
        """Takes a picture in."""

    def choose(self, ask: Ask) -> Answer:
        """One of the candidates."""


@dataclass
class Record:
    """What came out of a trial beside its score."""

    score: Score
    answers: list[Answer] = field(default_factory=list)
    rounds: list[int] = field(default_factory=list)
    """How many answers were given one after the other without flight in between: to vehicles that arrived together."""
    stopped_at: int | None = None
    """Key poses flown when the pilot first would have ended the exploration."""
    pictures: int = 0


class Trial:
    """One run of one pilot. Simulated time is that of flight alone: decisions cost none."""

    def __init__(self, brief: TrialBrief, score: Score, pilot: Pilot, renderer: Renderer | None) -> None:
        """Without a renderer no pictures are taken."""
        self._brief, self._pilot, self._renderer = brief, pilot, renderer
        self._lattice, self._limits = brief.lattice, Limits.of_fleet(brief.fleet)
        self._in_step = score.arena.rules.in_step
        self.record = Record(score)
        self.at: dict[int, Index5] = {}
        """Where each vehicle is, or flies from."""
        self.goal: dict[int, Index5] = {}
        """Where each vehicle is on its way to."""

    def run(self, before: list[Index5]) -> Record:
        """Fly brief.poses key poses, the starts included; `before` is where each vehicle comes to its start from.

        Raises ProtocolError when the pilot chooses what is no candidate.
        """
        arrivals: list[tuple[float, int]] = []
        for vehicle, (start, earlier) in enumerate(zip(self._brief.starts, before, strict=True), 1):
            self.at[vehicle] = earlier
            self._show(vehicle, self._lattice.pose(earlier), None)
            self._take_pictures(vehicle, start)
            self.at[vehicle] = start
            self.record.score.arrive(start, 0.0, None)
        waiting = self._round(list(self.at), 0.0, arrivals)
        while arrivals:
            now = (max(arrivals) if self._in_step else arrivals[0])[0]
            arrived = []
            while arrivals and arrivals[0][0] <= now:
                arrived.append(heapq.heappop(arrivals)[1])
            for vehicle in arrived:
                self._arrive(vehicle, now)
            waiting = self._round([*arrived, *waiting], now, arrivals)
        return self.record

    def _round(self, vehicles: list[int], now: float, arrivals: list[tuple[float, int]]) -> list[int]:
        """Send all on their next legs; those that wait for the next arrival."""
        answered = len(self.record.answers)
        waiting = [vehicle for vehicle in vehicles if self._depart(vehicle, now, arrivals)]
        self.record.rounds.append(len(self.record.answers) - answered)
        return waiting

    def _arrive(self, vehicle: int, now: float) -> None:
        goal = self.goal.pop(vehicle)
        leg = self._lattice.pose(self.at[vehicle]), self._lattice.pose(goal)
        self._take_pictures(vehicle, goal)
        self.at[vehicle] = goal
        self.record.score.arrive(goal, now, leg)

    def _depart(self, vehicle: int, now: float, arrivals: list[tuple[float, int]]) -> bool:
        """Send a vehicle on its next leg. True when it waits for the next arrival: the pilot wants it so, or others are
        in its way all around."""
        if len(self.record.score.curve) + len(self.goal) >= self._brief.poses:
            return False
        taken = {index[:3] for v, index in [*self.at.items(), *self.goal.items()] if v != vehicle}
        candidates = [n for n in self._lattice.neighbours(self.at[vehicle]) if n[:3] not in taken]
        if not candidates:
            return True
        answer = self._pilot.choose(Ask(vehicle=vehicle, candidates=candidates))
        choice = answer.choice
        if choice.index == self.at[vehicle]:
            return True
        if choice.vehicle != vehicle or choice.index not in candidates:
            raise ProtocolError(f"{self._brief.method} sends vehicle {choice.vehicle} to {choice.index}, but vehicle "
                                f"{vehicle} at {self.at[vehicle]} was asked for and that is not a candidate")
        self.record.answers.append(answer)
        if choice.stop and self.record.stopped_at is None:
            self.record.stopped_at = len(self.record.score.curve)
        here, there = self._lattice.pose(self.at[vehicle]), self._lattice.pose(choice.index)
        self.goal[vehicle] = choice.index
        heapq.heappush(arrivals, (round(now + flight_s(here, there, self._limits), TOGETHER_DIGITS), vehicle))
        return False

    def _take_pictures(self, vehicle: int, goal: Index5) -> None:
        """The pictures of a step, evenly spread, the last one at the goal."""
        count = self._brief.frames_per_step
        start, end = self._lattice.pose(self.at[vehicle]), self._lattice.pose(goal)
        for k in range(1, count):
            self._show(vehicle, between(start, end, k / count), None)
        self._show(vehicle, end, goal)

    def _show(self, vehicle: int, pose: Pose, index: Index5 | None) -> None:
        if self._renderer is None or not self._pilot.wants_pictures:
            return
        self.record.pictures += 1
        rgb = self._renderer.render(self._brief.camera, pose, [], self.record.pictures)
        self._pilot.see(Frame(vehicle=vehicle, pose=pose, index=index, rgb=np.ascontiguousarray(rgb)))


def between(start: Pose, end: Pose, share: float) -> Pose:
    """A pose on the way: position and angles change evenly, yaw the short way round, as in MACARONS."""
    a, b = np.array(start.position_enu_m), np.array(end.position_enu_m)
    x, y, z = (float(c) for c in a + share * (b - a))
    turn = wrap_pi(end.yaw_enu_rad - start.yaw_enu_rad)
    return Pose((x, y, z), wrap_pi(start.yaw_enu_rad + share * turn),
                start.elevation_rad + share * (end.elevation_rad - start.elevation_rad))
