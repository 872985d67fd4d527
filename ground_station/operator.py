"""Carries out what operators ask for, and answers once the vehicles that were asked have acknowledged it.

Commands arrive when somebody sends them, so a flight with commands is not repeatable; one without is not touched.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import common as mav

from ground_station.control import Control
from ground_station.director import Director
from ground_station.drone import Drone, FenceAsked
from ground_station.fleet_link import NO_ANSWER, Command
from ground_station.voice import Voice
from missions import live, topics
from missions.bus import Delivery
from missions.frames import Array
from missions.messages import vector

log = logging.getLogger(__name__)

REMEMBERED = 1000
"""Commands known by their id, so that one that is sent again is not carried out again."""
RESULTS = {
    mav.MAV_RESULT_ACCEPTED: "accepted", mav.MAV_RESULT_TEMPORARILY_REJECTED: "cannot do that now",
    mav.MAV_RESULT_DENIED: "refuses", mav.MAV_RESULT_UNSUPPORTED: "does not know how", mav.MAV_RESULT_FAILED: "failed",
    NO_ANSWER: "did not answer",
}


@dataclass
class _Asked:
    """A command on its way to vehicles. sent: the MAVLink command by vehicle; said: what is known without one."""

    command_id: str
    text: str
    sent: dict[int, Command | FenceAsked] = field(default_factory=dict)
    said: list[live.VehicleAnswer] = field(default_factory=list)
    then: Callable[[], None] | None = None
    """What is to be done once all have accepted."""


class Operator:
    """The people at the live page, and programs that use its interface, as the mission hears them."""

    def __init__(self, control: Control, director: Director, voice: Voice, waits_for_start: bool = False) -> None:
        self._control, self._director, self._voice = control, director, voice
        self._fleet = control.fleet
        self._asked: list[_Asked] = []
        self._heard: dict[str, live.AnyAction] = {}
        self._answers: dict[str, live.OperatorAnswer] = {}
        self.started = not waits_for_start

    def receive(self, beside: Iterable[Delivery]) -> None:
        """Carry out the commands among what has come outside of the lock-step."""
        for delivery in beside:
            if isinstance(delivery.message, live.OperatorCommand):
                self._obey(delivery.message)

    def answer(self) -> None:
        """Tell the outcome of every command whose vehicles have all answered."""
        for asked in list(self._asked):
            answers = [self._of_vehicle(k, command) for k, command in asked.sent.items()]
            if None not in answers:
                self._asked.remove(asked)
                known = sorted([*asked.said, *(a for a in answers if a is not None)], key=lambda a: a.vehicle_id)
                accepted = all(a.accepted for a in known)
                if accepted and asked.then is not None:
                    asked.then()
                self._publish(asked.command_id, accepted, asked.text, known)

    def _obey(self, command: live.OperatorCommand) -> None:
        """What comes outside of the lock-step may be lost, so a command comes again until its answer has arrived."""
        action = command.action
        if command.command_id in self._heard:
            self._answer_again(command)
            return
        self._heard[command.command_id] = action
        text = _ACTIONS[type(action)](self, command.command_id, action)
        self._control.note(f"operator: {describe(action)}{': ' + text if text else ''}")
        if text is not None:
            self._publish(command.command_id, not text, text or describe(action), [])

    def _answer_again(self, command: live.OperatorCommand) -> None:
        name = command.command_id
        answer = self._answers.get(name)
        if self._heard[name] != command.action:
            answer = live.OperatorAnswer(command_id=name, accepted=False, text=(
                f"command_id {name} was another command's; give each command an id of its own"))
        if answer is not None:
            self._voice.publish(topics.OPERATOR_ANSWER, answer)

    def _publish(self, command_id: str, accepted: bool, text: str, vehicles: list[live.VehicleAnswer]) -> None:
        log.info("operator: %s: %s", text, "done" if accepted else "refused")
        answer = live.OperatorAnswer(command_id=command_id, accepted=accepted, text=text, vehicles=vehicles)
        self._answers[command_id] = answer
        while len(self._answers) > REMEMBERED:
            oldest = next(iter(self._answers))
            del self._answers[oldest], self._heard[oldest]
        self._voice.publish(topics.OPERATOR_ANSWER, answer)

    def _of_vehicle(self, vehicle_id: int, command: Command | FenceAsked) -> live.VehicleAnswer | None:
        """None while it has not answered."""
        if self._fleet.drones[vehicle_id].gone:
            return live.VehicleAnswer(vehicle_id=vehicle_id, accepted=False, text="is lost")
        if isinstance(command, FenceAsked):
            verdict = command.verdict
            return None if verdict is None else live.VehicleAnswer(
                vehicle_id=vehicle_id, accepted=verdict.accepted, text=verdict.reason or "accepted")
        if command.result is None:
            return None
        return live.VehicleAnswer(vehicle_id=vehicle_id, accepted=command.result == mav.MAV_RESULT_ACCEPTED,
                                  text=RESULTS.get(command.result, f"answered {command.result}"))

    def _ask(self, command_id: str, action: live.AnyAction, send: Callable[[Drone], Command | FenceAsked | None],
             then: Callable[[], None] | None = None) -> str | None:
        """Ask one or all vehicles (the reserve only about the fence); None: they will answer. A sentence when there is
        nobody to ask."""
        who, fence = getattr(action, "vehicle_id", live.ALL), isinstance(action, live.MoveFence)
        drones = [d for d in self._fleet.drones.values() if not d.gone
                  and (d.vehicle_id == who or (who == live.ALL and (fence or not d.reserve)))]
        if not drones:
            return f"there is no vehicle {who} any more" if who else "no vehicle is left"
        asked = _Asked(command_id, describe(action), then=then)
        for drone in drones:
            command = send(drone)
            if command is not None:
                asked.sent[drone.vehicle_id] = command
            else:
                asked.said.append(live.VehicleAnswer(vehicle_id=drone.vehicle_id, accepted=True, text="is on its pad"))
        self._asked.append(asked)
        return None

    def _start(self, command_id: str, action: live.Start) -> str:
        if self.started:
            return "the mission has begun already"
        self.started = True
        return ""

    def _pause(self, command_id: str, action: live.Pause) -> str | None:
        return self._ask(command_id, action, self._fleet.pause)

    def _resume(self, command_id: str, action: live.Resume) -> str | None:
        return self._ask(command_id, action, self._fleet.resume)

    def _home(self, command_id: str, action: live.Home) -> str | None:
        return self._ask(command_id, action, self._fleet.recall)

    def _land(self, command_id: str, action: live.Land) -> str | None:
        return self._ask(command_id, action, self._fleet.land)

    def _drop(self, command_id: str, action: live.Drop) -> str | None:
        return self._ask(command_id, action, self._fleet.drop)

    def _add(self, command_id: str, action: live.Add) -> str:
        drone = self._fleet.drones.get(action.vehicle_id)
        if drone is None or drone.gone:
            return (f"vehicle {action.vehicle_id} does not take part in this mission's clock; vehicles that may be "
                    "needed later are started with the mission: fleet.reserve")
        if drone.spent and not drone.swaps_left:
            return f"vehicle {action.vehicle_id} has no energy left, or has landed elsewhere"
        if not drone.dropped:
            return f"vehicle {action.vehicle_id} takes part already"
        if self._director.phase in ("return", "over"):
            return "the mission comes home already; there is nothing to take over"
        self._fleet.add(drone)
        return ""

    def _abort(self, command_id: str, action: live.Abort) -> str | None:
        self.started = True
        self._director.abort()
        return self._ask(command_id, action, self._fleet.abandon)

    def _move_fence(self, command_id: str, action: live.MoveFence) -> str | None:
        """Inside of what is on board the ground moves it; beyond that all vehicles have to take it on board first."""
        regions, lower, upper = self._control.regions, action.lower_enu_m, action.upper_enu_m

        def move(at: dict[int, Array]) -> str:
            refusal = regions.against_fence(lower, upper, at)
            if not refusal:
                regions.move_fence(lower, upper)
            return refusal

        if not regions.beyond_board(lower, upper):
            return self._change(move)
        refusal = self._closed or regions.against_fence(lower, upper, {})
        if refusal or not self.started:
            return refusal or "vehicles hear of it only once the mission has begun"
        now = regions.on_board_enu_m
        wider = vector(np.minimum(lower, now[0])), vector(np.maximum(upper, now[1]))

        def accepted() -> None:
            regions.accept(*wider)
            refusal = self._change(move)
            if refusal:
                self._control.note(f"operator: the fence stays where it was: {refusal}")

        return self._ask(command_id, action, lambda drone: self._fleet.widen_fence(drone, *wider), accepted)

    def _mark(self, command_id: str, action: live.MarkRegion) -> str:
        return self._change(lambda at: self._control.regions.mark(action, at), closes=action.kind == "forbidden")

    def _clear(self, command_id: str, action: live.ClearRegion) -> str:
        return self._change(lambda at: self._control.regions.clear(action.region_id), closes=False)

    def _change(self, change: Callable[[dict[int, Array]], str], closes: bool = True) -> str:
        """Change a mark; ways are closed by it, unless it only changes what counts."""
        if closes and self._closed:
            return self._closed
        at = {d.vehicle_id: d.position_enu_m for d in self._fleet.drones.values() if d.airborne}
        refusal = change(at)
        if not refusal:
            self._director.regions_changed()
        return refusal

    def _speed(self, command_id: str, action: live.SetSpeed) -> str:
        return "only a recording can be played faster or slower"

    @property
    def _closed(self) -> str:
        """Why nothing can be closed or opened; "" when it can."""
        if self._control.prior is not None:
            return "with a prior model ways are planned on it; draw the limits in the mission file"
        return ""

    def _goal(self, command_id: str, action: live.SetGoal) -> str:
        if not 0.0 < action.coverage <= 1.0:
            return "the goal is a share of the structure, above 0 and up to 1"
        return self._director.aim_for(action.coverage)


def describe(action: live.AnyAction) -> str:
    """An action in words."""
    name = _WORDS[type(action)]
    if isinstance(action, live.MarkRegion):
        return f"{name} {action.kind}"
    if isinstance(action, live.SetGoal):
        return f"{name} {action.coverage:.0%}"
    vehicle_id = getattr(action, "vehicle_id", None)
    return name if vehicle_id is None else f"{name} {'all' if vehicle_id == live.ALL else f'vehicle {vehicle_id}'}"


_WORDS: dict[type[live.Action], str] = {
    live.Start: "start", live.Pause: "pause", live.Resume: "resume", live.Home: "send home", live.Land: "land",
    live.Drop: "drop", live.Add: "add", live.Abort: "abort the mission", live.MoveFence: "move the fence",
    live.MarkRegion: "mark a region as", live.ClearRegion: "clear a region", live.SetGoal: "explore up to coverage",
    live.SetSpeed: "play at another speed",
}
_ACTIONS: dict[type[live.Action], Callable[[Operator, str, Any], str | None]] = {
    live.Start: Operator._start, live.Pause: Operator._pause, live.Resume: Operator._resume, live.Home: Operator._home,
    live.Land: Operator._land, live.Drop: Operator._drop, live.Add: Operator._add, live.Abort: Operator._abort,
    live.MoveFence: Operator._move_fence, live.MarkRegion: Operator._mark, live.ClearRegion: Operator._clear,
    live.SetGoal: Operator._goal, live.SetSpeed: Operator._speed,
}
