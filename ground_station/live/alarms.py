"""What an operator should know, in plain words. docs/operating.md says of each what it means and what to do."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import get_args

from ground_station.drone import Drone, Stage
from ground_station.fleet import TAKEOFF_TRIES, Fleet
from ground_station.fleet_link import LANDING_OUT_MODES
from missions.clock import SECOND_NS
from missions.live import AlarmName, LiveAlarm, Severity
from missions.mission import BatterySpec

LITTLE_PERCENT = 5.0
"""So little above the way home and the reserve is worth a warning."""
SILENT_S = 3.0
TEXT_S = 30.0
"""A vehicle's own warning is shown for so long."""
LONG_WAIT_S = 60.0


@dataclass
class _Told:
    """What a vehicle said last, and since when it waits for others."""

    text: str = ""
    text_s: float = -TEXT_S
    waits_since_s: float | None = None


@dataclass
class Alarms:
    """Looks at the fleet a few times per second."""

    fleet: Fleet
    battery: BatterySpec
    _told: dict[int, _Told] = field(default_factory=dict)

    def now(self, home_percent: dict[int, float], started: bool) -> list[LiveAlarm]:
        """The alarms in force, the worst first. home_percent: what each vehicle's way home takes."""
        found = [a for d in self.fleet.drones.values() for a in self._of(d, home_percent[d.vehicle_id])]
        if self.fleet.storage.trouble:
            found.append(LiveAlarm(name="disk", severity="danger", text=(
                f"The disk of the run folder {self.fleet.storage.trouble}. Vehicles hold and take no new views; what "
                "they have taken waits on board.")))
        if not started:
            found.append(LiveAlarm(name="waits for start", severity="notice", text="The mission waits for Start."))
        return sorted(found, key=lambda a: get_args(Severity).index(a.severity))

    def _of(self, drone: Drone, home_percent: float) -> Iterator[LiveAlarm]:
        k, t_s, told = drone.vehicle_id, self.fleet.t_ns / SECOND_NS, self._told.setdefault(drone.vehicle_id, _Told())
        state, warning = drone.state, drone.link.telemetry.warning
        if warning != told.text:
            told.text, told.text_s = warning, t_s
        waits = state is not None and state.mode == "wait"
        told.waits_since_s = (t_s if told.waits_since_s is None else told.waits_since_s) if waits else None

        def alarm(name: AlarmName, severity: Severity, text: str) -> LiveAlarm:
            return LiveAlarm(name=name, severity=severity, text=f"Vehicle {k} {text}", vehicle_id=k)

        if drone.stage is Stage.MISSING:
            yield alarm("missing", "danger", "has vanished: no sign of life. Its views wait for it for a while.")
            return
        if drone.stage is Stage.LOST:
            yield alarm("lost", "danger", "is lost: no sign of life. The others take over its views.")
            return
        if state is not None and state.mode in LANDING_OUT_MODES:
            yield alarm("lands out", "danger", "lands where it is.")
        if drone.airborne and t_s - (state.t_ns if state is not None else 0) / SECOND_NS > SILENT_S:
            yield alarm("silent", "danger", f"has said nothing for {SILENT_S:.0f} s.")
        left = drone.battery_percent - home_percent - self.battery.reserve_percent
        if drone.airborne and left < LITTLE_PERCENT:
            yield alarm("little energy", "warning", f"has {max(0.0, left):.0f} % to spare over the way home.")
        if drone.spent and drone.stage is Stage.HOMING and drone.link.returning:
            yield alarm("returns", "warning", f"returns by itself with {drone.battery_percent:.0f} %.")
        if drone.launches_failed >= TAKEOFF_TRIES:
            yield alarm("does not take off", "warning", f"did not take off in {TAKEOFF_TRIES} tries and stays down.")
        if told.text and t_s - told.text_s < TEXT_S:
            yield alarm("says", "warning", f"says: {told.text}.")
        if told.waits_since_s is not None and t_s - told.waits_since_s > LONG_WAIT_S:
            yield alarm("waits for others", "notice", f"has waited {t_s - told.waits_since_s:.0f} s for its way.")
        if drone.held and k not in self.fleet.storage.held:
            where = "on its pad" if drone.on_pad else "after it has landed" if drone.recalled else "in the air"
            yield alarm("waits for you", "notice", f"waits {where} for you to resume it.")
        elif drone.dropped and not drone.reserve:
            yield alarm("dropped", "notice", "is out of the mission.")
