"""Walks that imagination is trained on: around scaled and turned scenes, over the lattice of trials, with true depth.

Some vehicles wander, others go where they see the most that is new, so that maps come as unfinished as they are under
good planning and under bad.
"""

from __future__ import annotations

import itertools
import math
import zlib
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from missions.camera import Camera, Pose
from missions.frames import Array, wrap_pi
from missions.mission import CameraSpec, SiteSpec
from missions.pose_lattice import UNREACHED, PoseLattice
from missions.simulation import RenderSpec
from missions.training_walks import SUFFIX, TrainingWalk
from sim_bridge.nbv.arena import scene_spec
from sim_bridge.nbv.clearance import distances, segments_clear
from sim_bridge.nbv.rules import Rules, lattice_of, sensing_range_m
from sim_bridge.render.renderer import make_renderer
from sim_bridge.scenes.load import load_scene
from sim_bridge.scenes.scene import Scene, merged
from sim_bridge.truth import BEFORE_FLIGHT_NS, Mask, Truth

RANGE_M = 25.0
RIM_M = 3.0
"""How far the voxels reach beyond lattice and object."""
KEY_POSES = 64
FRAME_PX, PREVIEW_PX = (114, 64), (38, 21)
SCALES, VOXELS_M = (0.8, 1.25), (0.4, 0.5, 0.5, 0.6)
FLEETS, CURIOSITIES = (1, 1, 4), (0.0, 0.6, 0.95)
LARGEST_BLOCK = 16
CORNERS = np.array(list(itertools.product((0, 1), repeat=3)))


@dataclass(frozen=True, eq=False)
class Stage:
    """A scene ready to be walked around: truth, lattice, voxels."""

    name: str
    scene: Scene
    truth: Truth
    lattice: PoseLattice
    camera: Camera
    frames_per_step: int
    clearance_m: float
    radius_m: float
    origin_enu_m: Array
    voxel_m: float
    surface: Mask
    solid: Mask

    def free(self, flat: int, ahead: NDArray[np.int64]) -> NDArray[np.int64]:
        """Those of the poses ahead that a straight leg from pose flat reaches."""
        at = self.lattice.positions_enu_m
        here, there = flat // self.lattice.orientations, ahead // self.lattice.orientations
        starts = np.broadcast_to(at[here], (len(ahead), 3))
        ok = distances(self.truth, at[there]) >= self.clearance_m
        ok[ok] = segments_clear(self.truth, starts[ok], at[there[ok]], self.radius_m)
        result: NDArray[np.int64] = ahead[ok]
        return result

    def shows(self, flat: int) -> NDArray[np.int64]:
        """Flat numbers of the surface voxels in the object's box that a picture at this pose hits, roughly."""
        camera, pose = self.camera.scaled(*PREVIEW_PX), self.lattice.pose(self.lattice.index(flat))
        rays = camera.rays_camera().reshape(-1, 3)
        depth = self.truth.depth(camera, pose, BEFORE_FLIGHT_NS).reshape(-1, 1)
        near = depth[:, 0] * np.linalg.norm(rays, axis=1) <= RANGE_M
        points = np.array(pose.position_enu_m) + (rays[near] * depth[near]) @ pose.enu_from_camera.T
        low, high = np.array(self.scene.object_min_enu_m), np.array(self.scene.object_max_enu_m)
        low[2] = max(low[2], self.scene.ground_up_m + self.voxel_m)
        points = points[((points >= low) & (points <= high)).all(axis=1)]
        index = ((points - self.origin_enu_m) / self.voxel_m).astype(np.int64)
        result: NDArray[np.int64] = np.unique(np.ravel_multi_index(tuple(index.T), self.solid.shape))
        return result


