"""A real aircraft as the body of a vehicle: the planned flight is a reference that its autopilot is made to follow.

Take-off and landing are the autopilot's own; in between set-points along the flight are streamed to it. Nothing here
reads a clock: seconds come from the link's thread and with every tick.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

import numpy as np

from missions.frames import Array, ned_from_enu, wrap_pi
from missions.mission import FleetSpec
from planning.trajectories import Flight, Limits, State, brake
from vehicle.external.goals import Goal
from vehicle.external.link import AutopilotLink, Setpoint
from vehicle.health import Health
from vehicle.simulator import NS, Kinematics, coasting, resting

ARRIVED_M, ARRIVED_M_S, ARRIVED_RAD = 0.3, 0.4, math.radians(8.0)
"""A leg is over when the aircraft is so near its end, so slow, and looks so nearly there."""
PATIENCE_NS = 10 * NS
"""In wind it may not come so near: after so long anywhere on course will do."""
CLIMBED_M, CLIMBED_M_S = 0.9, 0.4
"""The autopilot's take-off is over so near its height (PX4 calls 0.8 m near enough), climbing no faster."""
ON_GROUND_M, ON_PAD_M = 0.1, 2.0
BLIND_S = 1.0
"""A position this old is none."""
LEASE_S = 0.2
"""Ticks may be late by so much; then the aircraft stops on its way rather than flies on unwatched."""


class Phase(Enum):
    """Who moves the aircraft, and where to."""

    GROUND = "ground"
    CLIMB = "climb"
    FOLLOW = "follow"
    DESCEND = "descend"
    SURRENDERED = "surrendered"


@dataclass(frozen=True)
class LocalFrame:
    """Where the autopilot's local frame lies in ENU."""

    origin_enu_m: Array

    def enu(self, position_ned_m: Array) -> Array:
        """(3,) position in ENU."""
        return np.asarray(ned_from_enu(position_ned_m) + self.origin_enu_m)

    def ned(self, position_enu_m: Array) -> Array:
        """(3,) position in the local frame."""
        return ned_from_enu(position_enu_m - self.origin_enu_m)


@dataclass(frozen=True)
class _Course:
    """The flight, and when it began by the time of ticks; t_s is the link's time at tick t_ns."""

    flight: Flight
    start_ns: int
    t_ns: int
    t_s: float


