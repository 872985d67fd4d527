"""Survey views for photogrammetry, planned on the explored map.

Greedy coverage of surface patches by pictures, as in view planning for multi-view stereo (Hoppe et al., CVWW 2012;
Roberts et al., ICCV 2017; Smith et al., SIGGRAPH Asia 2018): a patch wants several pictures, at the resolution asked
for, and with a parallax between them that triangulates well and still matches.

Constants were chosen on recorded maps of the built-in structures by the share of the true surface that at least three
pictures show within 80 degrees of its normal, each with a partner 5 to 35 degrees aside: on a flown bridge, 93 % of
that surface was reconstructed within 0.25 m, and 50 % of surface without such pictures.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from missions.camera import Camera, Pose
from missions.frames import Array, forward_enu, wrap_pi
from missions.grid import OCCUPIED, VoxelGrid
from missions.mission import SurveySpec
from planning.nbv.cover_kernels import PARALLAX_KEPT, Known, Rows, Sight, Tally, Want, begin, choose, take
from planning.nbv.interest import Interest
from planning.nbv.lattice import in_view
from planning.nbv.patches import Patches, surface_patches
from planning.nbv.sightings import Sightings, SightSpec, find_sightings
from planning.nbv.standoff import RAYS_PX, REACH_M

BINS_PER_TURN = 120
SPARE_PICTURES = 2
"""Pictures beyond those asked for that a patch still gains from: one sighting in twelve on a map of voxels is wrong."""
NEAR_M = 2.0
"""Nearer to a chosen view than this nothing is saved any more. Turning costs time, too, and pictures from one place
have no base between them and agree on their mistakes: a bridge flown with many of them had ten times as many points
more than half a metre off.
"""
THRIFT = 0.2
"""Exponent of the way from the nearest chosen view in what a view costs. 0 looks at gains alone; 0.2 makes the tours
8 % shorter at the same coverage."""


@dataclass(frozen=True)
class SurveyViewSpec:
    """What the survey's pictures must achieve together."""

    max_views: int = 160
    pictures_per_patch: int = 3
    sight: SightSpec = field(default_factory=SightSpec)
    gsd_m: float = 0.01
    """Metres of surface per pixel that are asked for; pictures that show a patch coarser count as much less."""
    parallax_deg: tuple[float, float] = (10.0, 30.0)
    """Between a picture and its best partner: less measures depth badly, more looks too different to be matched."""
    patch_m: float = 0.9
    elevations_deg: tuple[float, ...] = (-75.0, -60.0, -45.0, -30.0, -15.0, 0.0, 15.0, 30.0, 45.0, 60.0, 75.0)
    azimuths: int = 18
    """Steps of 15 by 20 degrees, a third of the picture."""
    thrift: float = THRIFT
    least_held: float = 0.15
    """Share of a picture that must show known surface, of the object or around it: a picture of wires before the sky
    has nothing that says where it was taken, and lines that are a pixel off tell nothing of the wires either."""
    least_gain: float = 2.0
    """Planning ends when the next picture would add less than this (a patch's first sharp picture counts 1)."""
    interest: Interest | None = None
    """Where pictures count more than elsewhere."""

    @classmethod
    def of(cls, survey: SurveySpec) -> SurveyViewSpec:
        """What a mission file asks of its survey."""
        sight = SightSpec(0.35 * survey.distance_m, 1.7 * survey.distance_m)
        return cls(survey.max_views, survey.pictures_per_patch, sight, survey.gsd_m)


@dataclass(frozen=True)
class SurveyPlan:
    """Poses in the order they were chosen, and what they and the pictures taken before are predicted to cover."""

    poses: list[Pose]
    patches: Patches
    coverable: NDArray[np.bool_]
    """(k,) patches that any candidate, or a picture taken before, sees."""
    pictures: NDArray[np.int64]
    """(k,) pictures that show each patch."""
    paired: NDArray[np.int64]
    """(k,) of these, pictures that have useful parallax to an earlier one."""

    def covered_share(self, pictures: int) -> float:
        """Share of the coverable patches shown by at least so many pictures; 1 when there are none."""
        return float((self.pictures[self.coverable] >= pictures).mean()) if self.coverable.any() else 1.0


