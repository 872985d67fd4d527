"""Exploration of a synthetic voxel building with a perfect depth sensor: does the search find the surface, and fast?"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage

from missions.camera import Camera, Pose
from missions.grid import FREE, OCCUPIED, UNKNOWN, VoxelGrid
from missions.mission import ExploreSpec
from missions.sensors import fibonacci_directions
from planning.nbv.lattice import Lattice, build_lattice
from planning.nbv.legs_ahead import Asker, Plan, plan_views
from planning.nbv.outlook import AheadSpec
from planning.nbv.rays import first_hits
from planning.nbv.shown import ShownFaces
from planning.nbv.sights import ImaginedMap
from planning.trajectories import Limits

pytestmark = pytest.mark.xdist_group("nbv_exploration")

LOWER, UPPER = np.array([-18.0, -14.0, -1.0]), np.array([18.0, 14.0, 20.0])
OBJECT_MIN, OBJECT_MAX = np.array([-9.0, -5.0, 0.0]), np.array([9.0, 5.0, 11.0])
CAMERA_MIN, CAMERA_MAX = np.array([-17.0, -13.0, 1.5]), np.array([17.0, 13.0, 19.0])
SENSOR = Camera.from_diagonal_fov(86, 48, 84.0)
VOXEL_M, RANGE_M, CLEARANCE_M = 0.5, 20.0, 1.2
CHANCE_INSIDE, CHANCE_OUTSIDE = 0.06, 0.015
"""That an unknown voxel is solid, in the object's box and elsewhere."""
SPEC = AheadSpec(Limits(3.0, 2.0, 6.0, 1.0), separation_m=5.0, shortlist=60, coarse_rays=256, rays=1024)
LEAST_GAIN_M2 = 1.0
DECISIONS = 32


def building() -> NDArray[np.uint8]:
    """1 where the world is solid: ground, and a house with an archway through it, a tower and a ledge."""
    grid = VoxelGrid.unknown(LOWER, UPPER, VOXEL_M)
    x, y, z = np.moveaxis(grid.centers(np.stack(np.indices(grid.state.shape), axis=-1)), -1, 0)
    house = (abs(x) < 8) & (abs(y) < 4) & (z < 8) & ~((abs(x) < 2.5) & (z < 5))
    tower = (abs(x - 5) < 1.5) & (abs(y) < 1.5) & (z < 10.5)
    ledge = (abs(x) < 8) & (abs(y) < 5) & (z > 6) & (z < 7)
    return (house | tower | ledge | (z < 0)).astype(np.uint8)


