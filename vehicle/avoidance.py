"""Is the way clear, and if not, which way is: obstacles from map and range sensor, teammates in space and time."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from missions.frames import Array
from missions.mission import FleetSpec
from missions.sensors import HIT_RADIUS_M, fibonacci_directions
from planning.deconflict import distance_to_polyline_m
from planning.paths import NoPath, ObstacleField, plan_path, reachable
from planning.trajectories import Flight
from vehicle.fenced_field import FencedField
from vehicle.geofence import Geofence
from vehicle.sensor_memory import SensorMemory
from vehicle.teammates import Conflict, Teammates

REPLAN_SPARE_M = 0.15
"""Ways around keep this much more than the clearance, so that the next scan does not at once block them again."""
SEPARATION_SPARE_M = 0.3
"""Planned flights keep this much more than the separation, for what is not yet announced and for the announcement's
chords, which a flight leaves by a few centimetres."""
IN_FLIGHT_SPARE_M = 0.1
REACTION_S = 0.3
"""From a teammate's braking until the own braking begins, at most."""
ASIDE_STEPS_M = (1.5, 3.0, 4.5, 6.5, 9.0)
STOPPED_SHORT_M, STEP_SHORT_M = 0.1, 0.01
CHORD_SHORT_M = 0.03
"""A flight's samples are joined by chords, which cut its blends a little."""
REFUGE_REACH_M, REFUGE_STEP = 60.0, 3
"""How far off a refuge may be, and the step in voxels at which places are looked at."""
REPLAN_REACH_M = (6.0, 16.0)
"""How far around the direct way a detour is looked for, first and then."""
ESCAPE_STEPS_M = (0.5, 1.0, 1.5, 2.0, 3.0, 4.0)
BODY_SPARE_M = 0.2
NO_PLACES = np.zeros((0, 3))
DIRECTIONS = fibonacci_directions(320)
"""In which a way out of a narrow place, or out of a teammate's way, is looked for."""


class Knowledge(NamedTuple):
    """Versions of all that a clear way depends on."""

    map: int
    hits: int
    teammates: int


