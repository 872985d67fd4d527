"""Fleets where there is room for one only: nobody ever too near, nobody stuck, every reachable view flown."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from missions.frames import Array
from planning.trajectories import Curve
from vehicle.campaign import Campaign, Result, main, run_mission
from vehicle.campaign_referee import judge, track
from vehicle.campaign_world import KINDS, World, bore, make_world, reach_from, world_with
from vehicle.teammates import LOST_TEAMMATE

TUNNEL = partial(bore, a=np.array([18.0, 0.0, 4.0]), b=np.array([18.0, 20.0, 4.0]))
"""A dead end, 3 m wide: nobody passes anybody there."""


def tunnel(vehicles: int, *depths_m: float) -> World:
    """Views in the tunnel, this far from its mouth."""
    return world_with(vehicles, TUNNEL, np.array([(18.0, y, 4.0) for y in depths_m]))


def assert_good(result: Result) -> None:
    """Everything flown, everybody home, nobody ever too near."""
    assert not result.deadlock, result
    assert result.flown == result.views, result
    assert result.verdict.separation_violations == result.verdict.clearance_violations == 0, result
    assert result.verdict.least_separation_m >= 2.5


@pytest.mark.parametrize("kind", sorted(KINDS))
@pytest.mark.parametrize("seed", range(3))
def test_random_missions_end_with_every_view_flown_and_nobody_too_near(kind: str, seed: int) -> None:
    assert_good(run_mission(seed, 2, 3, kind))


def test_two_meet_face_to_face_in_a_tunnel() -> None:
    assert_good(Campaign(tunnel(2, 18.0, 6.0, 12.0, 1.0, 16.0), {1: [0, 3, 2], 2: [1, 4]}).fly())


def test_three_in_a_dead_end() -> None:
    assert_good(Campaign(tunnel(3, 18.0, 14.0, 10.0, 6.0, 2.0, 16.0), {1: [4, 0], 2: [2, 5], 3: [3, 1]}).fly())


def test_who_has_nothing_to_do_makes_way() -> None:
    assert_good(Campaign(tunnel(2, 3.0, 18.0), {1: [0], 2: [1]}).fly())


def test_sixteen_in_a_courtyard_with_one_door() -> None:
    yard = make_world(7, 16, 16, "courtyard")
    assert_good(Campaign(replace(yard, views_enu_m=yard.views_enu_m[:16])).fly())


def test_behind_a_dead_vehicle_views_are_given_back_and_all_others_are_flown() -> None:
    campaign = Campaign(tunnel(3, 8.0, 17.0, 3.0), {1: [0], 2: [], 3: []})
    campaign.fly(until=lambda: campaign.flown == {0})
    campaign.kill(1)
    campaign._send(2, [1, 2], True)
    result = campaign.fly()
    assert campaign.flown == {0, 2}
    assert not result.deadlock
    assert result.verdict.separation_violations == 0
    assert all(f"view 1 blocked (no way there past {LOST_TEAMMATE})" in text for text in result.given_back)


def test_a_mission_is_repeated_exactly() -> None:
    first, again = (Campaign(make_world(3, 4, 4, "tunnels")) for _ in range(2))
    first.fly()
    again.fly()
    assert first.times == again.times
    for k, curves in first.curves.items():
        times = np.array(first.times)
        assert np.array_equal(track(curves, times), track(again.curves[k], times))


def test_views_of_a_world_are_reachable_and_worlds_repeat() -> None:
    for kind in KINDS:
        world, same = make_world(5, 2, 16, kind), make_world(5, 2, 16, kind)
        assert np.array_equal(world.views_enu_m, same.views_enu_m)
        assert np.array_equal(world.grid.state, same.grid.state)
        assert np.isfinite(reach_from(world, np.array([18.0, -3.0, 10.5])).distance_to(world.views_enu_m)).all()


class TestReferee:
    """It sees what samples hide."""

    def judged(self, a: Array, b: Array) -> tuple[int, int]:
        world = tunnel(2, 5.0)
        times = np.arange(len(a)) * 100_000_000
        verdict = judge(np.stack([a, b]), np.ones((2, len(a)), dtype=np.bool_), times, world.grid, 2.5, 1.0, 2.0)
        return verdict.separation_violations, verdict.clearance_violations

    def test_two_that_are_near_only_between_samples(self) -> None:
        a = np.array([[0.0, -6.0, 9.0], [6.0, -6.0, 9.0]])
        b = np.array([[3.0, -7.5, 9.0], [3.0, -7.5, 9.0]])
        assert np.linalg.norm(a - b, axis=1).min() > 2.5
        assert self.judged(a, b) == (1, 0)

    def test_a_wall_between_two_samples(self) -> None:
        a = np.array([[18.0, -3.0, 8.0], [18.0, 27.0, 8.0]])
        assert self.judged(a, a + np.array([0.0, 0.0, 4.0])) == (0, 1)

    def test_a_body_follows_each_curve_until_the_next(self) -> None:
        here, there = np.zeros(3), np.array([1.0, 2.0, 3.0])
        curves = [(0, Curve.hold(here, 1.0)), (500_000_000, Curve.hold(there, 1.0))]
        assert np.array_equal(track(curves, np.array([0, 400_000_000, 500_000_000])), [here, here, there])


def test_the_command_prints_its_numbers(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--missions", "2", "--vehicles", "2", "2", "--json"]) == 0
    assert '"separation_violations": 0' in capsys.readouterr().out
