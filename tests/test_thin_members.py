"""Wires, from drawn pictures: ridges to a fraction of a pixel, and lines in space that several pictures agree on."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from missions.camera import Camera, Pose
from missions.frames import Array
from perception.reconstruct.cloud import Cloud
from perception.reconstruct.open_sky import sky_votes
from perception.reconstruct.pictures import SurveyPicture
from perception.reconstruct.pipeline import with_thin_members
from perception.reconstruct.settings import Region, Settings
from perception.wires.mutual import drawn_together
from perception.wires.ridges import ridges
from perception.wires.stage import thin_members

CAMERA = Camera.from_diagonal_fov(640, 360, 84.0)
SUBPIXEL = 4
HALF_M, SAG_M, HEIGHT_M = 6.0, 0.5, 8.0
REGION = Region(np.array([-5.0, -2.0, 5.0]), np.array([5.0, 2.0, 11.0]))
SETTINGS = Settings(threads=1, distance_m=8.0)


def sagging(north_m: float, n: int = 200) -> Array:
    """A wire along x."""
    x = np.linspace(-HALF_M, HALF_M, n)
    return np.column_stack([x, np.full(n, north_m), HEIGHT_M - SAG_M * (1.0 - (x / HALF_M) ** 2)])


def drawn(wires: list[Array], camera: Camera, pose: Pose, seed: int) -> np.ndarray:
    """Dark lines 1.5 pixels wide before a sky with noise, drawn four times as large and averaged."""
    canvas = np.full((SUBPIXEL * camera.height_px, SUBPIXEL * camera.width_px, 3), (225, 170, 120), np.uint8)
    for wire in wires:
        local = (wire - pose.position_enu_m) @ pose.enu_from_camera
        local = local[local[:, 2] > 0.5]
        pixel = local[:, :2] / local[:, 2:] * [camera.fx_px, camera.fy_px] + [camera.cx_px, camera.cy_px]
        line = np.rint((pixel * SUBPIXEL - 0.5) * 16).astype(np.int32)
        cv2.polylines(canvas, [line.reshape(-1, 1, 2)], False, (70, 70, 70), 6, cv2.LINE_AA, 4)
    small = cv2.resize(canvas, (camera.width_px, camera.height_px), interpolation=cv2.INTER_AREA)
    noise = np.random.default_rng(seed).normal(0.0, 1.0, small.shape)
    return np.clip(np.rint(small + noise), 0, 255).astype(np.uint8)


def taken(folder: Path, wires: list[Array], east_m: list[float]) -> list[SurveyPicture]:
    """Pictures of the wires from below and beside, at two heights, looking north and up."""
    pictures = []
    for k, x in enumerate(east_m):
        pose = Pose((x, -7.0 - (k % 2), 3.0 + 3.5 * (k % 3)), np.pi / 2, np.radians((20.0, 12.0, 5.0)[k % 3]))
        path = folder / f"{k}.png"
        cv2.imwrite(str(path), drawn(wires, CAMERA, pose, k))
        pictures.append(SurveyPicture(k, path, CAMERA, pose.enu_from_camera, np.array(pose.position_enu_m)))
    return pictures


PLACES = [-4.0, -2.5, -1.0, 0.5, 2.0, 3.5, 5.0, -3.2, -0.3]


@pytest.fixture(scope="module")
def pictures(tmp_path_factory: pytest.TempPathFactory) -> list[SurveyPicture]:
    return taken(tmp_path_factory.mktemp("wires"), [sagging(0.0), sagging(1.2)], PLACES)


@pytest.fixture(scope="module")
def found(pictures: list[SurveyPicture]) -> Cloud:
    return thin_members(pictures, REGION, SETTINGS, lambda stage, done, total: None)


def aside(points: np.ndarray, north_m: float) -> Array:
    """Distance of points from a wire."""
    wire = sagging(north_m, 4000)
    return np.linalg.norm(points[:, None, :] - wire[None], axis=2).min(axis=1)


@given(st.floats(-1.2, 1.2), st.floats(-40.0, 40.0), st.booleans())
@settings(max_examples=15, deadline=None)
def test_a_ridge_is_where_the_line_is_to_a_quarter_of_a_pixel(slope: float, offset_px: float, dark: bool) -> None:
    v, u = np.mgrid[0:120, 0:160] + 0.5
    normal = np.array([-slope, 1.0]) / np.hypot(slope, 1.0)
    away = (u - 80.0) * normal[0] + (v - 60.0) * normal[1] - offset_px / 4.0
    ink = (-60.0 if dark else 60.0) * np.exp(-0.5 * (away / 0.8) ** 2)
    seen = ridges(np.rint(128.0 + ink).astype(np.uint8))
    assert len(seen) > 20
    off = (seen.place_px - [80.0, 60.0]) @ normal - offset_px / 4.0
    assert np.abs(off).max() < 0.25
    assert np.abs(seen.direction @ normal).max() < 0.05


def test_edges_and_noise_are_no_lines() -> None:
    edge = np.full((120, 160), 60, np.uint8)
    edge[:, 80:] = 200
    assert not len(ridges(edge))
    assert len(ridges(np.random.default_rng(0).normal(128.0, 6.0, (360, 640)).astype(np.uint8))) < 60


def test_two_wires_are_found_where_they_are_and_nothing_else(found: Cloud) -> None:
    nearest = np.minimum(aside(found.points_enu_m, 0.0), aside(found.points_enu_m, 1.2))
    assert np.mean(nearest) < 0.01
    assert nearest.max() < 0.05
    assert found.confidence.min() >= 5
    np.testing.assert_allclose(np.linalg.norm(found.normals, axis=1), 1.0, atol=1e-5)


@pytest.mark.parametrize("north_m", [0.0, 1.2])
def test_each_wire_is_whole_between_the_ends_that_enough_pictures_show(found: Cloud, north_m: float) -> None:
    wire = sagging(north_m, 400)
    wire = wire[np.abs(wire[:, 0]) < 2.5]
    gap = np.linalg.norm(wire[:, None, :] - found.points_enu_m[None], axis=2).min(axis=1)
    assert np.mean(gap < 0.1) > 0.97


def test_the_same_whatever_the_number_of_threads(pictures: list[SurveyPicture], found: Cloud) -> None:
    again = thin_members(pictures, REGION, Settings(threads=3, distance_m=8.0), lambda stage, done, total: None)
    for name in ("points_enu_m", "colours", "normals", "confidence"):
        np.testing.assert_array_equal(getattr(again, name), getattr(found, name))


def test_lines_that_three_pictures_have_are_not_enough(pictures: list[SurveyPicture]) -> None:
    assert not len(thin_members(pictures[:3], REGION, SETTINGS, lambda stage, done, total: None))


def test_what_has_sky_in_its_place_is_dropped_and_the_wire_stays(pictures: list[SurveyPicture]) -> None:
    on_wire, before_sky = sagging(0.0, 120)[40:80], np.column_stack([np.linspace(-1, 1, 40), np.zeros((40, 2))])
    before_sky[:, 2] = 9.5
    points = np.concatenate([on_wire, before_sky]).astype(np.float32)
    n = len(points)
    cloud = Cloud(points, np.zeros((n, 3), np.uint8), np.zeros((n, 3), np.float32), np.full(n, 3, np.uint8))
    votes = sky_votes(points.astype(np.float64), pictures, 40.0, 1, lambda stage, done, total: None)
    assert not votes[:40].any()
    assert (votes[40:] >= 3).all()
    whole = with_thin_members(cloud, pictures, REGION, SETTINGS)
    assert len(whole) > 100
    assert not np.any(whole.points_enu_m[:, 2] > 9.0)


def test_pictures_that_found_the_same_line_are_counted_once_each() -> None:
    places = np.array([[0.0, 0.0, 0.0], [0.1, 0.01, 0.0], [0.2, -0.01, 0.0], [0.1, 0.2, 0.0], [0.1, 0.0, 0.0]])
    lines = np.array([[1.0, 0, 0], [-1.0, 0, 0], [1.0, 0, 0], [1.0, 0, 0], [0, 1.0, 0]])
    count, place, line = drawn_together(places, lines, np.array([0, 1, 1, 2, 3]))
    assert count.tolist() == [2, 2, 2, 1, 1], "two pictures; one beside; one across"
    np.testing.assert_allclose(place[:3, 1:], 0.0, atol=1e-9)
    np.testing.assert_allclose(np.abs(line[:3, 0]), 1.0)


def test_what_is_found_in_a_region_does_not_depend_on_where_it_ends(tmp_path: Path) -> None:
    """Pictures on a lattice before lines a quarter of its step apart, just below the region: one line further in each,
    they all agree on a place within."""
    rows = [np.array([[-HALF_M, y, 4.8], [HALF_M, y, 4.8]]) for y in np.arange(-2.5, 2.6, 0.5)]
    pictures = []
    for k, (x, y) in enumerate((x, y) for x in (-1.0, 0.0, 1.0) for y in np.arange(-4.0, 4.1, 2.0)):
        pose = Pose((x, float(y), 12.0), np.pi / 2, np.radians(-80.0))
        path = tmp_path / f"{k}.png"
        cv2.imwrite(str(path), drawn(rows, CAMERA, pose, k))
        pictures.append(SurveyPicture(k, path, CAMERA, pose.enu_from_camera, np.array(pose.position_enu_m)))
    deeper = Region(REGION.lower_enu_m - [0.0, 0.0, 0.5], REGION.upper_enu_m)
    alone, within = (thin_members(pictures, region, SETTINGS, lambda stage, done, total: None)
                     for region in (REGION, deeper))
    above = int(REGION.contains(within.points_enu_m).sum())
    assert above < 0.8 * len(within), "most of the lines are seen where they are"
    assert abs(len(alone) - above) <= 0.05 * above
