"""One scene made ready for trials: the lattice, where vehicles can be, what each view truly sees."""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from missions.camera import Camera
from missions.errors import UserError
from missions.frames import Array
from missions.messages import SiteBrief
from missions.mission import SiteSpec
from missions.nbv_trial import TrialBrief
from missions.pose_lattice import AXIS_STEPS, UNREACHED, Index5, Indices, PoseLattice
from missions.scene_names import BUILT_IN, PREFIX
from missions.simulation import SceneSpec
from sim_bridge.nbv.clearance import distances, segments_clear
from sim_bridge.nbv.rules import Rules, lattice_of, sensing_range_m
from sim_bridge.nbv.visibility import Bits, count, seen_points
from sim_bridge.scenes.load import load_scene
from sim_bridge.scenes.scene import Scene
from sim_bridge.truth import Mask, Truth
from sim_bridge.verdict import reference_surface


@dataclass(frozen=True, eq=False)
class Arena:
    """A scene, its lattice and the truth about both. standable (p,): positions that keep the fleet's clearance and hang
    together by straight legs that keep its radius; open_edges (p, 6): those legs."""

    name: str
    scene: Scene
    rules: Rules
    truth: Truth
    lattice: PoseLattice
    camera: Camera
    points_enu_m: Array
    standable: Mask
    open_edges: NDArray[np.bool_]
    seen: Bits
    """(poses, words) reference points that each view sees; none from where nobody can stand."""

    @cached_property
    def steps(self) -> Indices:
        """(poses, 30) the lattice's steps as far as they are free of collisions."""
        return self.lattice.steps_along(self.open_edges)

    @cached_property
    def ceiling(self) -> float:
        """Share of the reference points that all views together see."""
        return self.share(np.bitwise_or.reduce(self.seen, axis=0))

    def share(self, covered: Bits) -> float:
        """Share of the reference points in a set."""
        return float(count(covered)) / len(self.points_enu_m)

    def starts(self, number: int, vehicles: int) -> list[Index5]:
        """The start poses of the vehicles of a run, at different positions; each sees some of the object.

        The first vehicle's depends on number alone, and differs from run to run.
        """
        good = np.flatnonzero(count(self.seen) > 0)
        first = self._random().permutation(good)
        others = self._random(number).permutation(good)
        order = np.concatenate([first[number:number + 1], others])
        _, at = np.unique(order // self.lattice.orientations, return_index=True)
        chosen = order[np.sort(at)][:vehicles]
        if number >= len(first) or len(chosen) < vehicles:
            raise UserError(f"{self.name}: there are not enough views of the object for start {number + 1} of "
                            f"{vehicles} vehicles; ask for fewer.")
        return [self.lattice.index(int(flat)) for flat in chosen]

    def step_before(self, start: Index5, number: int) -> Index5:
        """A random free neighbour, from which the vehicle comes to its start."""
        flat = self.lattice.flat(start)
        free = self.steps[flat][self.steps[flat] != UNREACHED]
        return self.lattice.index(int(self._random(number, flat).choice(free)))

    def brief(self, method: str, number: int, vehicles: int, options: dict[str, str]) -> TrialBrief:
        """What a method is told."""
        scene, rules, lattice = self.scene, self.rules, self.lattice
        return TrialBrief(method=method, seed=rules.seed + number, object_min_enu_m=scene.object_min_enu_m,
                          object_max_enu_m=scene.object_max_enu_m, ground_up_m=scene.ground_up_m,
                          camera_min_enu_m=lattice.lower_enu_m, camera_max_enu_m=lattice.upper_enu_m,
                          shape=lattice.shape, elevations_deg=lattice.elevations_deg, azimuths=lattice.azimuths,
                          camera=self.camera, sensing_range_m=sensing_range_m(scene),
                          frames_per_step=rules.frames_per_step, starts=self.starts(number, vehicles),
                          poses=rules.poses, fleet=rules.fleet, options=options)

    def _random(self, *numbers: int) -> np.random.Generator:
        return np.random.default_rng([self.rules.seed, zlib.crc32(self.name.encode()), *numbers])


def make_arena(scene_name: str, rules: Rules) -> Arena:
    """Load a scene by name or path and prepare it. The same arguments give the same arena. Raises UserError."""
    scene = load_scene(scene_spec(scene_name), SiteSpec())
    return arena_of(scene, scene_name, rules)


def scene_spec(name: str) -> SceneSpec:
    """A built-in structure or a family's scene by its name, everything else as a path."""
    named = name in BUILT_IN or name.startswith(PREFIX)
    return SceneSpec(name=name) if named else SceneSpec(path=name)


def arena_of(scene: Scene, name: str, rules: Rules) -> Arena:
    """Prepare a scene. Raises UserError."""
    truth, fleet = Truth(*scene.mesh()), rules.fleet
    lattice = lattice_of(scene, rules, lambda at: distances(truth, at) >= fleet.clearance_m)
    standable, edges = _standable(truth, lattice, fleet.clearance_m, fleet.radius_m)
    site = SiteBrief(object_min_enu_m=scene.object_min_enu_m, object_max_enu_m=scene.object_max_enu_m,
                     ground_up_m=scene.ground_up_m)
    points = reference_surface(scene, site, rules.points).points_enu_m
    camera = rules.camera.explore_camera()
    seen = seen_points(truth, lattice, standable, points, camera, sensing_range_m(scene))
    return Arena(name, scene, rules, truth, lattice, camera, points, standable, edges, seen)


def _standable(truth: Truth, lattice: PoseLattice, clearance_m: float,
               radius_m: float) -> tuple[Mask, NDArray[np.bool_]]:
    """(p,) the largest set of clear positions that free legs join, and (p, 6) those legs. What lies in a closed hall or
    in a solid does not hang together with the open."""
    at = lattice.positions_enu_m
    clear = distances(truth, at) >= clearance_m
    number = np.arange(len(at)).reshape(lattice.shape)
    edges = np.zeros((len(at), len(AXIS_STEPS)), dtype=np.bool_)
    legs = []
    for axis in range(3):
        a, b = (np.delete(number, end, axis=axis).ravel() for end in (-1, 0))
        free = clear[a] & clear[b]
        free[free] = segments_clear(truth, at[a[free]], at[b[free]], radius_m)
        edges[b[free], 2 * axis] = edges[a[free], 2 * axis + 1] = True
        legs.append(np.stack([a[free], b[free]]))
    start, end = np.concatenate(legs, axis=1)
    graph = coo_matrix((np.ones(len(start)), (start, end)), shape=(len(at), len(at)))
    _, group = connected_components(graph, directed=False)
    standable = clear & (group == np.bincount(group[clear]).argmax())
    return standable, edges & standable[:, None]
