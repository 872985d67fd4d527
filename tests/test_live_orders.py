"""A person's commands on the link to one vehicle: beside the mission's own, answered, never in each other's way."""

from __future__ import annotations

from pymavlink.dialects.v20 import common as mav

from ground_station.fleet_link import COMMAND_DEADLINE_S, NO_ANSWER, VehicleLink, arm, pause, return_to_launch, takeoff
from missions.clock import SECOND_NS
from missions.frames import Site
from missions.mavlink import AUTOPILOT_COMPONENT, GROUND_COMPONENT, GROUND_SYSTEM, Endpoint

SECONDS = SECOND_NS


class Wire:
    """A link, and the vehicle's end of it."""

    def __init__(self) -> None:
        self.link = VehicleLink(1, Site(52.0, 6.0, 0.0))
        self._vehicle, self._ground = Endpoint(1, AUTOPILOT_COMPONENT), Endpoint(GROUND_SYSTEM, GROUND_COMPONENT)

    def heard(self, t_s: float) -> list[int]:
        """Commands that reach the vehicle now."""
        messages = self._ground.parse(self.link.poll(round(t_s * SECONDS)).frames)
        return [m.command for m in messages if m.get_type() == "COMMAND_LONG"]

    def acknowledge(self, command: int, result: int = mav.MAV_RESULT_ACCEPTED) -> None:
        self.link.on_frames([self._vehicle.pack(mav.MAVLink_command_ack_message(command, result))])


def test_an_order_passes_what_the_mission_has_queued_and_leaves_it_alone() -> None:
    wire = Wire()
    wire.link.command(arm(), takeoff(10.0))
    assert wire.heard(0.0) == [mav.MAV_CMD_COMPONENT_ARM_DISARM]
    order = wire.link.order(pause())
    assert wire.heard(0.1) == [mav.MAV_CMD_DO_PAUSE_CONTINUE]
    assert order.result is None
    wire.acknowledge(mav.MAV_CMD_DO_PAUSE_CONTINUE, mav.MAV_RESULT_DENIED)
    assert order.result == mav.MAV_RESULT_DENIED
    assert wire.link.take_failure() == ""
    wire.acknowledge(mav.MAV_CMD_COMPONENT_ARM_DISARM)
    assert wire.heard(0.2) == [mav.MAV_CMD_NAV_TAKEOFF]


def test_orders_go_one_after_the_other_and_are_repeated_until_acknowledged() -> None:
    wire = Wire()
    first, second = wire.link.order(pause()), wire.link.order(return_to_launch())
    sent = [wire.heard(t) for t in (0.0, 0.5, 1.0)]
    assert sent == [[mav.MAV_CMD_DO_PAUSE_CONTINUE], [], [mav.MAV_CMD_DO_PAUSE_CONTINUE]]
    wire.acknowledge(mav.MAV_CMD_NAV_RETURN_TO_LAUNCH)
    assert (first.result, second.result) == (None, None)
    wire.acknowledge(mav.MAV_CMD_DO_PAUSE_CONTINUE)
    assert wire.heard(1.1) == [mav.MAV_CMD_NAV_RETURN_TO_LAUNCH]
    wire.acknowledge(mav.MAV_CMD_NAV_RETURN_TO_LAUNCH)
    assert wire.heard(1.2) == []
    assert (first.result, second.result, wire.link.busy) == (mav.MAV_RESULT_ACCEPTED, mav.MAV_RESULT_ACCEPTED, False)


def test_who_does_not_answer_is_said_not_to() -> None:
    wire = Wire()
    order = wire.link.order(pause())
    wire.heard(0.0)
    wire.heard(COMMAND_DEADLINE_S)
    assert order.result == NO_ANSWER
    wire.heard(COMMAND_DEADLINE_S + 0.1)
    assert not wire.link.busy
    assert wire.link.take_failure() == ""


def test_a_held_vehicle_gets_no_command_of_the_mission_and_has_not_missed_it_afterwards() -> None:
    wire = Wire()
    wire.link.command(takeoff(10.0))
    assert wire.heard(0.0) == [mav.MAV_CMD_NAV_TAKEOFF]
    wire.link.held = True
    assert [wire.heard(t) for t in (1.0, 10.0, 1000.0)] == [[], [], []]
    wire.link.held = False
    assert wire.heard(1001.0) == [mav.MAV_CMD_NAV_TAKEOFF]
    assert wire.link.take_failure() == ""


def test_only_urgent_texts_are_kept_for_people() -> None:
    wire = Wire()
    for severity, text in ((mav.MAV_SEVERITY_WARNING, b"plan refused: fence"), (mav.MAV_SEVERITY_INFO, b"landed")):
        wire.link.on_frames([wire._vehicle.pack(mav.MAVLink_statustext_message(severity, text))])
    assert wire.link.telemetry.warning == "plan refused: fence"
