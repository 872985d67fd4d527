"""Walks over the view lattice with pictures, poses and true depth, for `swarmscan bench depth` and `bench wires`.

A walk moves as exploration does: one lattice step at a time, pictures spread along each move, the last one the key
view. Where it goes is drawn at random among the neighbours that see the object, so that no method is favoured.
"""

from __future__ import annotations

import argparse
import itertools
import logging
import math
import sys
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray

from missions.camera import Camera, Pose
from missions.errors import UserError
from missions.frames import wrap_pi
from missions.messages import SiteBrief
from missions.mission import Mission
from missions.pads import camera_bounds
from missions.process import run_process
from missions.simulation import SceneSpec
from missions.walks import Shot, Walks, truth_path, walks_path
from sim_bridge.render import make_renderer
from sim_bridge.render.sensor import encode_jpeg
from sim_bridge.scenes.load import load_scene
from sim_bridge.scenes.scene import Scene, merged
from sim_bridge.truth import BEFORE_FLIGHT_NS, Truth
from sim_bridge.wire_points import empty_points, wire_points

log = logging.getLogger(__name__)

MIN_SHARE = 0.15
"""Share of a view's pixels that show the object within the sensing range, where a neighbour has so many."""
PREVIEW_PX = (57, 32)
DRAWS = 4000
SAME_M = 1e-3

Index = tuple[int, int, int, int, int]


class Walker:
    """Draws collision-free walks in one scene, knowing the truth."""

    def __init__(self, scene: Scene, mission: Mission) -> None:
        site = SiteBrief(object_min_enu_m=scene.object_min_enu_m, object_max_enu_m=scene.object_max_enu_m,
                         ground_up_m=scene.ground_up_m)
        self._mission, explore = mission, mission.explore
        self._lower, upper = camera_bounds(mission, site)
        extent = upper - self._lower
        self._cells = np.maximum(1, np.round(extent / explore.lattice_step_m)).astype(int)
        self._step = extent / self._cells
        self.world, self.object = Truth(*scene.mesh()), Truth(*scene.object_mesh())
        self._preview = mission.camera.explore_camera().scaled(*PREVIEW_PX)

    def walk(self, number: int, moves: int, rng: np.random.Generator) -> list[Shot]:
        """The pictures of one walk: a first key view, then `frames_per_leg` per move. Raises UserError."""
        at = self._start(rng)
        visited, shots = {at}, [Shot(number, self._pose(at), True)]
        for _ in range(moves):
            choices = [n for n in self._neighbours(at) if n not in visited and self._clear(at, n)]
            if not choices:
                break
            share = np.array([self._share(self._pose(n)) for n in choices])
            good = np.flatnonzero(share >= MIN_SHARE)
            to = choices[int(rng.choice(good)) if len(good) else int(share.argmax())]
            shots += self._leg(number, self._pose(at), self._pose(to))
            visited.add(to)
            at = to
        return shots

    def _start(self, rng: np.random.Generator) -> Index:
        explore = self._mission.explore
        sizes = (*self._cells, len(explore.elevations_deg), explore.azimuths)
        for _ in range(DRAWS):
            x, y, z, e, a = (int(rng.integers(n)) for n in sizes)
            at = (x, y, z, e, a)
            if self._clear(at, at) and self._share(self._pose(at)) >= MIN_SHARE:
                return at
        raise UserError("no view of the lattice shows enough of the object; enlarge site.camera_margin_m.")

    def _neighbours(self, at: Index) -> Iterator[Index]:
        """One cell along one axis, and at most one step of elevation or azimuth, as in MACARONS."""
        explore = self._mission.explore
        turns = [(0, 0), (1, 0), (-1, 0), (0, 1), (0, -1)]
        for (axis, sign), (de, da) in itertools.product(itertools.product(range(3), (1, -1)), turns):
            cell = [*at[:3]]
            cell[axis] += sign
            e = at[3] + de
            if 0 <= cell[axis] < self._cells[axis] and 0 <= e < len(explore.elevations_deg):
                yield cell[0], cell[1], cell[2], e, (at[4] + da) % explore.azimuths

    def _pose(self, at: Index) -> Pose:
        explore = self._mission.explore
        x, y, z = (float(c) for c in self._lower + (np.array(at[:3]) + 0.5) * self._step)
        return Pose((x, y, z), wrap_pi(2.0 * math.pi * at[4] / explore.azimuths),
                    math.radians(explore.elevations_deg[at[3]]))

    def _leg(self, number: int, start: Pose, goal: Pose) -> list[Shot]:
        a, b = np.array(start.position_enu_m), np.array(goal.position_enu_m)
        frames = self._mission.explore.frames_per_leg
        turn = wrap_pi(goal.yaw_enu_rad - start.yaw_enu_rad)
        shots = []
        for f in [(k + 1) / frames for k in range(frames)]:
            x, y, z = (float(c) for c in a + f * (b - a))
            elevation = start.elevation_rad + f * (goal.elevation_rad - start.elevation_rad)
            shots.append(Shot(number, Pose((x, y, z), wrap_pi(start.yaw_enu_rad + f * turn), elevation), f == 1.0))
        return shots

    def _clear(self, a: Index, b: Index) -> bool:
        start, end = (np.array(self._pose(i).position_enu_m) for i in (a, b))
        along = np.linspace(start, end, 9)
        far = self.world.distance(along, np.full(len(along), BEFORE_FLIGHT_NS)) >= self._mission.fleet.clearance_m
        return bool(far.all() and not self.world.inside(along[-1:]).any())

    def _share(self, pose: Pose) -> float:
        depth = self.world.depth(self._preview, pose, BEFORE_FLIGHT_NS)
        own = self.object.depth(self._preview, pose, BEFORE_FLIGHT_NS)
        distance = depth * np.linalg.norm(self._preview.rays_camera(), axis=-1)
        return float(((distance <= self._mission.explore.sensing_range_m) & (own <= depth + SAME_M)).mean())