def write_walks(name: str, folder: Path, walks: int, seed: int, pictures: bool = False) -> list[Path]:
    """Walk around one scene, each time with other size, turn, voxels and vehicles; the files written."""
    scene, paths = load_scene(scene_spec(name), SiteSpec()), []
    for number in range(walks):
        rng = np.random.default_rng([seed, zlib.crc32(name.encode()), number])
        stage = make_stage(name, scene, rng)
        walk = take_walk(stage, int(rng.choice(FLEETS)), float(rng.choice(CURIOSITIES)), KEY_POSES, rng)
        if pictures:
            walk = replace(walk, rgb=_pictures(stage, walk, seed))
        paths.append(folder / f"{Path(name).name.replace(':', '_')}_{seed}_{number}{SUFFIX}")
        walk.save(paths[-1])
    return paths


def make_stage(name: str, scene: Scene, rng: np.random.Generator, rules: Rules | None = None) -> Stage:
    """A scene in the size in which it is sensed RANGE_M far, about, turned in half of the cases. Raises UserError."""
    rules = rules or Rules()
    scale = RANGE_M / sensing_range_m(scene)
    turn_rad = float(rng.uniform(0.0, 2.0 * math.pi)) if rng.random() < 0.5 else 0.0
    scene = changed(scene, turn_rad, scale * float(np.exp(rng.uniform(*np.log(SCALES)))))
    truth, clearance_m = Truth(*scene.mesh()), scale * rules.fleet.clearance_m
    lattice = lattice_of(scene, rules, lambda at: distances(truth, at) >= clearance_m)
    lower = np.minimum(scene.object_min_enu_m, lattice.lower_enu_m) - RIM_M
    upper = np.maximum(scene.object_max_enu_m, lattice.upper_enu_m) + RIM_M
    voxel_m = float(rng.choice(VOXELS_M))
    surface = surface_voxels(truth, lower, upper, voxel_m)
    camera = rules.camera.explore_camera().scaled(*FRAME_PX)
    return Stage(name, scene, truth, lattice, camera, rules.frames_per_step, clearance_m, scale * rules.fleet.radius_m,
                 lower, voxel_m, surface, surface | sealed(surface))


def changed(scene: Scene, turn_rad: float, scale: float) -> Scene:
    """The scene turned about the vertical through the origin, and scaled."""
    c, s = math.cos(turn_rad), math.sin(turn_rad)
    turned = scale * np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    parts = [replace(p, vertices_enu_m=p.vertices_enu_m @ turned.T) for p in scene.parts]
    vertices, _ = merged(p for p in parts if p.is_object)
    (a, b, e), (f, g, h) = vertices.min(axis=0), vertices.max(axis=0)
    return replace(scene, parts=parts, object_min_enu_m=(float(a), float(b), float(e)),
                   object_max_enu_m=(float(f), float(g), float(h)), ground_up_m=scale * scene.ground_up_m)


def surface_voxels(truth: Truth, lower_enu_m: Array, upper_enu_m: Array, voxel_m: float) -> Mask:
    """(i, j, k) voxels with surface within half a voxel of their middle, found by halving blocks that come near some.

    Surface so drawn has no holes: no chain of face neighbours leads through it.
    """
    shape = np.ceil((upper_enu_m - lower_enu_m) / voxel_m).astype(int)
    edge = LARGEST_BLOCK
    first = np.stack(np.meshgrid(*(np.arange(0, n, edge) for n in shape), indexing="ij"), axis=-1).reshape(-1, 3)
    while True:
        to_corner = 0.5 * math.sqrt(3.0) * (edge - 1)
        near = distances(truth, lower_enu_m + (first + 0.5 * edge) * voxel_m) <= (0.5 + to_corner) * voxel_m
        first = first[near]
        if edge == 1:
            break
        edge //= 2
        first = (first[:, None] + edge * CORNERS).reshape(-1, 3)
    result = np.zeros(shape, dtype=np.bool_)
    first = first[(first < shape).all(axis=1)]
    result[tuple(first.T)] = True
    return result


def sealed(surface: Mask) -> Mask:
    """(i, j, k) voxels that surface cuts off from the sky: the insides of bodies, closed halls, the ground."""
    group, _ = ndimage.label(~surface)
    result: Mask = ~np.isin(group, np.setdiff1d(group[:, :, -1], [0]))
    return result


