"""True coverage against scenes whose visible parts are known in closed form."""

from __future__ import annotations

import math

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from missions.camera import Camera, Pose
from missions.frames import Array
from missions.lattice import lattice_positions
from missions.messages import PictureMeta
from missions.mission import ExploreSpec
from missions.simulation import ObstacleSpec
from sim_bridge.coverage import TOLERANCE_M, Coverage, in_frame
from sim_bridge.truth import BEFORE_FLIGHT_NS, Truth

CAMERA = Camera.from_diagonal_fov(456, 256, 84.0)
BOX = trimesh.creation.box(extents=(4.0, 4.0, 4.0))
POINTS, FACE = trimesh.sample.sample_surface(BOX, 3000, seed=1)
POINTS, NORMALS = np.asarray(POINTS), np.asarray(BOX.face_normals)[FACE]


def truth(obstacles: list[ObstacleSpec] | None = None, extra: trimesh.Trimesh | None = None) -> Truth:
    mesh = BOX if extra is None else trimesh.util.concatenate([BOX, extra])
    return Truth(np.asarray(mesh.vertices), np.asarray(mesh.faces, dtype=np.int32), obstacles or [])


def picture(position: tuple[float, float, float], yaw: float, elevation: float = 0.0, t_ns: int = 0,
            view_id: int = 0) -> PictureMeta:
    return PictureMeta(vehicle_id=1, view_id=view_id, phase="explore", t_capture_ns=t_ns, speed_m_s=0.0,
                       position_sigma_m=0.0, pose=Pose(position, yaw, elevation), camera=CAMERA, sha256="",
                       size_bytes=0)


def seen_by(world: Truth, *pictures: PictureMeta, range_m: float = 25.0) -> Array:
    coverage = Coverage(world, POINTS, range_m)
    for s in pictures:
        coverage.add(s)
    return coverage._seen


def facing(eye: tuple[float, float, float]) -> Array:
    """How far the eye stands before each sample's face; negative behind it."""
    depth: Array = np.einsum("ij,ij->i", NORMALS, np.array(eye) - POINTS)
    return depth


ON_FACES = (np.abs(POINTS) < 2.0 - 1.5 * TOLERANCE_M).sum(axis=1) == 2
"""Not so near to an edge that the tolerance lets one see around it."""


def test_a_box_seen_from_one_side_shows_exactly_that_side() -> None:
    eye = (-8.0, 0.0, 0.0)
    seen = seen_by(truth(), picture(eye, 0.0))
    assert (seen == (facing(eye) > 0))[ON_FACES].all()
    assert 0.1 < seen.mean() < 0.25


@given(st.floats(0, 2 * math.pi), st.floats(-1.2, 1.2))
@settings(max_examples=40, deadline=None)
def test_only_what_faces_the_camera_is_seen(azimuth: float, elevation: float) -> None:
    c = math.cos(elevation)
    eye = (9.0 * c * math.cos(azimuth), 9.0 * c * math.sin(azimuth), 9.0 * math.sin(elevation))
    seen = seen_by(truth(), picture(eye, azimuth + math.pi, -elevation))
    grazing = np.abs(facing(eye)) < 0.05
    assert (seen == (facing(eye) > 0))[ON_FACES & ~grazing].all()


def test_behind_the_camera_beyond_range_and_outside_the_frame_nothing_is_seen() -> None:
    assert not seen_by(truth(), picture((-8.0, 0.0, 0.0), math.pi)).any()
    assert not seen_by(truth(), picture((-8.0, 0.0, 0.0), 0.0), range_m=5.9).any()
    assert not seen_by(truth(), picture((-8.0, 0.0, 0.0), 0.0, math.radians(60.0))).any()


def test_range_is_a_sphere_around_the_camera() -> None:
    eye = np.array([-8.0, 0.0, 0.0])
    seen = seen_by(truth(), picture((-8.0, 0.0, 0.0), 0.0), range_m=6.2)
    near = np.linalg.norm(POINTS - eye, axis=1) <= 6.2
    assert (seen == ((facing((-8.0, 0.0, 0.0)) > 0) & near))[ON_FACES].all()


