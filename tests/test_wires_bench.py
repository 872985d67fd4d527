"""The benchmark of wires: its truth is where the wires are, and what it prints says whether pictures are right."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ground_station.bench.wires import Looks, fit, main, row
from missions.errors import UserError
from missions.mission import SiteSpec
from missions.simulation import SceneSpec
from perception.mapping.line_votes import BOTH, LINE, MOST, NONE, PLAINLY, log_odds
from sim_bridge.scenes.load import load_scene
from sim_bridge.scenes.scene import merged
from sim_bridge.truth import BEFORE_FLIGHT_NS, Truth
from sim_bridge.wire_points import ASIDE_M, EMPTY_M, WIRE_PARTS, empty_points, wire_points


def looks(rng: np.random.Generator, n: int = 40_000) -> Looks:
    """Lines of which the constants say rightly how likely each is one of a wire."""
    line = rng.uniform(0.0, 6.0, n).astype(np.float32)
    plainly = rng.uniform(0.2, 1.0, n).astype(np.float32)
    wire = rng.random(n) < 1.0 / (1.0 + np.exp(-(NONE + LINE * line + PLAINLY * plainly + BOTH * line * plainly)))
    return Looks(rng.uniform(4.0, 60.0, n), line, plainly, wire)


def test_pictures_that_are_right_are_said_to_be_and_others_not() -> None:
    good = looks(np.random.default_rng(1))
    right, middle = row(good, 4.0, 60.0), [-2.4, -1.6, -0.9, -0.3, 0.3, 0.9, 1.6, 2.4]
    shift = np.log(good.wire.mean() / (1.0 - good.wire.mean()))
    np.testing.assert_allclose(np.array(right.should_have_said) + shift, middle, atol=0.35)
    wrong = row(replace(good, wire=np.random.default_rng(2).permutation(good.wire)), 4.0, 60.0)
    np.testing.assert_allclose(wrong.should_have_said, 0.0, atol=0.15)
    assert right.told_apart > 0.8
    assert wrong.told_apart == pytest.approx(0.5, abs=0.02)


def test_fitting_finds_the_constants_that_drew_the_lines() -> None:
    drawn = looks(np.random.default_rng(3), 200_000)
    half = np.concatenate([np.flatnonzero(drawn.wire), np.flatnonzero(~drawn.wire)])
    found = fit(Looks(*(getattr(drawn, name)[half] for name in Looks.__dataclass_fields__)))
    assert found["LINE"] == pytest.approx(LINE, abs=0.1)
    assert found["BOTH"] == pytest.approx(BOTH, abs=0.15)
    assert found["PLAINLY"] == pytest.approx(PLAINLY, abs=0.4)


def test_no_picture_says_more_than_the_most() -> None:
    line, plainly = (a.ravel() for a in np.meshgrid(np.linspace(0, 7, 50), np.linspace(0, 1, 20)))
    said = log_odds(line.astype(np.float32), plainly.astype(np.float32))
    assert np.abs(said).max() == MOST
    assert (np.diff(said.reshape(20, 50), axis=1) >= 0.0).all(), "a stronger line never speaks against a wire"


def test_the_truth_is_on_wires_and_where_nothing_is() -> None:
    scene, rng = load_scene(SceneSpec(name="family:h_frame_line:1"), SiteSpec()), np.random.default_rng(1)
    cables, world = Truth(*merged(p for p in scene.parts if p.name in WIRE_PARTS)), Truth(*scene.mesh())
    on, empty = wire_points(scene, rng), empty_points(scene, world, rng)
    assert min(len(on), len(empty)) > 500
    assert (cables.distance(on, np.full(len(on), BEFORE_FLIGHT_NS)) <= np.sqrt(3.0) * ASIDE_M + 1e-6).all()
    assert (world.distance(empty, np.full(len(empty), BEFORE_FLIGHT_NS)) > EMPTY_M).all()


def test_the_command_tells_wires_from_nothing_in_pictures(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    walk = ["--walks", "1", "--moves", "2", "--data", str(tmp_path), "--json"]
    assert main(["--scenes", "family:lattice_line:1", *walk]) == 0
    rows = [r for r in json.loads(capsys.readouterr().out) if min(r["on_wires"], r["on_nothing"]) > 50]
    assert rows
    for r in rows:
        assert r["told_apart"] > 0.75
        assert r["said_of_nothing"] < min(0.0, r["said_of_wires"])
    assert max(r["said_of_wires"] for r in rows) > 2.0
    with pytest.raises(UserError, match="--scenes: none of them has wires"):
        main(["--scenes", "family:bust:1", *walk])
