"""Algorithm 1 of the thesis."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from vehicle.battery import Battery, consume

paths = st.integers(1, 30).flatmap(lambda n: arrays(np.float64, (n, 3), elements=st.floats(-1e3, 1e3)))


@given(paths, st.floats(1.0, 100.0), st.floats(0.0, 1.0))
def test_levels_fall_with_distance_and_stop_at_zero(points: np.ndarray, full: float, rate: float) -> None:
    distances, levels = consume(points, full, rate)
    assert len(distances) == len(levels) == len(points)
    assert distances[0] == 0.0
    assert levels[0] == full
    assert np.all(np.diff(distances) >= 0.0)
    assert np.all(np.diff(levels) <= 0.0)
    assert levels.min() >= 0.0
    np.testing.assert_allclose(levels, np.maximum(full - rate * distances, 0.0), atol=1e-9)


@given(paths, st.floats(0.0, 1.0))
def test_the_vehicle_spends_as_the_algorithm_says(points: np.ndarray, rate: float) -> None:
    battery = Battery(100.0, rate)
    for step in np.linalg.norm(np.diff(points, axis=0), axis=1):
        battery.spend(float(step), 1.0)
    assert battery.level_percent == pytest.approx(consume(points, 100.0, rate)[1][-1], abs=1e-6)


def test_the_thesis_example_of_four_points() -> None:
    distances, levels = consume(np.array([[0.0, 0, 0], [3, 4, 0], [3, 4, 12], [3, 4, 200]]), 100.0, 0.5)
    assert distances.tolist() == [0.0, 5.0, 17.0, 205.0]
    assert levels.tolist() == [100.0, 97.5, 91.5, 0.0]


def test_hovering_costs_only_when_asked_for() -> None:
    assert Battery(100.0, 0.1).cost_percent(0.0, 60.0) == 0.0
    assert Battery(100.0, 0.1, 0.05).cost_percent(10.0, 60.0) == pytest.approx(4.0)
