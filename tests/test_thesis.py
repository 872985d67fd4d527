"""The thesis's planning experiment: tours, Algorithm 1, the threshold, and who takes over."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from missions.mission_file import MISSIONS_FOLDER, load_mission
from planning.allocate.cost import LegCost
from planning.allocate.thesis_experiment import (
    Discharge,
    Experiment,
    Obstacle,
    experiment,
    forecast,
    percent_per_m_to_stop,
)
from planning.paths.thesis import NO_VIEW
from planning.paths.thesis_boxes import hit_triangles

Floats = NDArray[np.float64]
seeds = st.integers(0, 2**32 - 1)


def row(start: float, count: int, step: float) -> Floats:
    """Views on a line to the East."""
    return np.stack([start + step * np.arange(count), np.zeros(count), np.full(count, 5.0)], axis=1)


def flown(plan: Experiment) -> list[int]:
    return sorted(int(v) for tour in plan.tours.values() for v in tour.flown.view if v != NO_VIEW)


def test_algorithm_1_by_hand() -> None:
    along = forecast(np.array([[0.0, 0, 0], [3, 4, 0], [3, 4, 12], [3, 4, 100]]), Discharge(2.0, start_percent=60.0))
    assert list(along.distance_m) == [0.0, 5.0, 17.0, 105.0]
    assert list(along.level_percent) == [60.0, 50.0, 26.0, 0.0]


def test_a_vehicle_stops_at_the_threshold_and_the_free_one_takes_the_rest() -> None:
    views = np.concatenate([row(0.0, 12, 2.0), row(40.0, 4, 2.0)])
    plan = experiment(views, 2, LegCost(), Discharge(5.0, threshold_percent=20.0))
    busy, free = (plan.tours[k] for k in sorted(plan.tours, key=lambda k: -len(plan.tours[k].own.view)))
    assert list(busy.own.view) == list(range(12))
    assert busy.stop == 8
    assert busy.left == [8, 9, 10, 11]
    assert list(free.flown.view[:4]) == [12, 13, 14, 15]
    assert free.stop is None
    assert plan.left_over == [8, 9, 10, 11]
    richer = experiment(np.concatenate([views[:12], views[12:] - [14.0, 0, 0]]), 2, LegCost(), Discharge(5.0))
    assert sorted(richer.left_over + flown(richer)) == list(range(16))
    assert len(richer.left_over) < 4


def test_the_consumption_that_stops_at_an_index() -> None:
    views = row(0.0, 30, 1.5)
    rate = percent_per_m_to_stop(forecast(views, Discharge(0.0)).distance_m, 21, 19.88)
    (tour,) = experiment(views, 1, LegCost(), Discharge(rate)).tours.values()
    assert tour.stop == 21
    assert tour.forecast.level_percent[21] == pytest.approx(19.88)


@given(seeds, st.integers(1, 40), st.integers(1, 4), st.floats(0.05, 3.0), st.booleans())
@settings(deadline=None, max_examples=60)
def test_every_view_is_flown_once_or_left_over(seed: int, count: int, vehicles: int, rate: float,
                                               from_pads: bool) -> None:
    rng = np.random.default_rng(seed)
    views, pads = rng.uniform(0.0, 30.0, (count, 3)), rng.uniform(0.0, 30.0, (vehicles, 3))
    plan = experiment(views, vehicles, LegCost("distance_elevation"), Discharge(rate), pads if from_pads else None)
    assert sorted(flown(plan) + plan.left_over) == list(range(count))
    for tour in plan.tours.values():
        level = tour.forecast.level_percent
        assert (tour.stop is None) == bool((level > 20.0).all())
        if tour.stop is not None:
            assert level[tour.stop] <= 20.0 < level[tour.stop - 1]
    table = plan.table()
    assert sorted(table["view_id"].tolist()) == flown(plan)
    origin = {int(v): k for k, tour in plan.tours.items() for v in tour.own.view}
    for view, was, now in zip(table["view_id"], table["origin_vehicle"], table["current_vehicle"], strict=True):
        assert was == origin[int(view)]
        assert view in plan.tours[int(now)].flown.view
    owners = dict(zip(plan.owners.view_id.tolist(), plan.owners.current_vehicle.tolist(), strict=True))
    assert all(owners[int(v)] == k for v, k in zip(table["view_id"], table["current_vehicle"], strict=True))


def test_tours_and_what_is_taken_over_are_led_around_the_structure() -> None:
    box = trimesh.creation.box((2.0, 30.0, 12.0))
    triangles = np.asarray(box.triangles) + np.array([0.0, 0.0, 6.0])
    obstacle = Obstacle(triangles, np.array([-30.0, -30.0, 1.0]), np.array([30.0, 30.0, 25.0]))
    rng = np.random.default_rng(3)
    views = np.concatenate([rng.uniform([-8.0, -10.0, 3.0], [-3.0, 10.0, 8.0], (25, 3)),
                            rng.uniform([3.0, -10.0, 3.0], [8.0, 10.0, 8.0], (6, 3))])
    plan = experiment(views, 2, LegCost(), Discharge(0.9), obstacle=obstacle)
    assert any(tour.stop is not None for tour in plan.tours.values())
    assert len(plan.owners.view_id[plan.owners.origin_vehicle != plan.owners.current_vehicle])
    for tour in plan.tours.values():
        assert tour.own.refused == tour.added.refused == {}
        assert not any(len(hit_triangles(a, b, triangles)) for a, b in pairwise(tour.flown.points_enu_m))
    assert sorted(flown(plan) + plan.left_over) == list(range(31))
    assert (plan.table()["view_id"] == NO_VIEW).any()


@pytest.mark.parametrize("name", [p.stem for p in sorted(MISSIONS_FOLDER.glob("thesis_*.toml"))])
def test_the_thesis_missions_load_and_ask_for_its_method(name: str) -> None:
    mission = load_mission(MISSIONS_FOLDER / f"{name}.toml")
    assert mission.survey.method == "thesis"
    assert mission.survey.views == "file"
    assert mission.survey.stop_at_views
    assert mission.knowledge == "mesh"
    assert mission.battery.model == "distance"
    assert mission.battery.threshold_percent == 20.0
    assert mission.fleet.vehicles == 2
    assert mission.fleet.speed_m_s == 1.0
