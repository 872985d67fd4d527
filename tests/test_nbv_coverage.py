"""Coverage without truth, and when exploring no longer pays."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ground_station.bench.coverage import main as coverage_bench
from missions.camera import Camera, Pose
from missions.errors import UserError
from missions.grid import FREE, OCCUPIED, UNKNOWN, VoxelGrid
from planning.nbv.coverage import MISSING_WEIGHT, face_chances, surface_tally, visible_faces
from planning.nbv.sights import ImaginedMap
from planning.nbv.stopping import LEAST_LEG_M, LEAST_TRUST, MOST_TRUST, RECENT, Price, Returns, pays

SHAPE, RANGE_M = (16, 16, 16), 20.0
BLOCK = (slice(6, 10),) * 3
"""4 x 4 x 4 solid voxels in the middle: 96 faces."""
AROUND = np.array([[1.5, 8.0, 8.0], [14.5, 8.0, 8.0], [8.0, 1.5, 8.0], [8.0, 14.5, 8.0], [8.0, 8.0, 1.5],
                   [8.0, 8.0, 14.5]])
CAMERA = Camera.from_diagonal_fov(120, 90, 100.0)
EVERYTHING = (slice(0, 16),) * 3


def block(chance: float = 1.0) -> ImaginedMap:
    occupancy = np.zeros(SHAPE, dtype=np.float32)
    occupancy[BLOCK] = chance
    return ImaginedMap.new(np.zeros(3), 1.0, occupancy, EVERYTHING)


def test_before_any_picture_nothing_is_covered_and_after_all_sides_everything_is() -> None:
    imagined = block()
    assert surface_tally(imagined, EVERYTHING, AROUND, RANGE_M).coverage == 0.0
    for position, yaw, elevation in zip(AROUND, (0, 180, 90, -90, 0, 0), (0, 0, 0, 0, 90, -90), strict=True):
        x, y, z = position
        imagined.show(Pose((x, y, z), math.radians(yaw), math.radians(elevation)), CAMERA, RANGE_M)
    tally = surface_tally(imagined, EVERYTHING, AROUND, RANGE_M)
    assert tally.seen_m2 == 96.0
    assert tally.coverage == 1.0


def test_each_side_that_is_shown_adds_a_sixth() -> None:
    imagined = block()
    imagined.show(Pose((1.5, 8.0, 8.0), 0.0, 0.0), CAMERA, RANGE_M)
    tally = surface_tally(imagined, EVERYTHING, AROUND, RANGE_M)
    assert tally.seen_m2 == 16.0
    assert tally.missing_m2 == pytest.approx(MISSING_WEIGHT * 80.0)


def test_what_no_position_can_see_is_not_missing() -> None:
    imagined = block()
    imagined.show(Pose((1.5, 8.0, 8.0), 0.0, 0.0), CAMERA, RANGE_M)
    assert surface_tally(imagined, EVERYTHING, AROUND[:1], RANGE_M).coverage == 1.0
    assert surface_tally(imagined, EVERYTHING, AROUND[:1], 2.0).coverage == 1.0
    inside_the_block = np.array([[8.0, 8.0, 8.0]])
    assert not visible_faces(imagined, inside_the_block, RANGE_M).any()


def test_the_imagined_counts_by_its_chance() -> None:
    likely, unlikely = (surface_tally(block(chance), EVERYTHING, AROUND, RANGE_M).missing_m2 for chance in (0.9, 0.1))
    assert 0.0 < unlikely < likely
    assert surface_tally(block(0.9), EVERYTHING, AROUND, RANGE_M).seen_m2 == 0.0


@given(st.integers(0, 2**16))
def test_expected_faces_are_those_that_drawn_voxels_have(seed: int) -> None:
    rng = np.random.default_rng(seed)
    solid = (rng.random((4, 3, 5)) < 0.5).astype(np.float32)
    across = sum(float(np.abs(np.diff(np.pad(solid, 1), axis=axis)).sum()) for axis in range(3))
    assert sum(float(chance.sum()) for chance in face_chances(solid)) == across


def test_equal_maps_give_equal_tallies_also_from_many_positions() -> None:
    many = np.random.default_rng(1).uniform(0.5, 15.5, (900, 3))
    first, second = (surface_tally(block(0.6), EVERYTHING, many, RANGE_M) for _ in range(2))
    assert first == second


def test_the_box_alone_counts() -> None:
    imagined = block()
    imagined.show(Pose((1.5, 8.0, 8.0), 0.0, 0.0), CAMERA, RANGE_M)
    lower_half = (slice(0, 16), slice(0, 16), slice(0, 8))
    assert surface_tally(imagined, lower_half, AROUND, RANGE_M).seen_m2 == 8.0


def explored(promised_m2: float, shown_m2: float, views: int = RECENT, leg_m: float = 4.0) -> Returns:
    returns = Returns()
    for n in range(views):
        returns.promise(promised_m2, leg_m)
        returns.settle((n + 1) * shown_m2)
    return returns


def test_before_any_view_promises_are_trusted_and_any_way_pays() -> None:
    assert Returns().trust == 1.0
    assert pays(0.01, Returns(), 0.0, Price())


def test_trust_follows_the_last_views_only() -> None:
    returns = explored(10.0, 1.0, views=50)
    for n in range(RECENT):
        returns.promise(10.0, 1.0)
        returns.settle(50.0 + 10.0 * (n + 1))
    assert returns.trust == pytest.approx(1.0)


@given(st.floats(0.1, 100.0), st.floats(-10.0, 1000.0))
def test_trust_keeps_within_bounds(promised_m2: float, shown_m2: float) -> None:
    assert LEAST_TRUST <= explored(promised_m2, shown_m2).trust <= MOST_TRUST


def test_a_way_is_worth_its_best_beginning() -> None:
    returns = explored(10.0, 5.0)
    assert returns.expected_m2_per_m([8.0, 0.0], [4.0, 100.0]) == pytest.approx(0.5 * 2.0)
    assert returns.expected_m2_per_m([0.0, 50.0], [10.0, 10.0]) == pytest.approx(0.5 * 2.5)
    assert returns.expected_m2_per_m([1.0], [0.0]) == pytest.approx(0.5 / LEAST_LEG_M)


def test_a_price_decides_alone() -> None:
    returns = explored(1.0, 1.0)
    assert pays(0.5, returns, 0.99, Price(m2_per_m=0.5))
    assert not pays(0.49, returns, 0.1, Price(m2_per_m=0.5))
    assert pays(0.0, returns, 1.0, Price(m2_per_m=0.0))


def test_without_a_price_a_share_of_the_mean_is_asked_once_little_is_missing() -> None:
    returns, price = explored(8.0, 8.0), Price(share=0.1, missing=0.05)
    assert returns.mean_m2_per_m == pytest.approx(2.0)
    assert pays(0.01, returns, 0.94, price)
    assert not pays(0.19, returns, 0.96, price)
    assert pays(0.21, returns, 0.96, price)


def test_the_seen_are_the_occupied() -> None:
    grid = VoxelGrid(np.zeros(3), 1.0, np.full(SHAPE, FREE, dtype=np.uint8))
    grid.state[BLOCK] = OCCUPIED
    grid.state[:, :, 0] = UNKNOWN
    occupancy = np.select([grid.state == OCCUPIED, grid.state == UNKNOWN], [1.0, 0.5], 0.0).astype(np.float32)
    imagined = ImaginedMap.new(np.zeros(3), 1.0, occupancy, EVERYTHING)
    imagined.show(Pose((8.0, 8.0, 14.5), 0.0, -math.pi / 2), CAMERA, RANGE_M)
    assert surface_tally(imagined, EVERYTHING, AROUND, RANGE_M).seen_m2 == 16.0


def run(ceiling: float, weight: float, scene: str = "tower") -> dict[str, object]:
    """A run whose estimates are off as if MISSING_WEIGHT should have been this much larger."""
    shares = np.linspace(0.1, 0.95, 21)
    estimates = 1.0 / (1.0 + (1.0 / shares[:20] - 1.0) / weight)
    return {"scene": scene, "method": "swarmscan", "start": 0, "vehicles": 1, "ceiling": ceiling, "stopped_at": 11,
            "curve": (ceiling * shares).tolist(), "curve_metres": np.linspace(0.0, 40.0, 21).tolist(),
            "estimates": estimates.tolist(), "auc": 0.5}


def test_the_bench_judges_estimates_and_stops_and_finds_the_weight(tmp_path: Path,
                                                                   capsys: pytest.CaptureFixture[str]) -> None:
    rows = [run(0.8, 0.7), run(1.0, 0.7, "arch"), {**run(1.0, 0.7), "vehicles": 2}]
    (tmp_path / "rows.json").write_text(json.dumps({"rows": rows}))
    assert coverage_bench([str(tmp_path / "rows.json"), "--fit", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert [r["scene"] for r in document["runs"]] == ["tower", "arch"]
    assert document["missing_weight"] == pytest.approx(0.7 * MISSING_WEIGHT, rel=1e-3)
    tower = document["runs"][0]
    assert tower["error"] == pytest.approx(tower["estimate"] - tower["of_ceiling"])
    assert tower["of_all"] == pytest.approx(0.8 * tower["of_ceiling"])
    assert (tower["given_up"], tower["saved"]) == (pytest.approx(0.425), pytest.approx(0.5))
    assert document["worst"] == pytest.approx(max(abs(r["error"]) for r in document["runs"]))


def test_the_bench_refuses_what_is_no_such_file(tmp_path: Path) -> None:
    (tmp_path / "rows.json").write_text("{}")
    with pytest.raises(UserError, match=r"rows\.json: not what"):
        coverage_bench([str(tmp_path / "rows.json")])
    (tmp_path / "rows.json").write_text('{"rows": []}')
    with pytest.raises(UserError, match="no run of one vehicle"):
        coverage_bench([str(tmp_path / "rows.json")])
