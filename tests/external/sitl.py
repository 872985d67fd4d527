"""An autopilot that somebody else runs, as the tests see it: who and where it is, and how to get it down again."""

from __future__ import annotations

import time
from collections.abc import Callable
from types import TracebackType

from pymavlink.dialects.v20 import common as mav

from missions.mavlink import AUTOPILOT_COMPONENT, Endpoint
from missions.mavlink_link import open_connection
from vehicle.external.goals import Goal
from vehicle.external.link import AutopilotLink
from vehicle.external.telemetry import Telemetry

FOUND_WITHIN_S, READY_WITHIN_S, LANDED_WITHIN_S = 60.0, 180.0, 180.0


class Sitl:
    """A wire to it that is served while the test waits for something."""

    def __init__(self, url: str) -> None:
        self.url = url
        self._connection = open_connection(url)
        self.link = AutopilotLink(self._system())

    def __enter__(self) -> Sitl:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        """Get it down, whatever the test left behind."""
        try:
            if self.link.said.armed:
                self.link.regain()
                self.link.pursue(Goal.RETURN)
                self.wait(lambda: self.link.said.armed is False, LANDED_WITHIN_S)
        finally:
            self.close()

    def close(self) -> None:
        """Leave the wire to somebody else."""
        self._connection.close()

    @property
    def said(self) -> Telemetry:
        """What it last said of itself."""
        return self.link.said

    def ready(self) -> None:
        """Wait until it knows where it is."""
        said = self.link
        assert self.wait(lambda: said.said.located and said.said.landed is not None
                         and said.said.battery_percent is not None, READY_WITHIN_S), "it never knew where it is"
        assert not self.said.armed, "it is armed; land and disarm it first"

    def wait(self, until: Callable[[], bool], timeout_s: float, deaf: bool = False, mute: bool = False) -> bool:
        """Serve the wire until something is so. deaf: take nothing in; mute: send nothing, as after a crash."""
        deadline = time.monotonic() + timeout_s
        while not until():
            if time.monotonic() > deadline:
                return False
            for data in self._received():
                if not deaf:
                    self.link.receive(data, time.monotonic())
            self.link.ground_s = time.monotonic()
            for frame in [] if mute else self.link.poll(time.monotonic()):
                self._connection.write(frame)
        return True

    def _received(self) -> list[bytes]:
        if not self._connection.select(0.02):
            return []
        data = self._connection.recv(2**16)
        return [bytes(data)] if data else []

    def _system(self) -> int:
        """The system id of the first autopilot that is heard."""
        ear, deadline = Endpoint(1, mav.MAV_COMP_ID_ONBOARD_COMPUTER), time.monotonic() + FOUND_WITHIN_S
        while time.monotonic() < deadline:
            for data in self._received():
                for message in ear.parse([data]):
                    if message.get_type() == "HEARTBEAT" and message.get_srcComponent() == AUTOPILOT_COMPONENT:
                        return int(message.get_srcSystem())
            self._connection.write(ear.pack(mav.MAVLink_heartbeat_message(
                mav.MAV_TYPE_ONBOARD_CONTROLLER, mav.MAV_AUTOPILOT_INVALID, 0, 0, mav.MAV_STATE_ACTIVE, 3)))
        raise AssertionError(f"no autopilot was heard at {self.url} within {FOUND_WITHIN_S:.0f} s")