@dataclass
class World:
    """The true voxels, what is known of them, and who has looked where."""

    solid: NDArray[np.uint8] = field(default_factory=building)
    grid: VoxelGrid = field(default_factory=lambda: VoxelGrid.unknown(LOWER, UPPER, VOXEL_M))
    shown: ShownFaces = field(default_factory=lambda: ShownFaces(SENSOR, RANGE_M))

    def stops(self, start_enu_m: NDArray[np.float64], rays: NDArray[np.float64]) -> NDArray[np.float64]:
        """(r,) how far rays go, in voxels, a little way into what stops them."""
        reach = RANGE_M / VOXEL_M
        return np.minimum(first_hits(self.solid, 1, (start_enu_m - LOWER) / VOXEL_M, rays, reach) + 0.01, reach)

    def voxels(self, start_enu_m: NDArray[np.float64], rays: NDArray[np.float64],
               along: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Mask of the voxels at distances (r, s) along rays (r, 3)."""
        index = np.floor((start_enu_m - LOWER) / VOXEL_M + along[..., None] * rays[:, None]).astype(np.int64)
        seen = np.zeros(self.solid.shape, dtype=np.bool_)
        seen[tuple(index[self.grid.inside(index)].T)] = True
        return seen

    def take_picture(self, pose: Pose) -> None:
        rays = SENSOR.rays_camera().reshape(-1, 3) @ pose.enu_from_camera.T
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        at = np.array(pose.position_enu_m)
        seen = self.voxels(at, rays, np.linspace(0.0, 1.0, 60) * self.stops(at, rays)[:, None])
        self.grid.state[seen] = np.where(self.solid[seen] == 1, OCCUPIED, FREE)
        self.shown.add(pose)

    def imagined(self, claimed: list[Pose]) -> ImaginedMap:
        box = tuple(slice(int(a), int(b)) for a, b in zip(self.grid.index(OBJECT_MIN), self.grid.index(OBJECT_MAX) + 1,
                                                          strict=True))
        unknown = np.full(self.solid.shape, CHANCE_OUTSIDE, dtype=np.float32)
        unknown[box] = CHANCE_INSIDE
        occupancy = np.where(self.grid.state == UNKNOWN, unknown, (self.grid.state == OCCUPIED).astype(np.float32))
        imagined = ImaginedMap.new(LOWER, VOXEL_M, occupancy, box)
        self.shown.take_out(imagined)
        for pose in claimed:
            imagined.show(pose, SENSOR, RANGE_M)
        return imagined


def reachable_surface(lattice: Lattice) -> NDArray[np.bool_]:
    """Object voxels that some view of the lattice from free space could see: the ceiling of coverage."""
    world = World()
    box = world.grid.centers(np.stack(np.indices(world.solid.shape), axis=-1))
    in_box = np.all((box > OBJECT_MIN) & (box < OBJECT_MAX), axis=-1)
    clear = ndimage.distance_transform_edt(world.solid == 0) * VOXEL_M > CLEARANCE_M
    seen, rays = np.zeros(world.solid.shape, dtype=np.bool_), fibonacci_directions(6000)
    for position in lattice.positions_enu_m[clear[tuple(world.grid.index(lattice.positions_enu_m).T)]]:
        seen |= world.voxels(position, rays, world.stops(position, rays)[:, None])
    return seen & (world.solid == 1) & in_box


def distances(world: World, lattice: Lattice, position: NDArray[np.float64]) -> NDArray[np.float64]:
    """(p,) straight distances to the lattice positions joined to this one through known free space, else inf."""
    clear = ndimage.distance_transform_edt(world.grid.state == FREE) * VOXEL_M > CLEARANCE_M
    part = ndimage.label(clear)[0]
    at = part[tuple(world.grid.index(lattice.positions_enu_m).T)]
    here = part[tuple(world.grid.index(position))]
    straight = np.linalg.norm(lattice.positions_enu_m - position, axis=1)
    return np.where((at == here) & (at > 0) & (straight > 0.1), straight, np.inf)


def start(vehicles: int) -> tuple[World, list[NDArray[np.float64]]]:
    """Vehicles hover beside each other; the air around them is known free, and each has taken four pictures."""
    world, positions = World(), []
    for v in range(vehicles):
        position = np.array([-14.0, -10.0 + 6.0 * v, 3.0])
        near = world.grid.index(np.array([position - 2.0, position + 2.0]))
        world.grid.state[tuple(slice(a, b) for a, b in near.T)] = FREE
        for yaw in (-1.5, 0.0, 1.5, 3.0):
            world.take_picture(Pose(tuple(position), yaw, 0.0))
        positions.append(position)
    return world, positions


def pays(gains_m2: list[float], legs_m: list[float]) -> bool:
    return max(gains_m2) >= LEAST_GAIN_M2


def decide(world: World, lattice: Lattice, positions: list[NDArray[np.float64]], asking: int, claimed: list[Pose],
           taken: NDArray[np.bool_]) -> list[Plan]:
    way = distances(world, lattice, positions[asking])
    for pose in claimed:
        apart = np.linalg.norm(lattice.positions_enu_m - np.array(pose.position_enu_m), axis=1)
        way[apart < SPEC.separation_m] = np.inf
    return plan_views(world.imagined(claimed), lattice, SENSOR, RANGE_M, [Asker(asking, way)],
                      np.where(taken, 0.0, 0.5), SPEC, pays)


def explore(lattice: Lattice, vehicles: int, decisions: int) -> list[NDArray[np.bool_]]:
    """Known surface after each decision; vehicles decide in turn, each while the others are on their way."""
    world, positions = start(vehicles)
    taken = np.zeros((len(lattice.positions_enu_m), len(lattice.yaw_enu_rad)), dtype=np.bool_)
    flying: dict[int, Pose] = {}
    curve = []
    for n in range(decisions):
        v = n % vehicles
        if v in flying:
            pose = flying.pop(v)
            world.take_picture(pose)
            positions[v] = np.array(pose.position_enu_m)
        for plan in decide(world, lattice, positions, v, list(flying.values()), taken):
            flying[v] = lattice.pose(*plan.views[0])
            taken[plan.views[0]] = True
        curve.append(world.grid.state == OCCUPIED)
    return curve


def random_walk(lattice: Lattice, decisions: int, seed: int) -> list[NDArray[np.bool_]]:
    world, (position,) = start(1)
    rng = np.random.default_rng(seed)
    curve = []
    for _ in range(decisions):
        way = distances(world, lattice, position)
        near = np.flatnonzero(way <= max(8.0, way.min()))
        if len(near):
            pose = lattice.pose(int(rng.choice(near)), int(rng.integers(len(lattice.yaw_enu_rad))))
            world.take_picture(pose)
            position = np.array(pose.position_enu_m)
        curve.append(world.grid.state == OCCUPIED)
    return curve


@pytest.fixture(scope="module")
def lattice() -> Lattice:
    return build_lattice(CAMERA_MIN, CAMERA_MAX, ExploreSpec(lattice_step_m=4.0))


@pytest.fixture(scope="module")
def ceiling(lattice: Lattice) -> NDArray[np.bool_]:
    return reachable_surface(lattice)


@pytest.fixture(scope="module")
def alone(lattice: Lattice, ceiling: NDArray[np.bool_]) -> NDArray[np.float64]:
    return share(explore(lattice, 1, DECISIONS), ceiling)


def share(curve: list[NDArray[np.bool_]], ceiling: NDArray[np.bool_]) -> NDArray[np.float64]:
    return np.array([(known & ceiling).sum() for known in curve]) / ceiling.sum()


def test_one_vehicle_finds_the_reachable_surface(alone: NDArray[np.float64]) -> None:
    assert alone[-1] >= 0.95


def test_search_beats_a_random_walk(lattice: Lattice, ceiling: NDArray[np.bool_], alone: NDArray[np.float64]) -> None:
    walks = [share(random_walk(lattice, DECISIONS, seed), ceiling).mean() for seed in range(2)]
    assert alone.mean() > 1.5 * max(walks)


def test_two_vehicles_lose_little_per_decision(lattice: Lattice, ceiling: NDArray[np.bool_],
                                               alone: NDArray[np.float64]) -> None:
    together = share(explore(lattice, 2, DECISIONS), ceiling)
    assert together[-1] >= 0.95
    assert together.mean() >= 0.93 * alone.mean()


def test_exploration_ends_where_everything_was_shown(lattice: Lattice) -> None:
    world, positions = start(1)
    world.grid.state[:] = np.where(world.solid == 1, OCCUPIED, FREE)
    way = distances(world, lattice, positions[0])
    shown = replace(world.imagined([]), unseen=np.zeros(world.solid.shape, dtype=np.uint8))
    found = plan_views(shown, lattice, SENSOR, RANGE_M, [Asker(0, way)], 0.5 * np.ones((len(way), 50)), SPEC, pays)
    assert found == []


def test_same_map_same_decisions(lattice: Lattice) -> None:
    first, second = (explore(lattice, 2, 6) for _ in range(2))
    assert all(np.array_equal(a, b) for a, b in zip(first, second, strict=True))
