"""A small real flight that a program watches and interferes with: pause, resume, home, regions, abort."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from ground_station import connect
from ground_station.live.client import LiveMission
from missions.live import LiveState
from tests.live_world import FLEET, flying, vehicle

pytestmark = [pytest.mark.loopback, pytest.mark.xdist_group("live")]
PATIENCE_S = 300.0


def until(mission: LiveMission, true: Callable[[LiveState], bool]) -> LiveState:
    deadline = time.monotonic() + PATIENCE_S
    for state in mission.states():
        if true(state):
            return state
        assert time.monotonic() < deadline, f"in vain: {state}"
    raise AssertionError("the mission was over before")


def moved(before: LiveState, after: LiveState, vehicle_id: int) -> float:
    a, b = (vehicle(s, vehicle_id).position_enu_m for s in (before, after))
    return sum((x - y) ** 2 for x, y in zip(a, b, strict=True)) ** 0.5


def test_a_program_starts_pauses_resumes_calls_home_and_ends_a_mission(tmp_path: Path) -> None:
    flight, endpoint = flying(tmp_path, "clock.speed=4.0")
    try:
        with connect(endpoint=endpoint, fleet=FLEET) as mission:
            waiting = mission.state
            assert (waiting.started, waiting.t_s) == (False, 0.0)
            assert [a.name for a in waiting.alarms] == ["waits for start"]
            assert mission.start().accepted
            assert not mission.start().accepted
            until(mission, lambda s: vehicle(s, 1).stage == "flying" and vehicle(s, 1).speed_m_s > 0.1)

            answer = mission.pause(1)
            assert answer.accepted
            assert [(v.vehicle_id, v.text) for v in answer.vehicles] == [(1, "accepted")]
            still = until(mission, lambda s: vehicle(s, 1).speed_m_s == 0.0)
            assert vehicle(still, 1).held
            later = until(mission, lambda s: s.t_s > still.t_s + 20.0)
            assert moved(still, later, 1) < 0.01
            assert vehicle(later, 1).stage == vehicle(still, 1).stage
            assert "waits for you" in {a.name for a in later.alarms}

            assert mission.resume(1).accepted
            going = until(mission, lambda s: moved(later, s, 1) > 0.5)
            assert not vehicle(going, 1).held

            lower, upper = (-3.0, -3.0, 3.0), (3.0, 3.0, 9.0)
            assert mission.mark("important", lower, upper).accepted
            refused = mission.mark("forbidden", *over_the_pad(mission))
            assert "takes off and lands there" in refused.text
            until(mission, lambda s: [r.kind for r in s.regions] == ["important"])

            assert mission.home(2).accepted
            down = until(mission, lambda s: not vehicle(s, 2).flying)
            assert (vehicle(down, 2).stage, vehicle(down, 2).held) == ("parked", True)
            assert mission.resume(2).accepted
            until(mission, lambda s: vehicle(s, 2).flying)

            ended = mission.abort()
            assert ended.accepted
            assert {v.vehicle_id for v in ended.vehicles} == {1, 2}
            assert until(mission, lambda s: s.phase == "over").phase == "over"
            with mission.reading() as model:
                assert model.solid
                assert len(model.pictures) == mission.state.pictures
                assert all(Path(p.file).is_file() for p in model.pictures)
                assert all(len(trail) > 3 for trail in model.trails.values())
        assert flight.wait() == []
    finally:
        flight.stop()
    notes = json.loads((tmp_path / "run" / "flight.json").read_text())["notes"]
    assert any("operator: pause vehicle 1" in n for n in notes)


def over_the_pad(mission: LiveMission) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    with mission.reading() as model:
        assert model.site is not None
        x, y, z = model.site.pads_enu_m[0]
    return (x - 1.0, y - 1.0, z), (x + 1.0, y + 1.0, z + 2.0)
