"""Real flights, watched and not: bit-equal."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ground_station import connect
from tests.live_world import FLEET, flying

pytestmark = [pytest.mark.loopback, pytest.mark.xdist_group("live")]


def test_who_only_watches_changes_nothing(tmp_path: Path) -> None:
    settings = "clock.speed=0.0", "explore.max_views=2", "survey.max_views=3"
    runs = []
    for name, watched in (("watched", True), ("alone", False)):
        (tmp_path / name).mkdir()
        flight, endpoint = flying(tmp_path / name, *settings, live=())
        runs.append((flight, endpoint, watched))
    try:
        for flight, endpoint, watched in runs:
            if watched:
                with connect(endpoint=endpoint, fleet=FLEET) as mission:
                    assert sum(1 for _ in mission.states()) > 2
            assert flight.wait() == []
    finally:
        for flight, _, _ in runs:
            flight.stop()
    with np.load(tmp_path / "watched/run/trajectories.npz") as a, np.load(tmp_path / "alone/run/trajectories.npz") as b:
        assert set(a) == set(b)
        assert all(np.array_equal(a[key], b[key]) for key in a)
