"""A real flight with too small a battery: home with views left, serviced, out again; the report tells how long."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from ground_station.report.run_data import read_run
from ground_station.report.service import service_numbers
from tests.test_loopback import fly

pytestmark = [pytest.mark.loopback, pytest.mark.xdist_group("loopback")]


def test_a_vehicle_that_returns_with_views_left_is_serviced_and_goes_on(tmp_path: Path) -> None:
    run, complaints = fly(tmp_path, ["fleet.vehicles=1", "explore.max_views=3", "survey.max_views=12",
                                     "battery.percent_per_m=1.6", "battery.swaps=4", "battery.swap_s=45.0"])
    assert complaints == []
    told = json.loads(run.flight.read_text())
    assert set(told["outcomes"].values()) == {"flown"}
    service = service_numbers(read_run(run))
    assert service["swaps"] >= 1
    assert service["vehicles"]["1"] == {"swaps": service["swaps"], "service_s": service["service_s"]}
    assert service["service_s"] == pytest.approx(45.0 * service["swaps"], abs=1.5 * service["swaps"])
    assert sum("gets a fresh battery" in note for note in told["notes"]) == service["swaps"]
    assert told["fleet"]["makespan_s"] > service["service_s"]
