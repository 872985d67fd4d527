"""The companion computer: a thread that keeps the link to the autopilot alive while the vehicle thinks.

The aircraft depends on it: when the process dies, no set-points come any more and the autopilot's own failsafe acts.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from types import TracebackType
from typing import Any

import numpy as np

from missions.errors import LinkError, UserError
from missions.frames import Array, ned_from_enu
from missions.mavlink_link import open_connection
from missions.messages import SiteBrief
from missions.mission import Mission
from missions.pads import takeoff_points
from missions.process import when_interrupted
from planning.trajectories.energy import energy_of
from vehicle.external.battery import ReportedBattery
from vehicle.external.body import ExternalBody, LocalFrame
from vehicle.external.goals import Goal
from vehicle.external.link import AutopilotLink
from vehicle.external.parameters import Setup, wishes_for
from vehicle.simulator import NS
from vehicle.vehicle import Vehicle

PREFIX = "mavlink:"
POLL_S = 0.02
HEARD_WITHIN_S, READY_WITHIN_S, SETUP_WITHIN_S, LEAVE_WITHIN_S = 60.0, 180.0, 15.0, 5.0
PAD_M = 3.0
"""An aircraft that stands farther than this from its pad has the wrong pad, or the wrong map."""
MAX_TICK_S = ALONE_TICK_S = 0.1

log = logging.getLogger(__name__)


class Companion:
    """One autopilot on one wire. Use as a context manager: leaving it brings an aircraft in the air home."""

    def __init__(self, url: str, vehicle_id: int, mission: Mission) -> None:
        """url: `mavlink:udpin://127.0.0.1:14540` and the like. Raises UserError."""
        check_clock(mission)
        self._url, self._mission = url, mission
        self.link = AutopilotLink(vehicle_id)
        self._connection = _open(url)
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._serve, name="autopilot", daemon=True)
        self._flown: ExternalBody | None = None
        self._vehicle: Vehicle | None = None

    def __enter__(self) -> Companion:
        self._thread.start()
        try:
            self._meet()
        except BaseException:
            self._close()
            raise
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        try:
            self._bring_home()
            self._leave()
        finally:
            self._close()

    def aircraft(self, site: SiteBrief) -> tuple[ExternalBody, ReportedBattery]:
        """Body and battery of the aircraft on its pad. Raises UserError where it does not stand there."""
        fleet, pad = self._mission.fleet, np.array(takeoff_points(self._mission, site)[self.link.system - 1])
        frame = aligned(self.link, self._mission, pad)
        self._flown = ExternalBody(self.link, frame, pad, fleet, time.monotonic)
        return self._flown, ReportedBattery(energy_of(self._mission), self._battery_percent)

    def carries(self, vehicle: Vehicle) -> None:
        """This one decides, also when everybody else is gone."""
        self._vehicle = vehicle

    def _battery_percent(self) -> float | None:
        said = self.link.said
        return said.battery_percent if said.battery_known(time.monotonic()) else None

    def _serve(self) -> None:
        """The thread: bytes in, frames out, until it is over. If it fails the vehicle has to know."""
        try:
            while not self._over.is_set():
                if self._connection.select(POLL_S):
                    self._receive()
                for frame in self.link.poll(time.monotonic()):
                    self._connection.write(frame)
        except Exception:
            log.exception("uav%d: the link to the autopilot has failed", self.link.system)
            self.link.let_go = "the link has failed"
            raise

    def _receive(self) -> None:
        try:
            data = self._connection.recv(2**16)
        except OSError as e:
            log.warning("uav%d: %s: %s", self.link.system, self._url, e)
            data = b""
        if data:
            self.link.receive(bytes(data), time.monotonic())
        else:
            self._over.wait(POLL_S)  # a wire that is broken is always ready

    def _meet(self) -> None:
        """Get to know the autopilot, and make sure that it can be flown. Raises UserError."""
        link, k = self.link, self.link.system
        self._require(self._wait(lambda: link.said.heartbeat_s > 0.0, HEARD_WITHIN_S),
                      f"is not heard{self._others()}; set MAV_SYS_ID (PX4) or SYSID_THISMAV (ArduPilot) to {k} and "
                      "send its telemetry here")
        self._require(link.said.dialect is not None, "is neither a PX4 nor an ArduPilot; only these are flown")
        self._set_up()
        self._require(self._wait(lambda: link.said.located and link.said.landed is not None, READY_WITHIN_S),
                      "does not say where it is; wait for its position estimate (GPS fix) and start again")
        self._require(not link.said.armed and bool(link.said.landed),
                      "is armed or in the air; land and disarm it, then start again")
        self._require(self._wait(lambda: link.said.battery_percent is not None, SETUP_WITHIN_S),
                      "reports no battery level, and unknown is not enough; set up its battery (BAT1_* of PX4, BATT_* "
                      "of ArduPilot)")

    def _set_up(self) -> None:
        """Check the parameters. Raises UserError where the aircraft would be lost without this computer."""
        link, dialect = self.link, self.link.said.dialect
        assert dialect is not None, "only a known autopilot has known parameters"
        link.setup = setup = Setup(link.system, dialect, wishes_for(dialect, self._mission.fleet))
        self._wait(lambda: setup.over(link.parameters), SETUP_WITHIN_S)
        link.setup = None
        for change in setup.changed:
            log.warning("uav%d: parameter %s", link.system, change)
        for name in setup.unmet(link.parameters, vital=False):
            log.warning("uav%d: parameter %s is unknown or too low: it may fall behind its flights", link.system, name)
        vital = setup.unmet(link.parameters, vital=True)
        self._require(not vital, f"does not take {', '.join(vital)}, so it would not stop by itself if this computer "
                                 "failed; set that by hand")

    def _others(self) -> str:
        return f"; heard systems {sorted(self.link.strangers)}" if self.link.strangers else ""

    def _require(self, so: bool, complaint: str) -> None:
        if not so:
            raise UserError(f"--autopilot {self._url}: system {self.link.system} {complaint}.")

    def _wait(self, until: Callable[[], bool], timeout_s: float) -> bool:
        deadline = time.monotonic() + timeout_s
        while not until():
            if time.monotonic() > deadline or not self._thread.is_alive():
                return False
            time.sleep(POLL_S)
        return True

    @property
    def _in_hand(self) -> bool:
        """Whether the aircraft is off the ground, or about to be, and nobody else flies it."""
        link = self.link
        return self._flown is not None and bool(link.said.armed) and not link.let_go and link.goal is not Goal.NOTHING

    def _bring_home(self) -> None:
        """The clock has stopped, the aircraft has not: home by the vehicle's own ways, with its own failsafes. Whoever
        ends the process twice meanwhile has the autopilot return."""
        vehicle, body = self._vehicle, self._flown
        if vehicle is None or body is None or not self._in_hand:
            return
        log.warning("uav%d: nobody is left on the clock; comes home alone", self.link.system)
        begin_ns, begin_s, told = body.t_ns, time.monotonic(), list[int]()
        try:
            vehicle.executor.go_home(begin_ns)
            with when_interrupted(lambda number, _: told.append(number)):
                while vehicle.executor.flying and self._in_hand and len(told) < 2:
                    self._over.wait(ALONE_TICK_S)
                    vehicle.step(begin_ns + round((time.monotonic() - begin_s) * NS), [], frozenset())
        except Exception:
            log.exception("uav%d: cannot come home alone", self.link.system)

    def _leave(self) -> None:
        """In the air all the same: home by the autopilot's own means."""
        link = self.link
        if not self._in_hand or link.goal is Goal.LAND:
            return
        log.warning("uav%d: leaves the aircraft in the air: the autopilot returns by itself", link.system)
        link.pursue(Goal.RETURN)
        if not self._wait(lambda: bool(link.let_go) or link.said.mode in ("return", "land"), LEAVE_WITHIN_S):
            log.error("uav%d: the autopilot does not confirm that it returns", link.system)

    def _close(self) -> None:
        self._over.set()
        if self._thread.ident is not None:
            self._thread.join(LEAVE_WITHIN_S)
        self._connection.close()