def plan_survey(grid: VoxelGrid, positions_enu_m: Array, camera: Camera, object_min_enu_m: Array,
                object_max_enu_m: Array, spec: SurveyViewSpec, taken: Sequence[Pose] = ()) -> SurveyPlan:
    """Choose at most spec.max_views views from the given positions, beside pictures that were taken before.

    positions_enu_m: (n, 3) positions that vehicles may hold: free with clearance, and reachable. Without positions, or
    with no surface in the box, nothing is chosen. Ties go to the earlier candidate.
    """
    patches = surface_patches(grid, object_min_enu_m, object_max_enu_m, spec.patch_m)
    places = np.concatenate([positions_enu_m, np.array([p.position_enu_m for p in taken]).reshape(-1, 3)])
    if not len(patches) or not len(places):
        none = np.zeros(len(patches), dtype=np.int64)
        return SurveyPlan([], patches, none.astype(np.bool_), none, none)
    yaw, elevation = _orientations(spec)
    shows = _shows(yaw, elevation, camera)
    found = find_sightings(grid, patches, places, spec.sight, spec.gsd_m * camera.fx_px)
    if spec.interest is not None:
        found = replace(found, quality=found.quality * spec.interest.weights_at(patches.position_enu_m)[found.patch])
    sight = _sight(found, len(patches), len(places), shows)
    want, tally = _want(spec), _tally(sight, len(patches), (len(positions_enu_m), len(yaw)))
    begin(sight, tally)
    for n, pose in enumerate(taken):
        shown = _shows(np.array([pose.yaw_enu_rad]), np.array([pose.elevation_rad]), camera)[0]
        take(sight, want, tally, len(positions_enu_m) + n, shown)
    known = _known(grid, positions_enu_m, yaw, elevation, camera, spec.least_held)
    chosen = choose(sight, want, known, tally, shows, places, NEAR_M, spec.thrift, spec.max_views, spec.least_gain)
    poses = [Pose(tuple(float(c) for c in places[p]), float(yaw[o]), float(elevation[o]))  # type: ignore[arg-type]
             for p, o in chosen]
    return SurveyPlan(poses, patches, np.diff(sight.first_of_patch) > 0, tally.pictures, tally.paired)


def _orientations(spec: SurveyViewSpec) -> tuple[Array, Array]:
    pairs = [(wrap_pi(2.0 * math.pi * a / spec.azimuths), math.radians(e))
             for e in spec.elevations_deg for a in range(spec.azimuths)]
    yaw, elevation = np.array(pairs).T
    return yaw, elevation


def _shows(yaw_enu_rad: Array, elevation_rad: Array, camera: Camera) -> NDArray[np.bool_]:
    """(o, b) whether each bin of directions lies in the picture of each orientation."""
    return np.ascontiguousarray(in_view(_bin_directions(), yaw_enu_rad, elevation_rad, camera).T)


def _sight(found: Sightings, patches: int, places: int, shows: NDArray[np.bool_]) -> Sight:
    by_position = np.argsort(found.position, kind="stable")
    bins, views = np.nonzero(shows.T)
    return Sight(found.patch, found.position, found.towards_position_enu, found.quality,
                 _direction_bin(-found.towards_position_enu), np.searchsorted(found.patch, np.arange(patches + 1)),
                 by_position, np.searchsorted(found.position[by_position], np.arange(places + 1)),
                 np.searchsorted(bins, np.arange(shows.shape[1] + 1)), views)


def _want(spec: SurveyViewSpec) -> Want:
    near, far = (math.cos(math.radians(a)) for a in spec.parallax_deg)
    return Want(spec.pictures_per_patch, spec.pictures_per_patch + SPARE_PICTURES, near, far)


def _known(grid: VoxelGrid, positions_enu_m: Array, yaw_enu_rad: Array, elevation_rad: Array, camera: Camera,
           least_held: float) -> Known:
    rays = camera.scaled(*RAYS_PX).rays_camera().reshape(-1, 3)
    rays /= np.linalg.norm(rays, axis=1)[:, None]
    turns = [Pose((0.0, 0.0, 0.0), float(y), float(e)).enu_from_camera
             for y, e in zip(yaw_enu_rad, elevation_rad, strict=True)]
    return Known(grid.state, OCCUPIED, (positions_enu_m - grid.origin_enu_m) / grid.voxel_m,
                 np.array([rays @ turn.T for turn in turns]), REACH_M / grid.voxel_m, math.ceil(least_held * len(rays)))


def _tally(sight: Sight, patches: int, views: tuple[int, int]) -> Tally:
    """Before any picture."""
    none = np.zeros(patches, dtype=np.int64)
    return Tally(none, none.copy(), np.zeros((patches, PARALLAX_KEPT, 3)), np.zeros(len(sight.patch)), np.zeros(views))


def _direction_bin(directions_enu: Array) -> Rows:
    """Index of the 3-degree bin of yaw and elevation that a direction falls in."""
    yaw = np.arctan2(directions_enu[:, 1], directions_enu[:, 0]) % (2.0 * math.pi)
    elevation = np.arcsin(np.clip(directions_enu[:, 2], -1.0, 1.0)) + math.pi / 2.0
    scale = BINS_PER_TURN / (2.0 * math.pi)
    row = np.minimum((elevation * scale).astype(np.int64), BINS_PER_TURN // 2 - 1)
    return row * BINS_PER_TURN + np.minimum((yaw * scale).astype(np.int64), BINS_PER_TURN - 1)


@cache
def _bin_directions() -> Array:
    step = 2.0 * math.pi / BINS_PER_TURN
    return np.array([forward_enu((a + 0.5) * step, (e + 0.5) * step - math.pi / 2.0)
                     for e in range(BINS_PER_TURN // 2) for a in range(BINS_PER_TURN)])
