"""Rendered photographs say of themselves what a drone's say, as wrongly as they are asked to."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

from ground_station.cli import main as swarmscan
from perception.photographs.metadata import read_metadata
from sim_bridge.render.photograph_set import SITE


def test_pictures_as_a_person_would_bring_them_home(tmp_path: Path) -> None:
    out = tmp_path / "set"
    assert swarmscan(["bench", "photograph-set", "building", str(out), "--pictures", "3", "--size", "320", "240",
                      "--gps-sigma", "0.5", "--altitude-offset", "20"]) == 0
    with out.with_suffix(".csv").open(newline="") as f:
        truth = list(csv.DictReader(f))
    assert [row["picture"] for row in truth] == sorted(p.name for p in out.iterdir())
    for row in truth:
        told = read_metadata(out / row["picture"])
        assert told.latitude_deg is not None
        assert told.longitude_deg is not None
        assert told.altitude_m is not None
        place = SITE.enu_from_geodetic(told.latitude_deg, told.longitude_deg, told.altitude_m)
        true = np.array([float(row[c]) for c in ("east_m", "north_m", "up_m")])
        assert np.linalg.norm(place - true - [0.0, 0.0, 20.0]) < 3.0
        assert told.focal_px == pytest.approx(0.5 * 400 / np.tan(np.radians(37.5)), rel=0.02)
        assert told.gimbal_deg is not None
