"""Inspection quality on a wall: what a pixel covers, what hides, what blurs, and that a better picture never hurts."""

from __future__ import annotations

import math

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from missions.camera import Camera, Pose
from perception.evaluate.inspection import Asked, Shot, inspect, surface_per_pixel
from perception.evaluate.reachable import Stand, reachable_pictures
from perception.evaluate.reference import Reference

CAMERA = Camera.from_diagonal_fov(1920, 1080, 82.0)
ASKED = Asked(gsd_m=0.005, exposure_s=0.001)


def wall(*screens: trimesh.Trimesh) -> Reference:
    """4 x 4 m at y = 0, looking south, with samples on it alone."""
    sheet = trimesh.Trimesh([[-2, 0, 0], [2, 0, 0], [2, 0, 4], [-2, 0, 4]], [[0, 1, 2], [0, 2, 3]])
    whole = trimesh.util.concatenate([sheet, *screens])
    x, z = np.meshgrid(np.linspace(-1.9, 1.9, 20), np.linspace(0.1, 3.9, 20))
    points = np.stack([x.ravel(), np.zeros(x.size), z.ravel()], axis=1)
    normals = np.tile([0.0, -1.0, 0.0], (len(points), 1))
    return Reference(np.asarray(whole.vertices), np.asarray(whole.faces, dtype=np.int64), points, normals, ("wall",),
                     np.zeros(len(whole.faces), np.int64), np.zeros(len(points), np.int64))


def shot(distance_m: float, east_m: float = 0.0, speed_m_s: float = 0.0) -> Shot:
    pose = Pose((east_m, -distance_m, 2.0), math.pi / 2, 0.0)
    return Shot(CAMERA, pose.enu_from_camera, np.array(pose.position_enu_m), speed_m_s)


@given(st.floats(1.0, 30.0), st.floats(0.0, 1.4))
def test_a_pixel_covers_distance_over_focal_length_and_more_where_it_is_oblique(distance: float, tilt: float) -> None:
    normal = np.array([[math.sin(tilt), 0.0, -math.cos(tilt)]])
    covered = surface_per_pixel(np.array([[0.0, 0.0, distance]]), normal, CAMERA)
    assert covered[0] == pytest.approx(distance / CAMERA.fx_px / math.cos(tilt), rel=1e-9)


def test_from_the_front_at_the_resolution_asked_for_all_is_perfect() -> None:
    found = inspect(wall(), [shot(5.0)], ASKED)
    assert found.quality.min() == 1.0
    assert found.numbers(ASKED) == {"mean_quality": 1.0, "inspected": 1.0, "at_gsd": 1.0, "seen": 1.0, "seen_by_3": 0.0}


def test_from_behind_nothing_is_seen() -> None:
    back = Pose((0.0, 4.0, 2.0), -math.pi / 2, 0.0)
    found = inspect(wall(), [Shot(CAMERA, back.enu_from_camera, np.array(back.position_enu_m), 0.0)], ASKED)
    assert found.pictures.max() == 0
    assert np.isinf(found.gsd_m).all()


def test_what_stands_before_the_wall_hides_its_shadow_on_it() -> None:
    screen = trimesh.creation.box((1.0, 0.1, 1.0)).apply_translation((0.0, -2.0, 2.0))
    reference = wall(screen)
    found = inspect(reference, [shot(5.0)], ASKED)
    shadow = (np.abs(reference.samples_enu_m[:, [0, 2]] - [0.0, 2.0]) < 0.8).all(axis=1)
    assert (found.pictures[shadow] == 0).all()
    open_ = (np.abs(reference.samples_enu_m[:, [0, 2]] - [0.0, 2.0]) > 0.9).any(axis=1)
    assert (found.pictures[open_] == 1).all()


@given(st.lists(st.tuples(st.floats(2.0, 40.0), st.floats(-3.0, 3.0), st.floats(0.0, 12.0)), min_size=1, max_size=4))
def test_another_picture_never_makes_it_worse_and_speed_never_better(taken: list[tuple[float, float, float]]) -> None:
    shots = [shot(*t) for t in taken]
    still = [shot(d, e) for d, e, _ in taken]
    all_, but_last = inspect(wall(), shots, ASKED), inspect(wall(), shots[:-1], ASKED)
    assert (all_.quality >= but_last.quality).all()
    assert (all_.pictures >= but_last.pictures).all()
    assert (inspect(wall(), still, ASKED).quality >= all_.quality).all()


def test_motion_of_two_pixels_halves_the_quality() -> None:
    speed = 2.0 * 5.0 / CAMERA.fx_px / ASKED.exposure_s
    np.testing.assert_allclose(inspect(wall(), [shot(5.0, speed_m_s=speed)], ASKED).quality, 0.5, rtol=1e-6)


PLACES = np.array([[-2.0, -5.0, 2.0], [0.0, -5.0, 2.0], [2.0, -5.0, 2.0], [0.0, 5.0, 2.0], [0.0, -0.5, 2.0],
                   [0.0, -30.0, 2.0]])


def test_within_reach_is_what_enough_places_before_the_wall_see() -> None:
    """Three of the six places count: one is behind the wall, one too near to it and one too far."""
    assert reachable_pictures(wall(), PLACES, Stand(1.0, 12.0), 4).tolist() == [3] * 400
    assert reachable_pictures(wall(), PLACES, Stand(1.0, 12.0), 2).tolist() == [2] * 400
    assert reachable_pictures(wall(), PLACES, Stand(1.0, 40.0), 9).tolist() == [4] * 400
    grazing = reachable_pictures(wall(), PLACES[:1], Stand(1.0, 12.0, 30.0), 1)
    assert 0 < grazing.sum() < 400


def test_a_screen_takes_places_out_of_reach() -> None:
    reference = wall(trimesh.creation.box((1.0, 0.1, 1.0)).apply_translation((0.0, -2.0, 2.0)))
    shadow = (np.abs(reference.samples_enu_m[:, [0, 2]] - [0.0, 2.0]) < 0.8).all(axis=1)
    found = reachable_pictures(reference, PLACES[1:2], Stand(1.0, 12.0), 3)
    assert found[shadow].tolist() == [0] * int(shadow.sum())
    assert found.max() == 1
