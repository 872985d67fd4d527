"""A wire above grass that is seen at a low angle: its texture is full of lines that run the same way."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from missions.camera import Camera, Pose
from missions.frames import Array
from perception.reconstruct.cloud import Cloud
from perception.reconstruct.pictures import SurveyPicture
from perception.reconstruct.settings import Region, Settings
from perception.wires.crowds import alone
from perception.wires.lookup import sorted_lines
from perception.wires.ridges import ridges
from perception.wires.stage import thin_members

CAMERA = Camera.from_diagonal_fov(960, 540, 84.0)
TILE_M, TILE_PX = 10.0, 1024
FINEST_CYCLES = 25
"""Per tile: blades of 40 cm, which are lines in a picture where they are foreshortened."""
WIRE_M = np.column_stack([np.linspace(-8.0, 8.0, 200), np.zeros(200), np.full(200, 4.0)])
REGION = Region(np.array([-6.0, -4.0, 0.5]), np.array([6.0, 4.0, 8.0]))
STANDS = ((-9.0, 3.2, 90.0, -3.0), (-8.0, 5.0, 90.0, -10.0), (9.0, 3.2, -90.0, -3.0), (8.0, 5.0, -90.0, -10.0))
"""North, up, yaw and pitch, from each of several places along the wire."""


def meadow() -> NDArray[np.float32]:
    """A tile of grass, (TILE_PX, TILE_PX): noise without the finest detail, over and over."""
    cycles = np.hypot(np.fft.fftfreq(TILE_PX)[:, None], np.fft.rfftfreq(TILE_PX)[None]) * TILE_PX
    spectrum = np.fft.rfft2(np.random.default_rng(0).standard_normal((TILE_PX, TILE_PX)))
    spectrum *= np.where((cycles >= 6) & (cycles < FINEST_CYCLES), np.maximum(cycles, 1.0) ** -0.6, 0.0)
    tile = np.fft.irfft2(spectrum, s=(TILE_PX, TILE_PX))
    return np.asarray((128.0 + 60.0 * tile / tile.std()).clip(0, 255), np.float32)


def drawn(tile: NDArray[np.float32], pose: Pose, seed: int) -> NDArray[np.uint8]:
    """The wire before the meadow and a bright sky, twice as large and averaged, with noise."""
    camera = CAMERA.scaled(2 * CAMERA.width_px, 2 * CAMERA.height_px)
    u, v = np.meshgrid(np.arange(camera.width_px) + 0.5, np.arange(camera.height_px) + 0.5)
    rays = np.stack([(u - camera.cx_px) / camera.fx_px, (v - camera.cy_px) / camera.fy_px, np.ones_like(u)], axis=-1)
    rays = rays @ pose.enu_from_camera.T
    fall = np.maximum(-rays[..., 2], 0.02)
    place = np.asarray(pose.position_enu_m)[:2] + (pose.position_enu_m[2] / fall)[..., None] * rays[..., :2]
    at = (place % TILE_M * (TILE_PX / TILE_M)).astype(np.float32)
    grass = cv2.remap(tile, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
    canvas = np.where(rays[..., 2] < -0.02, grass, 225.0).astype(np.uint8)
    local = (WIRE_M - pose.position_enu_m) @ pose.enu_from_camera
    local = local[local[:, 2] > 0.5]
    pixel = local[:, :2] / local[:, 2:] * [camera.fx_px, camera.fy_px] + [camera.cx_px, camera.cy_px]
    line = np.rint((pixel - 0.5) * 16).astype(np.int32).reshape(-1, 1, 2)
    cv2.polylines(canvas, [line], False, 20.0, 4, cv2.LINE_AA, 4)
    small = cv2.resize(canvas, (CAMERA.width_px, CAMERA.height_px), interpolation=cv2.INTER_AREA)
    noise = np.random.default_rng(seed).normal(0.0, 1.0, small.shape)
    return np.clip(np.rint(small + noise), 0, 255).astype(np.uint8)


@pytest.fixture(scope="module")
def pictures(tmp_path_factory: pytest.TempPathFactory) -> list[SurveyPicture]:
    folder, tile, taken = tmp_path_factory.mktemp("meadow"), meadow(), []
    for east_m in np.arange(-6.0, 6.1, 2.0):
        for north_m, up_m, yaw_deg, pitch_deg in STANDS:
            k = len(taken)
            pose = Pose((float(east_m), north_m, up_m), np.radians(yaw_deg + 12.0 * (k % 3 - 1)), np.radians(pitch_deg))
            path = folder / f"{k}.png"
            cv2.imwrite(str(path), drawn(tile, pose, k))
            taken.append(SurveyPicture(k, path, CAMERA, pose.enu_from_camera, np.array(pose.position_enu_m)))
    return taken


@pytest.fixture(scope="module")
def found(pictures: list[SurveyPicture]) -> Cloud:
    return thin_members(pictures, REGION, Settings(threads=1, distance_m=8.0), lambda stage, done, total: None)


def aside(points: NDArray[np.float32]) -> Array:
    """Distance of points from the wire's axis."""
    return np.asarray(np.hypot(points[:, 1], points[:, 2] - 4.0))


def test_the_wire_is_found_and_hardly_anything_hangs_in_the_air_above_the_grass(found: Cloud) -> None:
    assert np.mean(aside(found.points_enu_m) > 0.1) < 0.06, "0.39 if lines of grass count"
    places = np.arange(-5.0, 5.0, 0.1)
    assert np.mean(np.abs(places[:, None] - found.points_enu_m[None, :, 0]).min(axis=1) < 0.1) > 0.97


def test_lines_of_grass_are_left_out_and_those_of_the_wire_are_not(pictures: list[SurveyPicture]) -> None:
    picture = pictures[1]
    lines = sorted_lines(ridges(cv2.imread(str(picture.path), cv2.IMREAD_GRAYSCALE)), picture)
    left = alone(lines, picture)
    local = (WIRE_M - picture.position_enu_m) @ picture.enu_from_camera
    local = local[local[:, 2] > 0.5]
    wire_px = local[:, :2] / local[:, 2:] * CAMERA.fx_px + [CAMERA.cx_px, CAMERA.cy_px]
    before, after = (np.linalg.norm(x.ridges.place_px[:, None] - wire_px[None], axis=2).min(axis=1) < 12.0
                     for x in (lines, left))
    assert (~after).sum() < 0.6 * (~before).sum()
    assert after.sum() > 0.9 * before.sum()
