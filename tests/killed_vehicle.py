"""A vehicle process that is killed in the midst of its mission at a simulated time, the same on machines of any speed:
`KILL_AT_S=31.8 python -m tests.killed_vehicle MISSION.toml ...`, with the arguments of `python -m vehicle`."""

from __future__ import annotations

import os
import signal
import sys

from missions.bus import Delivery
from missions.clock import SECOND_NS
from vehicle.__main__ import main
from vehicle.modes import MISSION
from vehicle.vehicle import Outgoing, Vehicle

KILL_AT_S = "KILL_AT_S"


class KilledVehicle(Vehicle):
    """Does not live to answer the first tick after its time has come at which it flies its plan. Who takes its place
    after that time lives on."""

    doomed = False

    def step(self, t_ns: int, deliveries: list[Delivery], participants: frozenset[str]) -> list[Outgoing]:
        """As a vehicle, while it lives."""
        come = t_ns >= float(os.environ[KILL_AT_S]) * SECOND_NS
        self.doomed = self.doomed or not come
        if come and self.doomed and self.executor.mode == MISSION:
            os.kill(os.getpid(), signal.SIGKILL)
        return super().step(t_ns, deliveries, participants)


if __name__ == "__main__":
    sys.modules[main.__module__].Vehicle = KilledVehicle  # type: ignore[attr-defined]
    sys.exit(main())