def _open(url: str) -> Any:
    """The bytes' way. Raises UserError."""
    try:
        return open_connection(url.removeprefix(PREFIX))
    except LinkError as e:
        raise UserError(f"--autopilot {e}") from None


def check_clock(mission: Mission) -> None:
    """Real aircraft fly in real time. Raises UserError."""
    clock = mission.clock
    if clock.speed != 1.0 or clock.tick_s > MAX_TICK_S:
        raise UserError(f"--autopilot: real aircraft fly in real time, not at clock.speed = {clock.speed:g} with "
                        f"clock.tick_s = {clock.tick_s:g}; set them to 1 and at most {MAX_TICK_S:g}.")


def aligned(link: AutopilotLink, mission: Mission, pad_enu_m: Array) -> LocalFrame:
    """Where the local frame of an aircraft on its pad lies: sideways by its position on Earth, in height by the pad,
    because altitudes above sea level, ellipsoid and home are easily confused. Raises UserError."""
    position_ned_m, geodetic = link.said.position_ned_m, link.said.geodetic
    if position_ned_m is None or geodetic is None:
        raise UserError(f"--autopilot: vehicle {link.system} does not say where it is any more; start again.")
    anchor = mission.site.anchor
    here, local = anchor.enu_from_geodetic(geodetic[0], geodetic[1], anchor.alt_m), ned_from_enu(position_ned_m)
    away_m = float(np.linalg.norm((here - pad_enu_m)[:2]))
    if away_m > PAD_M:
        raise UserError(f"--autopilot: vehicle {link.system} stands {away_m:.1f} m from its take-off point at "
                        f"({pad_enu_m[0]:.1f}, {pad_enu_m[1]:.1f}) m; put it there, or correct fleet.takeoff_enu_m or "
                        "site.origin_*.")
    return LocalFrame(np.array([here[0] - local[0], here[1] - local[1], pad_enu_m[2] - local[2]]))
