"""Faults that a built-in vehicle simulates because its mission asks for them. A real body has its own."""

from __future__ import annotations

from dataclasses import replace

from missions.simulation import FaultSpec
from vehicle.battery import Battery
from vehicle.health import Health
from vehicle.simulator import NS


class SimulatedFaults:
    """The faults of one vehicle. Every one is told as what it is when it begins and when it ends."""

    def __init__(self, specs: list[FaultSpec], vehicle_id: int) -> None:
        self._specs = [s for s in specs if s.vehicle == vehicle_id]
        self._on: list[FaultSpec] = []

    def on(self, kind: str) -> bool:
        """Whether there is such a fault now."""
        return any(s.kind == kind for s in self._on)

    def step(self, t_ns: int, battery: Battery) -> list[str]:
        """Let faults begin and end; what people should know of it."""
        texts = []
        for spec in self._specs:
            due, on = spec.at_s <= t_ns / NS < spec.until_s, spec in self._on
            if due == on:
                continue
            texts.append(f"simulated fault: {spec.kind} {'begins' if due else 'ends'}")
            (self._on.append if due else self._on.remove)(spec)
            if spec.kind == "battery_sag":
                level = battery.level_percent - spec.amount if due else battery.level_percent + spec.amount
                battery.level_percent = min(100.0, max(0.0, level))
        return texts

    def health(self, told: Health) -> Health:
        """What the body says, with the faults in it."""
        if not self._on:
            return told
        jump_s = sum(s.amount for s in self._on if s.kind == "clock_jump")
        return replace(told, position_valid=told.position_valid and not self.on("position_lost"),
                       battery_known=told.battery_known and not self.on("battery_silent"),
                       utc_offset_s=told.utc_offset_s + jump_s)
