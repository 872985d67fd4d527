"""Compiles this room's kernels into numba's cache on disk, by planning once: python -m planning.warm_up.

Calling what a mission calls compiles exactly the types and memory layouts that a mission needs.
"""

from __future__ import annotations

import numpy as np

from missions.camera import Camera
from missions.grid import FREE, OCCUPIED, VoxelGrid
from missions.mission import ExploreSpec
from missions.pose_lattice import PoseLattice
from planning.allocate.flight_cost import Passing, leg_seconds
from planning.allocate.minmax import Effort, solve
from planning.allocate.problem import Problem, Ways
from planning.allocate.reassign import reassign
from planning.deconflict import distance_to_polyline_m, first_approach, meeting
from planning.nbv.coverage import surface_tally
from planning.nbv.horizon import HorizonSpec, best_way, promises
from planning.nbv.lattice import build_lattice
from planning.nbv.legs_ahead import Asker, plan_views
from planning.nbv.outlook import AheadSpec
from planning.nbv.rays import view_gains
from planning.nbv.sights import ImaginedMap, Orientations, sights
from planning.nbv.standoff import nearest_depth_m
from planning.nbv.survey import SurveyViewSpec, plan_survey
from planning.paths import MeshField, VoxelField, plan_path, reachable, voxelised
from planning.paths.roadmap import build_roadmap
from planning.paths.thesis_rrt import connect
from planning.trajectories import Limits, State, Via, fly_run

SIZE_M = np.array([10.0, 8.0, 8.0])
WALL_X, WALL_Y = 5, 4
CLEARANCE_M = 0.8


def warm_up() -> None:
    """Plan paths, a flight, next views and a survey around half a wall."""
    grid = VoxelGrid(np.zeros(3), 1.0, np.full((10, 8, 8), FREE, dtype=np.uint8))
    grid.state[WALL_X, :WALL_Y] = OCCUPIED
    _plan_paths(grid)
    _plan_flight()
    _cost_legs(grid)
    _share_out()
    _keep_apart()
    _plan_views(grid)
    _plan_ahead(grid)


def _plan_paths(grid: VoxelGrid) -> None:
    field = VoxelField.from_grid(grid).with_spheres(np.array([[2.0, 6.0, 6.0]]), 0.2)
    start, goal = np.array([2.5, 2.5, 4.5]), np.array([8.5, 2.5, 4.5])
    reach = reachable(field, start, CLEARANCE_M)
    reach.distance_to(np.stack([start, goal]))
    reach.path_to(goal)
    plan_path(field, start, goal, CLEARANCE_M, np.zeros(3), SIZE_M)
    corners, faces = np.array([[5.0, 0.0, 0.0], [5.0, 4.0, 0.0], [5.0, 0.0, 8.0]]), np.array([[0, 1, 2]])
    model = MeshField.from_mesh(corners, faces, voxelised(corners, faces, np.zeros(3), SIZE_M, 1.0))
    model.with_spheres(start, 0.2).segments_clear(start, goal, CLEARANCE_M)
    model.finer(np.stack([start, goal]), 8.0, CLEARANCE_M)
    wall = np.array([[[5.0, 0.0, 0.0], [6.0, 4.0, 8.0]]])
    connect(start, goal, wall, np.zeros(3), SIZE_M, step_m=4.0, iterations=50, seed=1)


def _plan_flight() -> None:
    vias = [Via(np.array(p), 0.0, stop=False, pass_m=0.5) for p in ((3.0, 0.0, 0.0), (6.0, 0.0, 0.0), (6.0, 6.0, 0.0))]
    fly_run(State.at_rest(np.zeros(3)), 0.0, 0.0, vias, Limits(3.0, 2.0, 6.0, 1.0), lambda outline: False).stop(1.0)


def _cost_legs(grid: VoxelGrid) -> None:
    places = np.array([[2.5, 2.5, 4.5], [8.5, 2.5, 4.5]])
    roadmap = build_roadmap(VoxelField.from_grid(grid), places, CLEARANCE_M)
    leg_seconds(roadmap, Passing(*np.ones((4, 2))), Limits(3.0, 2.0, 6.0, 1.0), 0.5)


def _keep_apart() -> None:
    track = np.zeros((3, 3))
    first_approach(track, track + 1.0, 2, 1.0)
    meeting(track, track + 1.0, 2, 1.0, track)
    distance_to_polyline_m(track, track)


def _share_out() -> None:
    positions = np.arange(12.0).reshape(4, 3)
    problem = Problem(Ways.of_positions(positions, positions[:2]))
    reassign(problem, solve(problem, Effort(iterations=1)).sorties)


def _plan_views(grid: VoxelGrid) -> None:
    camera = Camera.from_diagonal_fov(64, 48, 90.0)
    lattice = build_lattice(np.zeros(3), SIZE_M, ExploreSpec())
    imagined = ImaginedMap.new(np.zeros(3), 1.0, (grid.state == OCCUPIED).astype(np.float32), (slice(None),) * 3)
    chance, limits = np.ones((len(lattice.positions_enu_m), len(lattice.yaw_enu_rad))), Limits(3.0, 2.0, 6.0, 1.0)
    asker = Asker(1, np.where(lattice.positions_enu_m[:, 0] < WALL_X, 1.0, np.inf))
    plan_views(imagined, lattice, camera, 9.0, [asker], chance, AheadSpec(limits, 2.0), lambda gains, legs: True)
    nearest_depth_m(grid, [lattice.pose(0, 0)], camera)
    plan_survey(grid, lattice.positions_enu_m, camera, np.zeros(3), SIZE_M, SurveyViewSpec(max_views=2),
                [lattice.pose(0, 0)])
    along_x, no_view = np.array([[1.0, 0.0, 0.0]]), np.zeros(2, dtype=np.int64)
    view_gains(grid.state, np.ones(3), np.ones(3), np.ones((1, 3)), along_x, np.zeros(3), SIZE_M, 9.0, 1.0, no_view,
               no_view, 1)


def _plan_ahead(grid: VoxelGrid) -> None:
    lattice = PoseLattice((0.0, 0.0, 0.0), (10.0, 8.0, 8.0), (2, 2, 1), (0.0,), 4)
    occupied = (grid.state == OCCUPIED).astype(np.float32)
    yaw, elevation = lattice.yaw_elevation_rad.T
    orientations = Orientations.of(yaw, elevation, Camera.from_diagonal_fov(64, 48, 90.0))
    imagined = ImaginedMap.new(np.zeros(3), 1.0, occupied, (slice(None),) * 3)
    imagined.show(lattice.pose((0, 0, 0, 0, 0)), Camera.from_diagonal_fov(64, 48, 90.0), 9.0)
    surface_tally(imagined, (slice(None),) * 3, lattice.positions_enu_m, 9.0)
    seen = sights(imagined, lattice.positions_enu_m, orientations, 9.0)
    left, passable, spec = seen.left_after(0, 0, seen.nothing_shown), np.ones(lattice.steps.shape), HorizonSpec(depth=2)
    promised = promises(seen.gains_after(left), lattice.steps, passable, spec)
    best_way(seen, left, lattice.steps, passable, 0, lattice.steps[0][lattice.steps[0] >= 0].tolist(), promised, spec)


if __name__ == "__main__":
    warm_up()
