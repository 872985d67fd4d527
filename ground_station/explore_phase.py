"""Exploration as the fleet flies it: pictures into the map, the next view for whoever hovers without one."""

from __future__ import annotations

from ground_station.control import Control
from ground_station.decision import Asking, Busy, Leg
from ground_station.drone import Drone, Stage
from ground_station.explore import Explorer

MAX_TROUBLE = 8
"""Refused or blocked legs in a row after which a vehicle stops exploring."""

HALF_PERCENT = 50.0
"""Below this, who finds nothing worth its flight within its battery looks farther with a fresh one, if it has one."""

SHOWN_DEPTHS = 4
"""Pictures whose depth is kept for the report."""


class ExplorePhase:
    """Who explores what next."""

    def __init__(self, control: Control) -> None:
        self._control, self._mission = control, control.mission
        self._fleet, self._recorder = control.fleet, control.recorder
        self.explorer = Explorer(control.mission, control.site, control.prior, control.regions)
        self._legs: dict[int, Leg] = {}
        self._column_flown: set[int] = set()
        self._done_exploring: set[int] = set()
        self._resting: set[int] = set()
        """Who has come home for a fresh battery."""
        self._asked: set[int] = set()
        self._trouble: dict[int, int] = {}
        self._decisions = 0

    @property
    def progress(self) -> tuple[int, int]:
        """(decisions made, decisions allowed)."""
        return self._decisions, self._mission.explore.max_views

    def step(self) -> None:
        """One turn."""
        for picture in self._fleet.new_pictures:
            self.explorer.add(picture)
            self._recorder.picture(picture.meta, picture.meta.vehicle_id)
            if picture.meta.view_id in self.explorer.key_views:
                self._asked.clear()
                self._trouble.pop(picture.meta.vehicle_id, None)
        for drone in self._fleet.drones.values():
            if drone.airborne:
                self.explorer.flew(drone.vehicle_id, drone.position_enu_m)
            self._settle_leg(drone)
        for drone in self._fleet.free(Stage.PARKED):
            if self._to_be_serviced(drone):
                self._resting.discard(drone.vehicle_id)
                self._fleet.swap(drone)
            elif drone.available and drone.vehicle_id not in self._done_exploring | self._resting:
                self._fleet.launch(drone)
        self._give_views()

    def _settle_leg(self, drone: Drone) -> None:
        """What was refused or reported blocked is not tried again; a vehicle that only ever meets trouble is done."""
        k, leg = drone.vehicle_id, self._legs.get(drone.vehicle_id)
        if leg is not None and (drone.refused or drone.reports):
            self.explorer.forbid(leg.goal)
            self._trouble[k] = self._trouble.get(k, 0) + 1
            if self._trouble[k] >= MAX_TROUBLE:
                self._done_exploring.add(k)
                self._control.note(f"vehicle {k} stops exploring after {MAX_TROUBLE} legs in a row that were refused "
                                   "or blocked")
        drone.reports.clear()
        drone.refused = ""

    def _give_views(self) -> None:
        ready = [d for d in self._fleet.free(Stage.READY)
                 if d.vehicle_id not in self._done_exploring and d.standing]
        for drone in ready:
            if drone.vehicle_id not in self._column_flown:
                self._column_flown.add(drone.vehicle_id)
                self._fly_leg(drone, self.explorer.column(drone.vehicle_id))
            elif self._decisions >= self._mission.explore.max_views:
                self._done_exploring.add(drone.vehicle_id)
                self.explorer.log.ended = f"all {self._decisions} views were given out"
            elif self._usable_percent(drone) <= 0.0:
                self._rest(drone)
        asking = [d for d in ready if d.stage is Stage.READY and d.vehicle_id not in self._done_exploring]
        if any(d.vehicle_id not in self._asked for d in asking):
            self._decide(asking)
        if not self._news_to_come:
            self._done_exploring.update(d.vehicle_id for d in asking if d.stage is Stage.READY)

    @property
    def _news_to_come(self) -> bool:
        """Whether somebody is under way, or will be once an operator resumes it or it starts anew from its pad, who may
        open ways for others."""
        return bool(self._fleet.in_stage(Stage.FLYING, Stage.LAUNCHING, Stage.MISSING, Stage.SWAPPING)) or any(
            (d.held or d.stage in (Stage.HOMING, Stage.PARKED)) and d.available
            and d.vehicle_id not in self._done_exploring | self._resting for d in self._fleet.drones.values())

    def _rest(self, drone: Drone) -> None:
        """Its share of the energy is used: on its pad it gets a fresh battery, or waits for the others, for hovering
        costs as much as flying."""
        (self._resting if drone.swaps_left else self._done_exploring).add(drone.vehicle_id)
        self._control.note(f"vehicle {drone.vehicle_id} has explored as long as its battery allows")
        self._fleet.home(drone)

    def _to_be_serviced(self, drone: Drone) -> bool:
        """Whether a fresh battery lets it explore on. None is spent on that while somebody hovers who has energy and
        finds nothing worth its flight."""
        used = drone.spent or drone.vehicle_id in self._resting
        if not (used and drone.swaps_left and not drone.dropped and drone.stage is not Stage.LOST):
            return False
        return self._decisions < self._mission.explore.max_views and not self._fleet.in_stage(Stage.READY)

    def _decide(self, asking: list[Drone]) -> None:
        explorer = self.explorer
        explorer.refresh()
        self._asked.update(d.vehicle_id for d in asking)
        self._control.send_map(explorer.grid)
        self._recorder.predicted_coverage.append(round(explorer.coverage, 4))
        self._recorder.exploration = explorer.log.document()
        others = [d for d in self._fleet.drones.values() if d.airborne and d not in asking]
        budget = self._mission.explore.max_views - self._decisions
        hits = self._control.unmapped_hits(explorer.grid)
        found = explorer.decide([self._asking(d) for d in asking[:budget]], [self._busy(d) for d in others], hits)
        for leg in found.legs:
            self._decisions += 1
            self._fly_leg(self._fleet.drones[leg.vehicle_id], leg)
        for drone in asking:
            if drone.stage is Stage.READY and (drone.vehicle_id in found.spent or (
                    drone.vehicle_id in found.limited and drone.swaps_left and drone.battery_percent < HALF_PERCENT)):
                self._rest(drone)
            elif drone.stage is Stage.READY:
                self._without_view(drone, drone.vehicle_id in found.stuck)

    def _without_view(self, drone: Drone, stuck: bool) -> None:
        """Nothing for this vehicle now: wait for what the others find, or, when it is shut in, look around, and when
        that has not helped start anew from the pad."""
        if not stuck:
            return
        leg = self.explorer.look_around(self._asking(drone))
        if leg is not None:
            self._control.note(f"vehicle {drone.vehicle_id} reaches no candidate and looks around")
            self._fly_leg(drone, leg)
        elif self._control.may_rescue(drone):
            self._control.rescue(drone)
            self.explorer.look_again(drone.vehicle_id)
            self._asked.discard(drone.vehicle_id)

    def _fly_leg(self, drone: Drone, leg: Leg) -> None:
        self._legs[drone.vehicle_id] = leg
        self._asked.discard(drone.vehicle_id)
        self._fleet.fly(drone, "explore", leg.waypoints)

    def aim_for(self, coverage: float) -> None:
        """An operator's goal; who had stopped for want of worthwhile views goes on."""
        self.explorer.goal_coverage = coverage
        self._done_exploring -= {d.vehicle_id for d in self._fleet.in_stage(Stage.READY)}
        self._asked.clear()

    def think_again(self) -> None:
        """An operator has changed where is flown or what counts: whoever had found nothing asks anew."""
        self._asked.clear()

    def conclude(self) -> None:
        """Exploration is over: keep what it knew."""
        explorer = self.explorer
        explorer.refresh()
        self._recorder.exploration = explorer.log.document()
        self._recorder.write_map(explorer.grid, explorer.map.surface())
        self._recorder.write_depths(explorer.depths(SHOWN_DEPTHS))

    @property
    def over(self) -> bool:
        """Whether nobody explores any more."""
        if self._fleet.in_stage(Stage.FLYING, Stage.LAUNCHING, Stage.MISSING):
            return False
        return all(d.vehicle_id in self._done_exploring if d.available and d.vehicle_id not in self._resting
                   else not self._to_be_serviced(d) for d in self._fleet.drones.values())

    def _usable_percent(self, drone: Drone) -> float:
        """Who can have a fresh battery keeps nothing of this one for the survey."""
        return self._control.usable_percent(drone, exploring=not drone.swaps_left)

    def _asking(self, drone: Drone) -> Asking:
        state = drone.state
        assert state is not None
        return Asking(drone.vehicle_id, drone.position_enu_m, state.yaw_enu_rad, state.gimbal_elevation_rad,
                      self._usable_percent(drone))

    def _busy(self, drone: Drone) -> Busy:
        leg = self._legs.get(drone.vehicle_id)
        flying = drone.stage is Stage.FLYING and leg is not None
        return Busy(drone.vehicle_id, drone.position_enu_m, leg.goal if leg is not None and flying else None)
