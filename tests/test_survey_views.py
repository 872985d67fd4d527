"""Survey views on a small voxel bridge: every patch in several sharp, unhidden pictures with parallax between them."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage

from missions.camera import Camera, Pose
from missions.grid import FREE, OCCUPIED, UNKNOWN, VoxelGrid
from missions.lattice import lattice_positions
from missions.mission import SurveySpec
from planning.nbv.patches import Patches, surface_patches
from planning.nbv.sightings import SightSpec, find_sightings
from planning.nbv.survey import SurveyPlan, SurveyViewSpec, plan_survey

pytestmark = pytest.mark.xdist_group("survey_views")

CAMERA = Camera.from_diagonal_fov(1920, 1080, 84.0)
LOWER, UPPER = np.array([-20.0, -14.0, -1.0]), np.array([20.0, 14.0, 20.0])
OBJECT_MIN, OBJECT_MAX = np.array([-10.0, -4.0, 0.0]), np.array([10.0, 4.0, 12.0])


def bridge() -> VoxelGrid:
    """Deck on two piers with a thin post on top, above known ground."""
    grid = VoxelGrid.unknown(LOWER, UPPER, 0.5)
    x, y, z = np.moveaxis(grid.centers(np.stack(np.indices(grid.state.shape), axis=-1)), -1, 0)
    deck = (abs(x) < 10) & (abs(y) < 3.5) & (z > 6) & (z < 7)
    piers = (abs(abs(x) - 6) < 1) & (abs(y) < 3) & (z < 6)
    post = (abs(x - 0.25) < 0.2) & (abs(y - 2.25) < 0.2) & (z > 7) & (z < 11)
    solid = deck | piers | post | (z < 0)
    shell = solid & ndimage.binary_dilation(~solid)
    grid.state[~solid], grid.state[shell] = FREE, OCCUPIED
    return grid


def allowed_positions(grid: VoxelGrid) -> NDArray[np.float64]:
    positions = lattice_positions(np.array([-18.0, -12.0, 1.5]), np.array([18.0, 12.0, 19.0]), 2.5)
    room = ndimage.distance_transform_edt(grid.state == FREE) * grid.voxel_m
    return positions[room[tuple(grid.index(positions).T)] > 1.5]


@pytest.fixture(scope="module")
def plan() -> SurveyPlan:
    grid = bridge()
    return plan_survey(grid, allowed_positions(grid), CAMERA, OBJECT_MIN, OBJECT_MAX, SurveyViewSpec())


def shown(pose: Pose, patches: Patches, grid: VoxelGrid, spec: SightSpec) -> NDArray[np.bool_]:
    """Which patches a picture shows, from the rules one by one and dense samples of the lines of sight."""
    eye = np.array(pose.position_enu_m)
    offset = patches.position_enu_m - eye
    distance = np.linalg.norm(offset, axis=1)
    facing = -(offset * patches.normal_enu).sum(axis=1) / distance
    x, y, z = (offset @ pose.enu_from_camera).T
    half_h, half_v = CAMERA.half_fov_rad
    edge = math.radians(2.5)
    result = (z > 0) & (abs(np.arctan2(x, z)) < half_h + edge) & (abs(np.arctan2(y, z)) < half_v + edge)
    result &= (distance > spec.nearest_m) & (distance < spec.farthest_m)
    result &= facing > math.cos(math.radians(spec.incidence_deg))
    for k in np.flatnonzero(result):
        reach = distance[k] - spec.tolerance_voxels * grid.voxel_m / max(facing[k], 0.5)
        samples = eye + np.linspace(0.0, max(reach - 0.05, 0.0), 300)[:, None] * offset[k] / distance[k]
        result[k] = bool((grid.state_at(samples) == FREE).all())
    return result


def test_nearly_every_patch_is_in_three_pictures(plan: SurveyPlan) -> None:
    assert len(plan.poses) <= 160
    assert plan.coverable.mean() > 0.95
    assert plan.covered_share(1) > 0.98
    assert plan.covered_share(3) > 0.9


def test_predicted_pictures_hold_when_counted_independently(plan: SurveyPlan) -> None:
    grid = bridge()
    counted = sum(shown(pose, plan.patches, grid, SurveyViewSpec().sight).astype(int) for pose in plan.poses)
    assert (plan.pictures <= counted).mean() > 0.97


def test_patches_get_useful_parallax(plan: SurveyPlan) -> None:
    assert (plan.paired[plan.coverable] >= 1).mean() > 0.9


def test_undersides_are_looked_at_from_below(plan: SurveyPlan) -> None:
    under = (plan.patches.normal_enu[:, 2] < -0.9) & (plan.patches.position_enu_m[:, 2] < 6.6)
    assert under.sum() > 50
    assert (plan.pictures[under & plan.coverable] >= 2).mean() > 0.85
    assert any(pose.elevation_rad > 0 and pose.position_enu_m[2] < 6.0 for pose in plan.poses)


def test_thin_members_are_taken_from_every_side(plan: SurveyPlan) -> None:
    post = (plan.patches.position_enu_m[:, 2] > 7.6) & (plan.patches.position_enu_m[:, 2] < 10.4)
    sides = {tuple(n) for n in plan.patches.normal_enu[post]}
    assert {(-1.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 1.0, 0.0)} <= sides
    assert (plan.pictures[post] >= 3).all()


def test_poses_stand_on_allowed_positions_only(plan: SurveyPlan) -> None:
    grid = bridge()
    allowed = {tuple(p) for p in allowed_positions(grid)}
    assert all(pose.position_enu_m in allowed for pose in plan.poses)


def test_the_same_map_gives_the_same_plan(plan: SurveyPlan) -> None:
    grid = bridge()
    again = plan_survey(grid, allowed_positions(grid), CAMERA, OBJECT_MIN, OBJECT_MAX, SurveyViewSpec())
    assert again.poses == plan.poses


def test_a_small_budget_is_kept_and_spent_on_the_best_first(plan: SurveyPlan) -> None:
    grid = bridge()
    spec = SurveyViewSpec.of(SurveySpec(max_views=12))
    few = plan_survey(grid, allowed_positions(grid), CAMERA, OBJECT_MIN, OBJECT_MAX, spec)
    assert len(few.poses) == 12
    assert few.covered_share(1) > 0.5


def test_no_surface_or_no_position_gives_an_empty_plan() -> None:
    grid = bridge()
    nothing = VoxelGrid.unknown(LOWER, UPPER, 0.5)
    for found, positions in ((nothing, allowed_positions(grid)), (grid, np.zeros((0, 3)))):
        empty = plan_survey(found, positions, CAMERA, OBJECT_MIN, OBJECT_MAX, SurveyViewSpec())
        assert empty.poses == []
        assert not empty.coverable.any()


def test_both_faces_of_a_deck_are_patches_of_their_own() -> None:
    patches = surface_patches(bridge(), OBJECT_MIN, OBJECT_MAX)
    on_deck = (abs(patches.position_enu_m[:, 0]) < 4) & (abs(patches.position_enu_m[:, 1]) < 2.5)
    facing = patches.normal_enu[on_deck & (patches.position_enu_m[:, 2] > 5.5), 2]
    assert (facing > 0.9).sum() > 20
    assert (facing < -0.9).sum() > 20


def test_patches_tell_every_face_next_to_free_space_once() -> None:
    grid = bridge()
    patches = surface_patches(grid, OBJECT_MIN, OBJECT_MAX)
    top = patches.normal_enu[:, 2] > 0.9
    deck = (abs(patches.position_enu_m[:, 0]) < 10) & (patches.position_enu_m[:, 2] > 6.5)
    assert patches.voxels[top & deck & (patches.position_enu_m[:, 2] < 7.5)].sum() == 40 * 14 - 1


@pytest.mark.parametrize(("between", "visible"), [(FREE, True), (UNKNOWN, False), (OCCUPIED, False)])
def test_only_known_free_space_is_looked_through(between: int, visible: bool) -> None:
    grid = VoxelGrid.unknown(np.zeros(3), np.full(3, 12.0), 0.5)
    grid.state[:] = FREE
    grid.state[:2] = OCCUPIED
    grid.state[10] = between
    wall = Patches(np.array([[0.9, 6.1, 6.1]]), np.array([[1.0, 0.0, 0.0]]), np.array([4]))
    sightings = find_sightings(grid, wall, np.array([[8.0, 6.1, 6.1]]), SightSpec())
    assert (len(sightings.patch) == 1) == visible


@pytest.mark.parametrize(("position", "visible"), [
    ((8.0, 6.1, 6.1), True), ((2.5, 6.1, 6.1), False), ((2.5, 11.0, 6.1), False), ((0.9, 11.5, 6.1), False)])
def test_distance_and_incidence_limit_sightings(position: tuple[float, float, float], visible: bool) -> None:
    grid = VoxelGrid.unknown(np.zeros(3), np.full(3, 12.0), 0.5)
    grid.state[:], grid.state[:2] = FREE, OCCUPIED
    wall = Patches(np.array([[0.9, 6.1, 6.1]]), np.array([[1.0, 0.0, 0.0]]), np.array([4]))
    assert (len(find_sightings(grid, wall, np.array([position]), SightSpec()).patch) == 1) == visible
