"""Pairs of photographs judged through the lens that a first model tells."""

from __future__ import annotations

from itertools import combinations
from pathlib import Path

import numpy as np
import pycolmap
import pytest

from missions.frames import enu_from_camera
from perception.photographs.confirmed import leave_out_unconfirmed
from perception.photographs.known_lens import KnownLens, judge_again
from perception.photographs.mapping import map_matched
from perception.photographs.metadata import Metadata
from perception.photographs.photograph import Photograph
from perception.reconstruct.features import Features
from perception.reconstruct.matching import ByPair

pytestmark = pytest.mark.xdist_group("photographs")

WIDTH, HEIGHT, FOCAL = 1024, 768, 800.0
POINTS, PICTURES = 200, 10
SHEAR = 0.5
STRAY = PICTURES
"""Number of the picture whose features fit the others' epipolar lines, but no pose through their lens."""


def lens() -> pycolmap.Camera:
    return pycolmap.Camera(camera_id=1, model="OPENCV", width=WIDTH, height=HEIGHT,
                           params=[FOCAL, FOCAL, WIDTH / 2, HEIGHT / 2, -0.05, 0.0, 0.0, 0.0])


def stands(k: int) -> np.ndarray:
    """(3,) the pictures go along a wall in the plane y = 0, some 20 m away."""
    return np.array([1.5 * (k % 5) - 3.0, -20.0 - 2.0 * (k % 3), 2.5 * (k // 5)])


def seen() -> list[Features]:
    """All points in order, to a fifth of a pixel."""
    rng = np.random.default_rng(1)
    points = np.column_stack([rng.uniform(-7, 7, POINTS), rng.uniform(-6, 0, POINTS), rng.uniform(-4, 6, POINTS)])
    found = []
    for k in range(PICTURES + 1):
        local = (points - stands(k)) @ enu_from_camera(np.pi / 2.0, 0.0)
        at = lens().img_from_cam(local) + rng.normal(0.0, 0.2, (POINTS, 2))
        if k == STRAY:
            at = at @ np.array([[1.0, 0.0], [SHEAR, 1.0]]) - [SHEAR * HEIGHT / 2, 0.0]
        found.append(Features(at.astype(np.float32), np.zeros((POINTS, 128), np.uint8), np.ones(POINTS, np.float32)))
    return found


def matches() -> ByPair:
    every = np.column_stack([np.arange(POINTS)] * 2).astype(np.uint32)
    return {pair: every[::5] if STRAY in pair else every for pair in combinations(range(PICTURES + 1), 2)
            if pair[1] - pair[0] < 4}


def photographs() -> list[Photograph]:
    return [Photograph(f"{k}.jpg", Path("none.jpg"), "", Metadata(WIDTH, HEIGHT, focal_px=FOCAL), None)
            for k in range(PICTURES + 1)]


@pytest.fixture(scope="module")
def mapped(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("sparse")
    map_matched(photographs(), seen(), matches(), folder, "incremental", 1, lambda *_: None)
    return folder


def test_a_picture_that_fits_the_lens_of_the_others_nowhere_stays_apart(mapped: Path) -> None:
    """Without its pairs being judged again it is in the model."""
    model = pycolmap.Reconstruction(mapped / "model-000")
    assert sorted(model.reg_image_ids()) == list(range(1, PICTURES + 1))


@pytest.mark.parametrize(("near_px", "believed"), [(1.5, True), (0.1, False)])
def test_a_lens_is_believed_that_the_strong_pairs_bear_out(near_px: float, believed: bool, mapped: Path) -> None:
    """Otherwise all stays as it was."""
    database = mapped / "database.db"
    before = verified(database)
    assert judge_again(database, KnownLens({1: lens()}, near_px), 1) == believed
    assert verified(database).keys() == before.keys()
    assert believed or verified(database) == before


def test_a_picture_that_its_pairs_deny_is_left_out(mapped: Path) -> None:
    model, moved = pycolmap.Reconstruction(mapped / "model-000"), 4
    assert leave_out_unconfirmed(model, mapped / "database.db", 1.5) == []
    pose = model.image(moved).cam_from_world()
    model.frame(model.image(moved).frame_id).rig_from_world = pycolmap.Rigid3d(
        pose.rotation, pose.translation + np.array([0.2, 0.2, 0.0]))
    assert leave_out_unconfirmed(model, mapped / "database.db", 1.5) == [moved]
    assert model.num_reg_images() == PICTURES - 1


def verified(database: Path) -> dict[int, int]:
    with pycolmap.Database.open(database) as kept:
        return dict(zip(*kept.read_two_view_geometry_num_inliers(), strict=True))