def write_walks(name: str, folder: Path, walks: int, moves: int, seed: int) -> None:
    """Walk one scene, named or given as a file; write its pictures with poses, and apart from them the truth."""
    given = SceneSpec(path=name) if Path(name).exists() else SceneSpec(name=name)
    mission = Mission(title="depth", scene=given)
    scene = load_scene(mission.scene, mission.site)
    walker, camera = Walker(scene, mission), mission.camera.explore_camera()
    rng = np.random.default_rng([seed, zlib.crc32(Path(name).name.encode())])
    shots = [shot for number in range(walks) for shot in walker.walk(number, moves, rng)]
    renderer = make_renderer(scene, mission.render, mission.camera, seed)
    quality = mission.camera.jpeg_quality
    jpegs = [encode_jpeg(renderer.render(camera, shot.pose, [], i), quality) for i, shot in enumerate(shots)]
    renderer.close()
    record = Walks(name, camera, mission.explore.sensing_range_m, shots, jpegs)
    walks_path(folder, name).write_bytes(msgspec.msgpack.encode(record))
    water = [p for p in scene.parts if p.water]
    depth, own, wet = (np.stack([_depth(truth, camera, s.pose) for s in shots])
                       for truth in (walker.world, walker.object, Truth(*merged(water)) if water else None))
    seen = np.isfinite(depth)
    np.savez(truth_path(folder, name), depth_m=depth, on_object=seen & (own <= depth + SAME_M),
             on_water=seen & (wet <= depth + SAME_M), wires_enu_m=wire_points(scene, rng),
             empty_enu_m=empty_points(scene, walker.world, rng))


def _depth(truth: Truth | None, camera: Camera, pose: Pose) -> NDArray[np.float32]:
    """(h, w) depth of what there is; inf where there is nothing."""
    if truth is None:
        return np.full((camera.height_px, camera.width_px), np.inf, np.float32)
    return truth.depth(camera, pose, BEFORE_FLIGHT_NS).astype(np.float32)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m sim_bridge.depth_walks", description=__doc__)
    parser.add_argument("folder", type=Path, help="where the files go")
    parser.add_argument("--scenes", nargs="+", required=True, help="names of scenes, or files")
    parser.add_argument("--walks", type=int, default=2, help="walks per scene (default %(default)s)")
    parser.add_argument("--moves", type=int, default=7, help="lattice moves per walk (default %(default)s)")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args(argv)
    options.folder.mkdir(parents=True, exist_ok=True)
    for name in options.scenes:
        write_walks(name, options.folder, max(1, options.walks), max(1, options.moves), options.seed)
        log.info("walked %s", name)
    return 0


if __name__ == "__main__":
    sys.exit(run_process(main))
