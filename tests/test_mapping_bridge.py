"""The whole way from rendered pictures of the bridge to the map, judged against the true mesh with Embree."""

from __future__ import annotations

import math

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from missions.camera import Camera, Pose
from missions.grid import FREE, OCCUPIED
from missions.mission import Mission
from missions.simulation import SceneSpec
from perception.mapping.explorer_map import ExplorerMap
from sim_bridge.render import make_renderer
from sim_bridge.scenes.load import load_scene
from sim_bridge.scenes.scene import Scene

pytestmark = pytest.mark.xdist_group("mapping_bridge")

Floats = NDArray[np.float64]


def _poses(scene: Scene) -> list[Pose]:
    """A take-off column 12 m south of the bridge, then a leg of 6 m along it, looking at it."""
    x, y = 0.25 * scene.object_min_enu_m[0], scene.object_min_enu_m[1] - 12.0
    column = [Pose((x, y, up), math.pi / 2, 0.0) for up in (2.0, 4.0, 6.0, 8.0)]
    return column + [Pose((x + 1.5 * k, y + 1.0 * k, 8.0 + 0.5 * k), math.pi / 2, 0.0) for k in range(1, 5)]


@pytest.fixture(scope="module")
def flown() -> tuple[ExplorerMap, trimesh.Trimesh, Scene, list[Pose], Camera]:
    mission = Mission(title="test", scene=SceneSpec(name="bridge"))
    scene = load_scene(mission.scene, mission.site)
    camera, poses = mission.camera.explore_camera(), _poses(scene)
    renderer = make_renderer(scene, mission.render, mission.camera, 1)
    lower, upper = np.array(scene.object_min_enu_m) - 14.25, np.array(scene.object_max_enu_m) + 14.0
    explorer = ExplorerMap(lower, upper, mission.explore.voxel_m, mission.fleet.radius_m)
    for i, pose in enumerate(poses):
        explorer.add_picture(renderer.render(camera, pose, [], i), camera, pose)
        if i % 4 == 3:
            explorer.update()
    renderer.close()
    vertices, faces = scene.mesh()
    return explorer, trimesh.Trimesh(vertices, faces, process=False), scene, poses, camera


def _true_points(mesh: trimesh.Trimesh, camera: Camera, pose: Pose) -> tuple[Floats, Floats]:
    """(h, w, 3) first true surface points through the pixels, NaN in the sky, and their z-depth (h, w)."""
    local = camera.rays_camera()
    length = np.linalg.norm(local, axis=-1)
    direction = ((local / length[..., None]) @ pose.enu_from_camera.T).reshape(-1, 3)
    origin = np.broadcast_to(np.array(pose.position_enu_m), direction.shape)
    where, ray, _ = mesh.ray.intersects_location(origin, direction, multiple_hits=False)
    points = np.full((len(direction), 3), np.nan)
    points[ray] = where
    distance = np.linalg.norm(points - origin, axis=1).reshape(length.shape)
    return points.reshape(local.shape), distance / length


def test_depth_of_the_bridge_is_right(flown: tuple[ExplorerMap, trimesh.Trimesh, Scene, list[Pose], Camera]) -> None:
    explorer, mesh, _, poses, camera = flown
    errors, measured, visible = [], 0, 0
    for i, pose in enumerate(poses):
        depth = explorer.depth(i)
        assert depth is not None
        _, true = _true_points(mesh, camera.scaled(228, 128), pose)
        near = depth.valid & (true < 25.0)
        errors.append(np.abs(depth.depth_m / true - 1.0)[near])
        measured, visible = measured + int(near.sum()), visible + int((true < 25.0).sum())
        assert (depth.sky & np.isfinite(true)).mean() < 1e-3
    error = np.concatenate(errors)
    assert measured > 0.6 * visible
    assert np.median(error) < 0.02
    assert (error > 0.1).mean() < 0.12


def test_hardly_any_true_surface_lies_in_free_space(
        flown: tuple[ExplorerMap, trimesh.Trimesh, Scene, list[Pose], Camera]) -> None:
    explorer, mesh, scene, poses, camera = flown
    grid = explorer.grid()
    seen = np.concatenate([_true_points(mesh, camera.scaled(228, 128), pose)[0].reshape(-1, 3) for pose in poses])
    seen = seen[np.isfinite(seen).all(axis=1) & grid.inside(grid.index(np.nan_to_num(seen)))]
    state = grid.state_at(seen)
    assert (state == FREE).mean() < 0.005
    solid = cKDTree(grid.centers(np.argwhere(grid.state == OCCUPIED)))
    assert (solid.query(seen[state == FREE])[0] > 1.2).sum() < 0.001 * len(seen)
    on_object = np.all((seen > scene.object_min_enu_m) & (seen < scene.object_max_enu_m), axis=1) & (seen[:, 2] > 0.5)
    assert (state[on_object] == OCCUPIED).mean() > 0.7
    assert (grid.state == FREE).sum() * grid.voxel_m**3 > 2000.0
