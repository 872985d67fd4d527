"""The world of one process (vehicle_world) with vehicles whose bodies are stub autopilots, in simulated time."""

from __future__ import annotations

import random
from pathlib import Path

import numpy as np

from missions.frames import Array
from missions.mission import Mission
from missions.pads import takeoff_points
from planning.trajectories.energy import energy_of
from tests.autopilot_stub import DT, AutopilotStub
from tests.vehicle_world import NS, SITE, World
from vehicle.external.battery import ReportedBattery
from vehicle.external.body import ExternalBody
from vehicle.external.companion import aligned
from vehicle.external.link import AutopilotLink
from vehicle.external.parameters import Setup, wishes_for
from vehicle.vehicle import Vehicle

BOOTED_S = 8.0


class Attached:
    """A companion's link and a stub, wired together without a wire."""

    def __init__(self, stub: AutopilotStub) -> None:
        self.stub, self.link, self.t_s = stub, AutopilotLink(stub.system), 0.0
        self.alive, self.cut, self.loss = True, False, 0.0
        """Whether the companion's process lives, the wire is cut, and the share of frames that it loses."""
        self._dice = random.Random(5)

    def pump(self, until_s: float) -> None:
        """Both ends up to this time."""
        while self.t_s + DT <= until_s + 1e-9:
            self.t_s += DT
            for frame in self.link.poll(self.t_s) if self.alive else []:
                if self._arrives():
                    self.stub.receive(frame)
            for frame in self.stub.step(self.t_s):
                if self._arrives():
                    self.link.receive(frame, self.t_s)

    def _arrives(self) -> bool:
        return not self.cut and self._dice.random() >= self.loss

    def set_up(self, mission: Mission) -> Setup:
        """Boot it, and go through its parameters."""
        self.pump(BOOTED_S)
        assert self.link.said.dialect is not None
        self.link.setup = setup = Setup(self.stub.system, self.link.said.dialect,
                                        wishes_for(self.link.said.dialect, mission.fleet))
        self.pump(self.t_s + 6.0)
        self.link.setup = None
        return setup


def stub_on_pad(mission: Mission, kind: str, vehicle_id: int = 1, **options: float) -> AutopilotStub:
    """An autopilot that stands where the mission wants it."""
    lat, lon, alt = mission.site.anchor.geodetic_from_enu(np.array(takeoff_points(mission, SITE)[vehicle_id - 1]))
    return AutopilotStub(kind, vehicle_id, (lat, lon, alt + 46.5), **options)


class AutopilotWorld(World):
    """Some of the vehicles are stubs behind companions. Simulated time is the companions' time, from boot on."""

    def __init__(self, mission: Mission, folder: Path, kinds: dict[int, str], **options: float) -> None:
        """kinds: "px4" or "ardupilot" for those vehicles that have a real autopilot."""
        super().__init__(mission, folder)
        self.attached: dict[int, Attached] = {}
        for k, kind in kinds.items():
            attached = self.attached[k] = Attached(stub_on_pad(mission, kind, k, **options))
            attached.set_up(mission)
            self.vehicles[k] = self._vehicle(k, attached, folder)
        self._offset_s = {k: a.t_s for k, a in self.attached.items()}

    def tick(self) -> None:
        """The autopilots up to now, then one tick of everybody."""
        for k, attached in self.attached.items():
            attached.pump(self._offset_s[k] + self.t_ns / NS)
        super().tick()

    def stub_enu(self, k: int) -> Array:
        """(3,) where the stub truly is."""
        north, east, down = self.attached[k].stub.air.position
        return np.array(takeoff_points(self.mission, SITE)[k - 1]) + np.array([east, north, -down])

    def _vehicle(self, k: int, attached: Attached, folder: Path) -> Vehicle:
        pad, fleet, link = np.array(takeoff_points(self.mission, SITE)[k - 1]), self.mission.fleet, attached.link
        body = ExternalBody(link, aligned(link, self.mission, pad), pad, fleet, lambda: attached.t_s)
        battery = ReportedBattery(energy_of(self.mission), lambda: (
            link.said.battery_percent if link.said.battery_known(attached.t_s) else None))
        return Vehicle(self.mission, SITE, k, folder / str(k), body=body, battery=battery)