def test_a_wall_and_a_box_of_the_moment_hide_what_is_behind_them() -> None:
    wall = trimesh.creation.box(extents=(0.2, 9.0, 9.0)).apply_translation((-5.0, 0.0, 0.0))
    assert not seen_by(truth(extra=wall), picture((-8.0, 0.0, 0.0), 0.0)).any()
    beam = ObstacleSpec(center_enu_m=(-5.0, 0.0, 0.0), size_m=(0.2, 9.0, 9.0), appears_at_s=1.0, disappears_at_s=2.0)
    share = [seen_by(truth([beam]), picture((-8.0, 0.0, 0.0), 0.0, t_ns=t)).mean() for t in (0, 10**9, 2 * 10**9)]
    assert share[1] == 0.0
    assert share[0] == share[2] > 0.1


def test_coverage_rises_to_everything_and_is_reported_view_by_view() -> None:
    coverage = Coverage(truth(), POINTS, 25.0)
    sides = [((-8.0, 0.0, 0.0), 0.0, 0.0), ((8.0, 0.0, 0.0), math.pi, 0.0), ((0.0, -8.0, 0.0), math.pi / 2, 0.0),
             ((0.0, 8.0, 0.0), -math.pi / 2, 0.0), ((0.0, 0.0, 8.0), 0.0, -math.pi / 2),
             ((0.0, 0.0, -8.0), 0.0, math.pi / 2)]
    for k, (position, yaw, elevation) in enumerate(sides):
        coverage.add(picture(position, yaw, elevation, view_id=10 + k))
    assert np.diff(coverage.per_view).min() > 0.1
    summary = coverage.summary()
    assert summary["final"] == 1.0
    assert summary["view_ids"] == [10, 11, 12, 13, 14, 15]
    assert summary["auc"] == pytest.approx(np.mean(coverage.per_view))


@given(st.lists(st.tuples(st.floats(-9, 9), st.floats(-9, 9), st.floats(3, 9), st.floats(-3, 3)), max_size=6),
       st.integers(0, 8))
@settings(max_examples=25, deadline=None)
def test_the_ceiling_is_never_below_what_was_covered(views: list[tuple[float, float, float, float]], n: int) -> None:
    coverage = Coverage(truth(), POINTS, 25.0)
    for east, north, up, yaw in views:
        coverage.add(picture((east, north, up), yaw, -0.7))
    positions = lattice_positions(np.full(3, -8.0), np.full(3, 8.0), 8.0)[:n]
    coverage.reach(positions, ExploreSpec(), CAMERA)
    ceiling = coverage.ceiling
    assert ceiling >= (coverage.per_view[-1] if views else 0.0)
    for position in positions:
        coverage.add(picture(tuple(position.tolist()), 2.0 * math.pi * 3 / 10, math.radians(-30.0)))
    assert coverage.ceiling == ceiling >= (coverage.per_view[-1] if coverage.per_view else 0.0)


def test_the_whole_lattice_reaches_all_sides() -> None:
    positions = lattice_positions(np.full(3, -8.0), np.full(3, 8.0), 4.0)
    world = truth()
    free = world.distance(positions, np.full(len(positions), BEFORE_FLIGHT_NS)) >= 1.2
    coverage = Coverage(world, POINTS, 25.0)
    coverage.reach(positions[free], ExploreSpec(), CAMERA)
    assert coverage.ceiling == 1.0


def test_lattice_cells_are_equal_and_fill_the_box() -> None:
    lattice = lattice_positions(np.array([0.0, -5.0, 2.0]), np.array([80.0, 5.0, 5.0]), 4.0)
    assert len(lattice) == 20 * 2 * 1
    assert sorted(set(lattice[:, 0])) == pytest.approx(np.arange(20) * 4.0 + 2.0)
    assert sorted(set(lattice[:, 1])) == [-2.5, 2.5]
    assert set(lattice[:, 2]) == {3.5}


@given(st.floats(-5, 5), st.floats(-5, 5), st.floats(0.1, 10))
def test_the_frame_is_where_the_pixels_are(x: float, y: float, z: float) -> None:
    u, v, w = CAMERA.matrix @ np.array([x, y, z])
    inside = 0 <= u / w <= CAMERA.width_px and 0 <= v / w <= CAMERA.height_px
    margin = min(abs(u / w), abs(u / w - CAMERA.width_px), abs(v / w), abs(v / w - CAMERA.height_px))
    assert bool(in_frame(np.array([[x, y, z]]), CAMERA)[0]) == inside or margin < 1e-6
    assert not in_frame(np.array([[x, y, -z]]), CAMERA)[0]