class Avoidance:
    """One vehicle's idea of where it may go."""

    def __init__(self, memory: SensorMemory, teammates: Teammates, fleet: FleetSpec,
                 fence: tuple[Array, Array]) -> None:
        self.memory, self.teammates, self._fleet = memory, teammates, fleet
        self._lower, self._upper = fence[0] + fleet.clearance_m, fence[1] - fleet.clearance_m
        self.replans = 0
        self._fence: Geofence | None = None

    def fence_off(self, fence: Geofence | None) -> None:
        """Treat the border of an uploaded fence as a wall from now on; None for no fence but the mission's."""
        if fence is not self._fence:
            self._fence = fence
            self.memory.map_version += 1

    @property
    def version(self) -> Knowledge:
        """Changes whenever a way that was clear may have become blocked."""
        return Knowledge(self.memory.map_version, self.memory.hit_version, self.teammates.version)

    def clear(self, a_enu_m: Array, b_enu_m: Array) -> bool:
        """Whether the straight way from a to b keeps the clearance from all that is not known to be free.

        Clearances are bounds from below. A whole segment may be proven clear, in one direction, while the bound at a
        place on it falls a little short: a vehicle that stopped there may leave it again.
        """
        need = self._fleet.clearance_m
        ends = np.stack([a_enu_m, b_enu_m])
        field = self._space(a_enu_m, b_enu_m, need)
        room = float(field.clearance_m(ends).min())
        if need - STOPPED_SHORT_M <= room < need:
            need = room - STEP_SHORT_M
        return bool(field.segments_clear(ends, ends[::-1], need).any())

    def clear_legs(self, points_enu_m: Array) -> int:
        """How many legs of a polyline (k, 3), from its beginning, are clear."""
        need = self._fleet.clearance_m
        field = self._space(points_enu_m.min(axis=0), points_enu_m.max(axis=0), need)
        clear = field.segments_clear(points_enu_m[:-1], points_enu_m[1:], need)
        for n, leg in enumerate(clear):
            if not leg and not self.clear(points_enu_m[n], points_enu_m[n + 1]):
                return n
        return len(clear)

    def outline_clear(self, way_enu_m: Array) -> bool:
        """Whether a polyline (k, 3) that bounds a blend is clear."""
        need = self._fleet.clearance_m
        field = self._space(way_enu_m.min(axis=0), way_enu_m.max(axis=0), need)
        return bool(field.segments_clear(way_enu_m[:-1], way_enu_m[1:], need).all())

    def still_clear(self, way_enu_m: Array) -> bool:
        """Whether the way (k, 3) that was found clear still is, on a map that has changed."""
        need = self._fleet.clearance_m - STOPPED_SHORT_M
        field = self._space(way_enu_m.min(axis=0), way_enu_m.max(axis=0), need)
        return bool(field.segments_clear(way_enu_m[:-1], way_enu_m[1:], need).all())

    def clear_of_hits(self, way_enu_m: Array) -> bool:
        """The part of `still_clear` that can change while the map stays the same."""
        return self.memory.hits_clear(way_enu_m, self._fleet.clearance_m + HIT_RADIUS_M - CHORD_SHORT_M)

    def conflicts(self, flight: Flight, way_enu_m: Array, now_ns: int, start_ns: int | None = None) -> list[Conflict]:
        """Teammates that keep a flight along a way (k, 3) from being launched (now, when no start is given): apart even
        when either has to stop, and never past where another one will rest, so that there is always a way back.

        The dead are solid already: asked to be farther off here, a place that is clear would be waited for in vain.
        """
        start_ns = now_ns if start_ns is None else start_ns
        return self.teammates.conflicts(flight, start_ns, now_ns, self.separation_m, REACTION_S, way_enu_m,
                                        dead_m=self._fleet.separation_m)

    def conflicts_in_flight(self, flight: Flight, start_ns: int, now_ns: int) -> list[Conflict]:
        """Teammates that the rest of a flight under way comes too near to."""
        return self.teammates.conflicts(flight, start_ns, now_ns, self._fleet.separation_m + IN_FLIGHT_SPARE_M)

    @property
    def clearance_m(self) -> float:
        """Least distance of the vehicle's centre from anything that is not known to be free."""
        return self._fleet.clearance_m

    @property
    def separation_m(self) -> float:
        """How near a place may be to a resting vehicle before it counts as taken."""
        return self._fleet.separation_m + SEPARATION_SPARE_M

    def may_leave(self, way_enu_m: Array) -> bool:
        """Whether the body itself gets through along a way (k, 3), out of a place that became too narrow."""
        return self.memory.hits_clear(way_enu_m, self._fleet.radius_m + BODY_SPARE_M)

    def way(self, start_enu_m: Array, goal_enu_m: Array, t_ns: int, around_resting: bool) -> Array:
        """(k, 3) waypoints from start to goal around what is solid, and around resting teammates when asked for. Raises
        NoPath.

        From a place that has become too narrow, the first waypoint is the nearest one that is wide enough.
        """
        self.replans += 1
        teammates = self.teammates.resting(t_ns) if around_resting else NO_PLACES
        failure = NoPath("search")
        for reach in REPLAN_REACH_M if self.memory.ends_at_box else REPLAN_REACH_M[-1:]:
            field = self._field(start_enu_m, goal_enu_m, reach, teammates)
            try:
                return self._way_in(field, start_enu_m, goal_enu_m)
            except NoPath as e:
                failure = e
                if e.reason == "outside":
                    break
        raise failure

    def shut_by_dead(self, start_enu_m: Array, goal_enu_m: Array) -> bool:
        """Whether there would be a way but for teammates that will not move any more."""
        if not len(self.teammates.dead()):
            return False
        try:
            self._way_in(self._solid(start_enu_m, goal_enu_m, REPLAN_REACH_M[-1]), start_enu_m, goal_enu_m)
        except NoPath:
            return False
        return True

    def taken(self, place_enu_m: Array, t_ns: int) -> bool:
        """Whether a teammate rests so near to a place that nobody else can rest there."""
        others = self.teammates.resting(t_ns)
        return bool(len(others)) and float(np.linalg.norm(others - place_enu_m, axis=1).min()) < self.separation_m

    def aside(self, position_enu_m: Array, ways: list[Array], t_ns: int) -> Array:
        """(n, 3) places off all these ways and away from all teammates, straight from here, the nearest first."""
        level = DIRECTIONS[np.abs(DIRECTIONS[:, 2]) < 0.5]
        places = self._off(np.concatenate([position_enu_m + d * level for d in ASIDE_STEPS_M]), ways, t_ns)
        if not len(places):
            return places
        need = self._fleet.clearance_m
        field = self._space(position_enu_m, position_enu_m, ASIDE_STEPS_M[-1])
        here = np.broadcast_to(position_enu_m, places.shape)
        return np.asarray(places[field.segments_clear(here, places, need)])

    def refuge(self, position_enu_m: Array, ways: list[Array], t_ns: int) -> Array | None:
        """(k, 3) the shortest way around resting teammates and whatever corners to a place off all these ways and away
        from all teammates; None where there is none."""
        field = self._field(position_enu_m, position_enu_m, REFUGE_REACH_M, self.teammates.resting(t_ns))
        reach = reachable(field, position_enu_m, self._fleet.clearance_m)
        voxels = np.argwhere(np.isfinite(reach.distance_m))
        voxels = voxels[np.all(voxels % REFUGE_STEP == 0, axis=1)]
        voxels = voxels[np.argsort(reach.distance_m[tuple(voxels.T)], kind="stable")]
        places = self._off(field.origin + voxels * field.voxel_m, ways, t_ns)
        return reach.path_to(places[0]) if len(places) else None

    def _off(self, places: Array, ways: list[Array], t_ns: int) -> Array:
        """Those of the places (n, 3) inside the fence that lie off all these ways and away from all teammates."""
        places = places[np.all((places >= self._lower) & (places <= self._upper), axis=1)]
        others = self.teammates.places(t_ns)
        if len(others):
            apart = np.linalg.norm(places[:, None] - others, axis=2).min(axis=1)
            places = places[apart >= self.separation_m + SEPARATION_SPARE_M]
        for way in ways:
            places = places[distance_to_polyline_m(places, way) >= self.separation_m + 0.1]
        return places

    def _way_in(self, field: ObstacleField, start: Array, goal: Array) -> Array:
        need = self._fleet.clearance_m + REPLAN_SPARE_M
        if field.clearance_m(goal)[0] < need:
            need = self._fleet.clearance_m
        if field.clearance_m(start)[0] >= need:
            return plan_path(field, start, goal, need, self._lower, self._upper)
        wide = self._escape(field, start, need)
        return np.concatenate([start[None], plan_path(field, wide, goal, need, self._lower, self._upper)])

    def _escape(self, field: ObstacleField, start: Array, need: float) -> Array:
        """The nearest place with the clearance, along a straight way that does not come nearer to anything."""
        here = float(field.clearance_m(start)[0])
        for distance in ESCAPE_STEPS_M:
            goals = start + distance * DIRECTIONS
            room = field.clearance_m(goals)
            room[np.any(goals < self._lower, axis=1) | np.any(goals > self._upper, axis=1)] = 0.0
            for m in np.argsort(-room, kind="stable"):
                if room[m] < need:
                    break
                if self._may_escape(field, start, goals[m], here):
                    return np.asarray(goals[m])
        raise NoPath("start")

    def _may_escape(self, field: ObstacleField, start: Array, goal: Array, here_m: float) -> bool:
        least = self._fleet.radius_m + BODY_SPARE_M
        if here_m >= least:
            return bool(field.segments_clear(start, goal, max(least, here_m - 0.1))[0])
        # The map calls the very place solid in which the vehicle hovers: there the range sensor alone is believed.
        return self.may_leave(np.stack([start, goal]))

    def beside_dead(self, place_enu_m: Array) -> bool:
        """Whether a teammate that will not move any more is nearer to a place than vehicles may come."""
        dead = self.teammates.dead()
        apart = self._fleet.separation_m + IN_FLIGHT_SPARE_M
        return bool(len(dead)) and float(np.linalg.norm(dead - place_enu_m, axis=1).min()) < apart

    def _space(self, a_enu_m: Array, b_enu_m: Array, margin_m: float) -> ObstacleField:
        """What is solid around a and b. A dead teammate is: it will not move any more."""
        field = self._solid(a_enu_m, b_enu_m, margin_m)
        dead = self.teammates.dead()
        radius = max(0.0, self._fleet.separation_m + IN_FLIGHT_SPARE_M - self._fleet.clearance_m)
        return field.with_spheres(dead, radius) if len(dead) else field

    def _solid(self, a_enu_m: Array, b_enu_m: Array, margin_m: float) -> ObstacleField:
        field: ObstacleField = self.memory.field(a_enu_m, b_enu_m, margin_m)
        return field if self._fence is None else FencedField(field, self._fence, self._fleet.clearance_m)

    def _field(self, start: Array, goal: Array, reach_m: float, teammates: Array) -> ObstacleField:
        field = self._space(start, goal, reach_m)
        # A sphere of this radius turns the clearance into the separation.
        radius = self.separation_m - self._fleet.clearance_m
        return field.with_spheres(teammates, max(radius, 0.0)) if len(teammates) else field
