"""Reconstruction of a textured wall with a box before it, of which everything is known."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import ndimage
from scipy.spatial import cKDTree

from missions.camera import Camera
from missions.errors import UserError
from missions.frames import Array
from perception.products.mesh import poisson_mesh
from perception.reconstruct.cloud import Cloud, on_grid, read_cloud, without_islands, write_cloud
from perception.reconstruct.depth_map import merge_pairs
from perception.reconstruct.depth_stage import depth_key, save_array
from perception.reconstruct.fuse_stage import Part, in_layers, merged, records_of, slab_bounds
from perception.reconstruct.fusion import PosedDepth, support
from perception.reconstruct.pairs import overlapping, stereo_partners
from perception.reconstruct.pictures import SurveyPicture, read_colour
from perception.reconstruct.pipeline import reconstruct
from perception.reconstruct.resources import LastUsed, room
from perception.reconstruct.settings import Region, Settings
from perception.reconstruct.stereo import Eye, PairDepth, pair_depths
from tests.reconstruct_scene import CAMERA, looking_at, photograph, survey, wall_and_box

pytestmark = pytest.mark.xdist_group("reconstruct")

SETTINGS = Settings(depth_width_px=640, distance_m=5.0)
REGION = Region(np.array([-4.9, -1.5, 0.1]), np.array([4.9, 0.3, 5.9]))


@pytest.fixture(scope="session")
def pictures(tmp_path_factory: pytest.TempPathFactory) -> list[SurveyPicture]:
    return survey(tmp_path_factory.mktemp("pictures"))


@pytest.fixture(scope="session")
def depth_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("depth")


@pytest.fixture(scope="session")
def cloud(pictures: list[SurveyPicture], depth_folder: Path) -> Cloud:
    return reconstruct(pictures, REGION, SETTINGS, depth_folder)


def distance_to_surface(points: Array) -> Array:
    """Exact distance of points (n, 3) to the nearest rectangle of the scene."""
    best = np.full(len(points), np.inf)
    for r in wall_and_box():
        la, lb = np.linalg.norm(r.a), np.linalg.norm(r.b)
        local = points - r.corner
        s, q = np.clip(local @ (r.a / la), 0, la), np.clip(local @ (r.b / lb), 0, lb)
        best = np.minimum(best, np.linalg.norm(local - s[:, None] * r.a / la - q[:, None] * r.b / lb, axis=1))
    return best


def seen_wall(pictures: list[SurveyPicture], by: int) -> Array:
    """(n, 3) points of the wall that at least `by` pictures see, 8 pixels inside their frames."""
    points = np.stack(np.meshgrid(np.arange(-4.8, 4.8, 0.03), [0.0], np.arange(0.2, 5.8, 0.03)), -1).reshape(-1, 3)
    count = np.zeros(len(points), dtype=int)
    for picture in pictures:
        local = (points - picture.position_enu_m) @ picture.enu_from_camera
        u = local[:, 0] / local[:, 2] * CAMERA.fx_px + CAMERA.cx_px
        v = local[:, 1] / local[:, 2] * CAMERA.fy_px + CAMERA.cy_px
        away = points - picture.position_enu_m
        free = np.ones(len(points), dtype=bool)
        for box_face in wall_and_box()[1:]:
            t, _, _ = box_face.hit(picture.position_enu_m, away)
            free &= ~(t < 0.99)
        count += free & (u > 8) & (u < CAMERA.width_px - 8) & (v > 8) & (v < CAMERA.height_px - 8)
    return points[count >= by]


def test_the_seen_wall_is_there(cloud: Cloud, pictures: list[SurveyPicture]) -> None:
    on_wall = cloud.points_enu_m[np.abs(cloud.points_enu_m[:, 1]) < 0.02]
    distance, _ = cKDTree(on_wall).query(seen_wall(pictures, by=3))
    assert np.mean(distance < 0.05) >= 0.95


def test_no_point_floats(cloud: Cloud) -> None:
    distance = distance_to_surface(cloud.points_enu_m.astype(np.float64))
    assert distance.max() < 0.05
    assert np.mean(distance < 0.02) >= 0.98


def test_points_know_their_normal_and_confidence(cloud: Cloud) -> None:
    wall = (np.abs(cloud.points_enu_m[:, 1]) < 0.02) & (np.abs(cloud.points_enu_m[:, 0]) > 1.2)
    assert np.allclose(np.linalg.norm(cloud.normals, axis=1), 1.0, atol=1e-3)
    assert np.median(cloud.normals[wall] @ np.array([0.0, -1.0, 0.0])) > 0.99
    assert cloud.confidence.min() >= SETTINGS.min_confidence
    assert cloud.confidence.max() <= 9


def test_one_point_per_voxel_in_the_region(cloud: Cloud) -> None:
    index = np.floor(cloud.points_enu_m / np.float32(SETTINGS.spacing_m)).astype(int)
    assert len(np.unique(index, axis=0)) >= 0.999 * len(cloud)
    assert REGION.contains(cloud.points_enu_m).all()


def test_again_from_stored_depth_and_with_other_threads(cloud: Cloud, pictures: list[SurveyPicture], depth_folder: Path,
                                                        tmp_path: Path) -> None:
    told: list[tuple[str, int, int]] = []
    again = reconstruct(pictures, REGION, SETTINGS, depth_folder, lambda *step: told.append(step))
    assert {stage for stage, _, _ in told} == {"merge"}
    fresh = reconstruct(pictures, REGION, Settings(depth_width_px=640, distance_m=5.0, threads=1), tmp_path)
    for other in (again, fresh):
        np.testing.assert_array_equal(other.points_enu_m, cloud.points_enu_m)
        np.testing.assert_array_equal(other.colours, cloud.colours)


def test_mesh_lies_on_the_surface_and_bridges_no_gap(cloud: Cloud) -> None:
    mesh = poisson_mesh(cloud, spacing_m=0.05)
    distance = distance_to_surface(mesh.vertices_enu_m)
    assert len(mesh) > 1000
    assert np.mean(distance < 0.05) > 0.95
    assert cKDTree(cloud.points_enu_m).query(mesh.vertices_enu_m)[0].max() < 0.15


def test_cloud_file_keeps_everything(cloud: Cloud, tmp_path: Path) -> None:
    write_cloud(cloud, tmp_path / "cloud.ply")
    header = (tmp_path / "cloud.ply").read_bytes()[:600]
    for name in (b"binary_little_endian", b"x", b"nx", b"red", b"uchar confidence"):
        assert name in header
    back = read_cloud(tmp_path / "cloud.ply")
    for name in ("points_enu_m", "colours", "normals", "confidence"):
        np.testing.assert_array_equal(getattr(back, name), getattr(cloud, name))


def test_missing_cloud_is_explained(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"cloud\.ply: no cloud.*swarmscan reconstruct"):
        read_cloud(tmp_path / "cloud.ply")


@pytest.mark.parametrize("offset", [(0.9, 0.0, 0.0), (-0.9, 0.0, 0.0), (0.0, 0.0, 0.9), (0.0, 0.0, -0.9),
                                    (0.6, 0.3, 0.6)])
def test_a_pair_measures_depth_whatever_its_baseline(offset: tuple[float, float, float]) -> None:
    surfaces = wall_and_box()[:1]
    poses = [looking_at((0.0, -5.0, 3.0), (0.0, 0.0, 3.0)),
             looking_at((offset[0], -5.0 + offset[1], 3.0 + offset[2]), (0.0, 0.0, 3.0))]
    eyes = []
    for seed, pose in enumerate(poses):
        grey = cv2.cvtColor(photograph(surfaces, pose, seed=seed), cv2.COLOR_BGR2GRAY)
        eyes.append(Eye(grey, np.zeros(grey.shape, bool), CAMERA, pose.enu_from_camera, np.array(pose.position_enu_m)))
    found, = pair_depths(eyes[0], eyes[1:], near_m=2.0, far_m=40.0)
    inner = found.inverse_depth[100:-100, 150:-150]
    assert np.isfinite(inner).mean() > 0.95
    assert np.nanmedian(np.abs(1.0 / inner - 5.0)) < 0.01


def test_pictures_that_share_nothing_give_no_depth() -> None:
    eyes = [Eye(np.zeros((360, 640), np.uint8), np.zeros((360, 640), bool), CAMERA, pose.enu_from_camera,
                np.array(pose.position_enu_m))
            for pose in (looking_at((0, -5, 3), (0, 0, 3)), looking_at((0.5, -5, 3), (0.5, -9, 3)))]
    assert pair_depths(eyes[0], eyes[1:], near_m=2.0, far_m=40.0) == []


def test_partners_have_parallax_and_differing_baselines(pictures: list[SurveyPicture]) -> None:
    partners = stereo_partners(pictures, 5.0, 4)
    middle = np.array([pictures[j].position_enu_m - pictures[4].position_enu_m for j in partners[4]])
    assert all(i not in p and len(set(p)) == len(p) == 4 for i, p in enumerate(partners))
    assert np.ptp(middle[:2, 0]) > 1.0, "the first two partners lie on different axes"
    assert all(i not in row for i, row in enumerate(overlapping(pictures, 5.0, 8)))


@given(st.lists(st.sampled_from([5.0, 5.01, 9.0, float("nan")]), min_size=1, max_size=5))
def test_merging_keeps_the_majority_or_nothing(depths: list[float]) -> None:
    pairs = [PairDepth(np.full((2, 2), 1.0 / d, np.float32), 0.001) for d in depths]
    merged = merge_pairs(pairs, (2, 2))
    near, far = sum(d < 6.0 for d in depths), sum(d > 6.0 for d in depths)
    if near > far and (near > 1 or far == 0):
        assert np.all(np.abs(merged - 5.0) < 0.02)
    elif far > near and (far > 1 or near == 0):
        assert np.allclose(merged, 9.0, atol=1e-3)
    elif max(near, far) < 2:
        assert np.all(merged == 0.0)


def flat(distance: float, x: float) -> PosedDepth:
    return PosedDepth(np.full((36, 64), distance, np.float32), np.eye(3), np.array([x, 0.0, 0.0]))


def test_support_counts_agreement_and_sight_through() -> None:
    camera = Camera.from_diagonal_fov(64, 36, 84.0)
    others = [flat(5.0, 0.1), flat(5.01, -0.1), flat(8.0, 0.05), flat(np.inf, 0.0), flat(3.0, 0.0), flat(0.0, 0.0)]
    found = support(flat(5.0, 0.0), others, camera)
    middle = (slice(10, 26), slice(20, 44))
    assert np.all(found.agreeing[middle] == 3)
    assert np.all(found.through[middle] == 2), "a farther surface and the sky, not the nearer one or the unknown"
    np.testing.assert_allclose(found.depth[middle], (5.0 + 5.0 + 5.01) / 3, atol=1e-3)


def test_what_is_vague_from_afar_confirms_nothing_seen_from_nearby() -> None:
    camera = Camera.from_diagonal_fov(64, 36, 84.0)

    def wall(depth_m: float, behind_m: float) -> PosedDepth:
        return PosedDepth(np.full((36, 64), depth_m, np.float32), np.eye(3), np.array([0.0, 0.0, -behind_m]))

    near, far = wall(5.0, 0.0), wall(45.1, 40.0)
    middle = (slice(10, 26), slice(20, 44))
    assert np.all(support(near, [far], camera).agreeing[middle] == 1), "10 cm are 0.2 % of 45 m, but 2 % of 5 m"
    assert np.all(support(far, [near], camera).agreeing[middle] == 1), "nor the other way round"
    assert np.all(support(near, [wall(45.01, 40.0)], camera).agreeing[middle] == 2)


def scattered(n: int, seed: int, spread_m: float = 1.0) -> Cloud:
    rng = np.random.default_rng(seed)
    normals = rng.normal(size=(n, 3)).astype(np.float32)
    return Cloud((rng.random((n, 3)) * spread_m).astype(np.float32), rng.integers(0, 256, (n, 3), dtype=np.uint8),
                 normals / np.linalg.norm(normals, axis=1, keepdims=True), rng.integers(3, 9, n).astype(np.uint8))


@given(st.integers(1, 400), st.integers(0, 5), st.sampled_from([0.05, 0.2, 3.0]))
def test_grid_moves_no_point_out_of_its_voxel(n: int, seed: int, spacing: float) -> None:
    full = scattered(n, seed)
    thin = on_grid(full, spacing)
    voxels = np.unique(np.floor(full.points_enu_m / np.float32(spacing)).astype(int), axis=0)
    assert len(thin) == len(voxels)
    assert cKDTree(full.points_enu_m).query(thin.points_enu_m)[0].max() <= spacing * np.sqrt(3.0)
    assert thin.confidence.max() == full.confidence.max()


@given(st.lists(st.integers(0, 300), min_size=1, max_size=4), st.integers(0, 5), st.integers(1, 500))
def test_slab_by_slab_is_as_all_at_once(sizes: list[int], seed: int, most: int) -> None:
    clouds = [in_layers(on_grid(scattered(n, seed + k), 0.1), 0.1) for k, n in enumerate(sizes)]
    with TemporaryDirectory() as folder:
        parts = []
        for k, part in enumerate(clouds):
            path = Path(folder) / f"{k}.npy"
            save_array(path, records_of(part))
            parts.append(Part.of(path, 0.1))
        bounds = slab_bounds(parts, most)
        slabs, whole = merged(parts, 0.1, most), on_grid(Cloud.concatenate(clouds), 0.1)
        held = [sum(len(part.cut(a, b)) for part in parts) for a, b in pairwise(bounds)]
    assert sum(held) == sum(len(part) for part in clouds)
    assert all(n <= most or b - a == 1 for n, (a, b) in zip(held, pairwise(bounds), strict=True))
    for name in ("points_enu_m", "colours", "normals", "confidence"):
        np.testing.assert_array_equal(getattr(slabs, name), getattr(whole, name))


def test_what_is_kept_stays_within_its_limit_and_is_made_once() -> None:
    made: list[int] = []

    def make(i: int) -> np.ndarray:
        made.append(i)
        return np.full(10, i, np.uint8)

    shelf = LastUsed(make, lambda a: a.nbytes, 25)
    assert [int(shelf[i][0]) for i in (0, 1, 0, 2, 0, 1)] == [0, 1, 0, 2, 0, 1]
    assert made == [0, 1, 2, 1], "the third one displaced what was asked for longest ago"


def test_threads_are_as_many_as_memory_has_room_for() -> None:
    assert room(4.0, 3, 100 * 2**20, 2**20).threads == 3
    assert room(1.0, 3, 200 * 2**20, 2**20).threads == 2
    with pytest.raises(UserError, match=r"reconstruct\.memory_gib 0\.7: too little.*at least 1\.6"):
        room(0.7, 3, 2**30, 2**20)


def touching_by_label(index: np.ndarray) -> np.ndarray:
    occupied = np.zeros(tuple(index.max(axis=0) + 1), dtype=bool)
    occupied[tuple(index.T)] = True
    return ndimage.label(occupied, structure=np.ones((3, 3, 3)))[0][tuple(index.T)]


@given(st.integers(1, 60), st.integers(0, 20), st.integers(1, 6))
def test_islands_are_groups_of_touching_cells(n: int, seed: int, least: int) -> None:
    index = np.random.default_rng(seed).integers(0, 6, (n, 3))
    full = scattered(n, seed)
    cloud = Cloud((index + 0.5).astype(np.float32), full.colours, full.normals, full.confidence)
    group = touching_by_label(index)
    expected = cloud.points_enu_m[np.bincount(group)[group] >= least]
    np.testing.assert_array_equal(without_islands(cloud, 1.0, least).points_enu_m, expected)


def test_islands_are_dropped() -> None:
    island = scattered(20, 1, 0.2)
    far = Cloud(island.points_enu_m + np.float32(5.0), island.colours, island.normals, island.confidence)
    kept = without_islands(Cloud.concatenate([scattered(500, 0, 0.5), far]), 0.15)
    assert len(kept) == 500


def test_unreadable_and_wrongly_sized_pictures_are_named(pictures: list[SurveyPicture], tmp_path: Path) -> None:
    bad = SurveyPicture(7, tmp_path / "UAV_1_7.jpg", CAMERA, np.eye(3), np.zeros(3))
    with pytest.raises(UserError, match=r"UAV_1_7\.jpg: not a readable picture"):
        read_colour(bad, 640)
    cv2.imwrite(str(bad.path), np.zeros((90, 160, 3), np.uint8))
    with pytest.raises(UserError, match=r"160x90 pixels where camera\.survey_px says 640x360"):
        read_colour(bad, 640)
    with pytest.raises(UserError, match="needs at least 3"):
        reconstruct(pictures[:2], REGION, SETTINGS, tmp_path)


def test_depth_key_depends_on_what_matters(pictures: list[SurveyPicture]) -> None:
    key = depth_key(pictures, SETTINGS)
    assert key == depth_key(pictures, Settings(depth_width_px=640, distance_m=5.0, min_confidence=5))
    assert key != depth_key(pictures, Settings(depth_width_px=320, distance_m=5.0))
    assert key != depth_key(pictures[:-1], SETTINGS)
