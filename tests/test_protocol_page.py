"""docs/protocol.md says what the code does."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import common as mav

from missions import topics
from vehicle import client_plan
from vehicle.autopilot import commands, message_requests, mission_service, services, telemetry
from vehicle.autopilot.parameters import OF_DIALECT
from vehicle.dialects import ARDUPILOT, DIALECTS, PX4

PAGE = (Path(__file__).parent.parent / "docs" / "protocol.md").read_text(encoding="utf-8")


def table(name: str) -> list[list[str]]:
    """Cells of the table under this comment, without its head."""
    lines = PAGE.split(f"<!-- table: {name} -->\n")[1].split("\n\n")[0].splitlines()
    return [[cell.strip().strip("`") for cell in line.strip("|").split("|")] for line in lines[2:]]


def short(command: int) -> str:
    return str(mav.enums["MAV_CMD"][command].name).removeprefix("MAV_CMD_")


def message(number: int) -> str:
    return str(mav.mavlink_map[number].msgname)


def yes(value: bool) -> str:
    return "yes" if value else "no"


def test_topics() -> None:
    known = [t for t in vars(topics).values() if isinstance(t, topics.Topic)]
    assert sorted(row[:3] for row in table("topics")) == sorted(
        [t.path, t.type.__name__, yes(t.lockstep)] for t in known)


def test_streams() -> None:
    assert table("streams") == [[message(s.number), str(s.component), f"{s.every_s:g}", yes(s.ours)]
                                for s in telemetry.STREAMS]


def test_messages_on_request() -> None:
    streamed = {(s.component, message(s.number)) for s in telemetry.STREAMS}
    asked = {(component, message(number)) for component, number in message_requests.ANSWERS} - streamed
    assert {(int(c), name) for name, components in table("on request") for c in components.split(",")} == asked


def test_commands_and_who_may_give_them() -> None:
    rows = table("commands")
    assert [name for name, *_ in rows] == [short(c) for c in commands.COMMANDS]
    for name, who, _ in rows:
        needs = any(short(c) == name for c in commands.NEEDS_LEASE)
        looks_itself = name in ("DO_SET_MODE", "COMPONENT_ARM_DISARM", "MISSION_START")
        assert who.startswith("leader") == (needs or looks_itself), name


def test_other_messages() -> None:
    assert [name for name, _ in table("services")] == [*services._SERVICES, *mission_service._HANDLERS]


def test_items_of_a_mission() -> None:
    assert [name for name, _ in table("items")] == [short(c) for c in client_plan._READERS]


def test_modes_and_differences() -> None:
    told = {(identity, mode): number for mode, *numbers in table("modes")
            for identity, number in zip(("px4", "ardupilot"), numbers, strict=True) if number != "-"}
    assert told == {(d.name, mode): str(n) for d in DIALECTS.values() for mode, n in d.mode_numbers.items()}
    for field, _, *values in table("differences"):
        for dialect, value in zip((PX4, ARDUPILOT), values, strict=True):
            is_so = getattr(dialect, field)
            assert value == (yes(is_so) if isinstance(is_so, bool) else str(is_so)), field


def test_parameters() -> None:
    assert table("parameters") == [[p.name, identity, yes(p.put is not None)]
                                   for identity, parameters in OF_DIALECT.items() for p in parameters]


@pytest.mark.parametrize(("said", "value"), [
    (r"up to (\d+) items each", mission_service.MAX_ITEMS),
    (r"after (\d+) ms, \d+ times", mission_service.REQUEST_AGAIN_NS // 1_000_000),
    (r"after \d+ ms, (\d+) times", mission_service.GIVE_UP_AFTER)])
def test_limits(said: str, value: int) -> None:
    found = re.search(said, PAGE)
    assert found is not None
    assert int(found[1]) == value


def test_every_difference_of_the_dialects_is_told() -> None:
    told = {field for field, *_ in table("differences")}
    assert set(vars(PX4)) - told == {"name", "mode_numbers", "other_numbers", "unset"}
