"""What a vehicle was told in flight and what its range sensor has seen: kept for the process that takes its place."""

from __future__ import annotations

import logging
from dataclasses import fields, replace
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from missions.mavlink import Item
from missions.messages import Vector, vector
from vehicle.autopilot.craft import FENCE
from vehicle.failsafe_table import Action, Trigger
from vehicle.sensor_memory import Sensed

if TYPE_CHECKING:
    from vehicle.vehicle import Vehicle

log = logging.getLogger(__name__)

PERIOD_NS = 10_000_000_000
"""How often what the range sensor has seen is kept."""


class SetInFlight(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """What may be set in flight, as it is now."""

    numbers: dict[str, float | None]
    """Of the `Settings`, by field."""
    actions: dict[str, int]
    """Of the failsafe, by trigger."""
    fence_enabled: bool
    box_enu_m: tuple[Vector, Vector]
    """The geofence without what was uploaded."""
    fence: list[Item]
    """What was uploaded."""


class OnBoard(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """All of it, of one mission."""

    mission_hash: str
    told: SetInFlight
    sensed: Sensed


def set_in_flight(vehicle: Vehicle) -> SetInFlight:
    """What people have set, of a vehicle as it is."""
    craft, box = vehicle.faces.craft, vehicle.judge.box
    numbers = {f.name: getattr(craft.settings, f.name) for f in fields(craft.settings) if f.name != "actions"}
    return SetInFlight(numbers, {t.value: int(a) for t, a in craft.settings.actions.items()}, craft.fence_enabled,
                       (vector(box.lower_enu_m), vector(box.upper_enu_m)), list(craft.shelves[FENCE].items))


def recall(vehicle: Vehicle, kept: OnBoard) -> None:
    """Before its first step: what a process that has died was told, and what its range sensor had seen."""
    craft, told = vehicle.faces.craft, kept.told
    actions = {Trigger(name): Action(action) for name, action in told.actions.items()}
    numbers: dict[str, Any] = told.numbers
    craft.set(replace(craft.settings, actions=MappingProxyType(actions), **numbers))
    craft.fence_enabled = told.fence_enabled
    craft.shelves[FENCE].put(told.fence)
    lower, upper = map(np.array, told.box_enu_m)
    vehicle.judge.recall((lower, upper), told.fence)
    vehicle.follow_fence()
    vehicle.memory.recall(kept.sensed)


class OnBoardFile:
    """Holds the newest, whole."""

    def __init__(self, path: Path, mission_hash: str) -> None:
        self._path, self._mission_hash = path, mission_hash
        self._told: SetInFlight | None = None
        self._due_ns = 0
        self._troubled = False
        self.found = self._read()
        """What an earlier process of this mission left."""

    def keep(self, vehicle: Vehicle, t_ns: int) -> None:
        """What was set at once, what was seen now and then; where the disk does not take it, what was kept before
        stays."""
        told = set_in_flight(vehicle)
        if told == self._told and t_ns < self._due_ns:
            return
        self._told, self._due_ns = told, t_ns + PERIOD_NS
        part = self._path.with_name(f"{self._path.name}.part")
        try:
            part.write_bytes(msgspec.msgpack.encode(OnBoard(self._mission_hash, told, vehicle.memory.sensed)))
            part.replace(self._path)
        except OSError as e:
            if not self._troubled:
                log.error("settings and what the range sensor has seen are not kept: %s", e)
            self._troubled = True
        else:
            self._troubled = False

    def _read(self) -> OnBoard | None:
        try:
            found = msgspec.msgpack.decode(self._path.read_bytes(), type=OnBoard)
        except (OSError, msgspec.DecodeError):
            return None
        return found if found.mission_hash == self._mission_hash else None