class ExternalBody:
    """Implements vehicle.body.Body. The link's thread calls `aim`; everything else belongs to the ticks."""

    def __init__(self, link: AutopilotLink, frame: LocalFrame, pad_enu_m: Array, fleet: FleetSpec,
                 clock: Callable[[], float]) -> None:
        """clock: the link's seconds. An aircraft may be off its reference by as much as a flight's clearance allows."""
        self._link, self._frame, self._clock = link, frame, clock
        self._pad, self._off_course_m = pad_enu_m, fleet.clearance_m - fleet.radius_m
        self._limits = Limits.of_fleet(fleet)
        self._phase = Phase.GROUND
        yaw = _yaw_enu(link.said.heading_rad or 0.0)
        self._course = _Course(resting(pad_enu_m, yaw, 0.0), 0, 0, clock())
        self._measured = self._course.flight.curve.state(0.0), yaw
        self._joined = self._there = True
        self._gone_up = False
        self._texts: list[str] = []
        self._stopping: tuple[_Course, Flight] | None = None
        self._stopped: Flight | None = None
        link.aim = self.aim

    @property
    def flight(self) -> Flight:
        """The reference."""
        return self._course.flight

    @property
    def start_ns(self) -> int:
        """When it began."""
        return self._course.start_ns

    @property
    def t_ns(self) -> int:
        """When time last came on."""
        return self._course.t_ns

    @property
    def end_ns(self) -> int:
        """In the future until the aircraft has come to the reference's end."""
        planned_ns = self.start_ns + round(self.flight.duration_s * NS)
        return planned_ns if self._there else max(planned_ns, self._course.t_ns + 1)

    @property
    def surrendered(self) -> bool:
        """Whether somebody else flies, or the autopilot would not take off."""
        return self._phase is Phase.SURRENDERED

    @property
    def astray(self) -> Flight | None:
        """Only what is to be followed can be left: by being elsewhere, or by having begun to stop as no tick came."""
        if not self._joined or self._phase not in (Phase.FOLLOW, Phase.SURRENDERED):
            return None
        if self._stopped is not None or self._error_m() <= self._off_course_m:
            return self._stopped
        state, yaw = self._measured
        return coasting(brake(state, self._limits), yaw, self.at(self._course.t_ns).gimbal_elevation_rad)

    @property
    def health(self) -> Health:
        """What is too old is not known."""
        said, t_s = self._link.said, self._course.t_s
        return Health(position_valid=t_s - said.position_s < BLIND_S,
                      battery_known=said.battery_known(t_s))

    def elapsed_s(self, t_ns: int) -> float:
        """Time on the reference."""
        return (t_ns - self.start_ns) / NS

    def at(self, t_ns: int) -> Kinematics:
        """The reference at a time."""
        t_s = self.elapsed_s(t_ns)
        return Kinematics(self.flight.curve.state(t_s), *self.flight.attitude(t_s))

    def measured(self, t_ns: int) -> Kinematics:
        """What the autopilot reported, brought forward to the tick. Who holds its place is said to stand: the few cm/s
        of a hover are no motion. The gimbal is taken to be where it was sent."""
        state, yaw = self._measured
        if self._there and self._phase is not Phase.SURRENDERED:
            state = State.at_rest(state.position)
        return Kinematics(state, yaw, self.at(t_ns).gimbal_elevation_rad)

    def take_texts(self) -> list[str]:
        """What people should know, once."""
        texts, self._texts = [text for text in self._texts if text], []
        return texts

    def step(self, t_ns: int) -> None:
        """Take in what was reported, and go on from phase to phase."""
        t_s = self._link.ground_s = self._clock()  # the clock ticks: the ground station takes part in it
        self._note_stop(t_s)
        waits = self._phase is Phase.CLIMB or (self._phase is Phase.DESCEND and not self._link.held)
        start_ns = t_ns if waits else self.start_ns
        self._course = _Course(self.flight, start_ns, t_ns, t_s)
        self._measure(t_s)
        if self._link.let_go and self._phase not in (Phase.GROUND, Phase.SURRENDERED):
            self._surrender(t_ns)
        elif self._phase is Phase.CLIMB:
            self._climb(t_ns)
        elif self._phase is Phase.FOLLOW:
            self._follow(t_ns)
        elif self._phase in (Phase.DESCEND, Phase.SURRENDERED):
            self._touch_down(t_ns)

    def fly(self, flight: Flight, t_ns: int) -> None:
        """Follow this flight from now. From the ground the autopilot takes off, to the ground it lands, by itself."""
        down = flight.curve.end[2] <= self._pad[2] + ON_GROUND_M
        self._course = _Course(flight, t_ns, t_ns, self._course.t_s)
        self._there, self._stopped = False, None
        if self._phase is Phase.SURRENDERED:
            return
        if down:
            self._there = self._phase is Phase.GROUND
            self._phase = Phase.GROUND if self._there else Phase.DESCEND
            self._link.pursue(Goal.NOTHING if self._there else Goal.LAND)
        elif not self._gone_up:
            self._level()
            self._phase = Phase.CLIMB
            self._link.pursue(Goal.CLIMB, float(flight.curve.end[2] - self._pad[2]))
        else:
            self._lead()

    def aim(self, t_s: float) -> Setpoint | None:
        """The set-point at a time of the link's clock; between ticks it moves on, for LEASE_S at most."""
        course = self._course
        ahead_s = max(0.0, t_s - course.t_s)
        flight, now_s = course.flight, (course.t_ns - course.start_ns) / NS + min(ahead_s, LEASE_S)
        if ahead_s > LEASE_S:
            if self._stopping is None or self._stopping[0] is not course:
                self._stopping = course, flight.stop(now_s)
            flight, now_s = self._stopping[1], ahead_s - LEASE_S
        state, (yaw, _) = flight.curve.state(now_s), flight.attitude(now_s)
        return Setpoint(self._frame.ned(state.position), ned_from_enu(state.velocity), ned_from_enu(state.acceleration),
                        _heading(yaw))

    def _level(self) -> None:
        """Barometers drift while an aircraft waits on its pad: there its height is known."""
        off = self._pad - self._measured[0].position
        if self._phase is Phase.GROUND and float(np.linalg.norm(off[:2])) < ON_PAD_M:
            self._frame = LocalFrame(self._frame.origin_enu_m + np.array([0.0, 0.0, off[2]]))

    def _note_stop(self, t_s: float) -> None:
        """What is left of a stop that was begun since the last tick."""
        begun, course = self._stopping, self._course
        if begun is None or begun[0] is not course or self._phase is not Phase.FOLLOW:
            return
        stop, (yaw, elevation) = begun[1], begun[1].attitude(0.0)
        if stop.duration_s == 0.0:
            return  # it rested anyway
        rest = stop.curve.part(min(t_s - course.t_s - LEASE_S, stop.duration_s), stop.duration_s)
        self._stopped = coasting(rest, yaw, elevation)

    def _measure(self, t_s: float) -> None:
        said = self._link.said
        if said.position_ned_m is None or said.heading_rad is None:
            return
        velocity = ned_from_enu(said.velocity_ned_m_s)
        age_s = min(max(0.0, t_s - said.position_s), 0.5)
        position = self._frame.enu(said.position_ned_m) + age_s * velocity
        self._measured = State(position, velocity, np.zeros(3)), _yaw_enu(said.heading_rad)
        self._gone_up = self._gone_up or (said.landed is False and position[2] > self._pad[2] + ON_GROUND_M)

    def _error_m(self) -> float:
        reference = self.at(self._course.t_ns).state.position
        return float(np.linalg.norm(self._measured[0].position - reference))

    def _climb(self, t_ns: int) -> None:
        """Until the autopilot's own take-off is over; the aircraft then goes to the reference's end."""
        state, _ = self._measured
        missing_m = self.flight.curve.end[2] - state.position[2]
        if self._gone_up and missing_m < CLIMBED_M and abs(state.velocity[2]) < CLIMBED_M_S:
            start_ns = t_ns - round(self.flight.duration_s * NS)
            self._course = _Course(self.flight, start_ns, t_ns, self._course.t_s)
            self._lead()

    def _lead(self) -> None:
        """Have the autopilot follow, from now on or as before."""
        if self._phase is not Phase.FOLLOW:
            self._phase, self._joined = Phase.FOLLOW, False
            self._link.pursue(Goal.FOLLOW)

    def _follow(self, t_ns: int) -> None:
        """Whether the aircraft has come to the reference, and to its end."""
        if not self._link.held:
            return
        state, yaw = self._measured
        error_m = self._error_m()
        self._joined = self._joined or error_m < self._off_course_m
        late_ns = t_ns - self.start_ns - round(self.flight.duration_s * NS)
        if late_ns < 0 or self._there:
            return
        near = error_m <= ARRIVED_M and float(np.linalg.norm(state.velocity)) <= ARRIVED_M_S \
            and abs(wrap_pi(yaw - self.at(t_ns).yaw_enu_rad)) <= ARRIVED_RAD
        self._there = near or (late_ns > PATIENCE_NS and self._joined)

    def _surrender(self, t_ns: int) -> None:
        """Never fight: no set-point and no command until the aircraft stands on the ground."""
        self._phase, self._joined, self._there = Phase.SURRENDERED, True, False
        self._link.pursue(Goal.NOTHING)
        self._texts += [f"control given up: {self._link.let_go}", self._link.said.last_text]

    def _touch_down(self, t_ns: int) -> None:
        said = self._link.said
        if said.armed or not said.landed:
            return
        if self._phase is Phase.SURRENDERED:
            here = self._measured[0].position.copy()
            here[2] = self._pad[2]
            self._course = _Course(resting(here, self._measured[1], 0.0), t_ns, t_ns, self._course.t_s)
        self._phase, self._there, self._gone_up = Phase.GROUND, True, False
        self._link.regain()


def _yaw_enu(heading_rad: float) -> float:
    return wrap_pi(0.5 * math.pi - heading_rad)


def _heading(yaw_enu_rad: float) -> float:
    return wrap_pi(0.5 * math.pi - yaw_enu_rad)