def take_walk(stage: Stage, vehicles: int, curiosity: float, key_poses: int, rng: np.random.Generator) -> TrainingWalk:
    """Vehicles take turns; each step is with probability `curiosity` the one that shows the most new surface, among
    the free neighbours, else a random one of those that show something."""
    lattice = stage.lattice
    at, fresh = _starts(stage, vehicles, rng), np.ones(stage.solid.size, dtype=np.bool_)
    shots = [(lattice.pose(lattice.index(flat)), k + 1) for k, flat in enumerate(at)]
    for flat in at:
        fresh[stage.shows(flat)] = False
    for taken in range(vehicles, key_poses):
        turn = taken % vehicles
        ahead = lattice.steps[at[turn]]
        ahead = stage.free(at[turn], ahead[ahead != UNREACHED])
        if not len(ahead):
            continue
        new = [stage.shows(int(flat)) for flat in ahead]
        worth = np.array([fresh[v].sum() for v in new])
        showing = np.flatnonzero([len(v) > 0 for v in new])
        greedy = rng.random() < curiosity and worth.any()
        k = int(worth.argmax()) if greedy else int(rng.choice(showing if len(showing) else len(ahead)))
        shots += _leg(lattice, at[turn], int(ahead[k]), stage.frames_per_step, taken)
        at[turn] = int(ahead[k])
        fresh[new[k]] = False
    return _record(stage, shots)


def _starts(stage: Stage, vehicles: int, rng: np.random.Generator) -> list[int]:
    """Poses in the open that show something of the object."""
    lattice = stage.lattice
    index = ((lattice.positions_enu_m - stage.origin_enu_m) / stage.voxel_m).astype(int)
    open_air = (distances(stage.truth, lattice.positions_enu_m) >= stage.clearance_m) & ~stage.solid[tuple(index.T)]
    found: list[int] = []
    for flat in rng.permutation(len(lattice)):
        if open_air[flat // lattice.orientations] and len(stage.shows(int(flat))):
            found.append(int(flat))
            if len(found) == vehicles:
                break
    return found


def _leg(lattice: PoseLattice, start: int, goal: int, frames: int, taken: int) -> list[tuple[Pose, int]]:
    """Poses spread over a move, the goal last, with the number of key poses taken by then."""
    a, b = (lattice.pose(lattice.index(flat)) for flat in (start, goal))
    p, q = np.array(a.position_enu_m), np.array(b.position_enu_m)
    turn = wrap_pi(b.yaw_enu_rad - a.yaw_enu_rad)
    shots = []
    for n in range(1, frames + 1):
        f = n / frames
        x, y, z = (float(v) for v in p + f * (q - p))
        elevation = a.elevation_rad + f * (b.elevation_rad - a.elevation_rad)
        shots.append((Pose((x, y, z), wrap_pi(a.yaw_enu_rad + f * turn), elevation), taken + (n == frames)))
    return shots


def _pictures(stage: Stage, walk: TrainingWalk, seed: int) -> NDArray[np.uint8]:
    """(n, 2 h, 2 w, 3) what the walk's cameras show."""
    camera = walk.camera.scaled(2 * walk.camera.width_px, 2 * walk.camera.height_px)
    renderer = make_renderer(stage.scene, RenderSpec(), CameraSpec(), seed)
    rgb = np.stack([renderer.render(camera, walk.pose(n), [], n) for n in range(len(walk.poses))])
    renderer.close()
    return rgb


def _record(stage: Stage, shots: list[tuple[Pose, int]]) -> TrainingWalk:
    depth = np.stack([stage.truth.depth(stage.camera, pose, BEFORE_FLIGHT_NS) for pose, _ in shots])
    poses = np.array([[*p.position_enu_m, p.yaw_enu_rad, p.elevation_rad] for p, _ in shots])
    scene = stage.scene
    return TrainingWalk(stage.name, stage.camera, np.array(scene.object_min_enu_m), np.array(scene.object_max_enu_m),
                        scene.ground_up_m, stage.origin_enu_m, stage.voxel_m, stage.solid, poses,
                        np.array([n for _, n in shots]), depth.astype(np.float16))
