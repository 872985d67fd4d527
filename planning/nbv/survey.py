"""Survey views for photogrammetry, planned on the explored map.

Greedy coverage of surface patches by pictures, as in view planning for multi-view stereo (Hoppe et al., CVWW 2012;
Roberts et al., ICCV 2017; Smith et al., SIGGRAPH Asia 2018): a patch wants several pictures, near the preferred
distance, head on, and with a parallax between them that triangulates well and still matches.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numba as nb
import numpy as np
from numpy.typing import NDArray

from missions.camera import Camera, Pose
from missions.frames import Array, forward_enu, wrap_pi
from missions.grid import VoxelGrid
from missions.mission import SurveySpec
from planning.nbv.lattice import in_view
from planning.nbv.patches import Patches, surface_patches
from planning.nbv.sightings import Sightings, SightSpec, find_sightings

BINS_PER_TURN = 120
PARALLAX_KEPT = 8
"""Pictures per patch whose directions are remembered for parallax."""


@dataclass(frozen=True)
class SurveyViewSpec:
    """What the survey's pictures must achieve together."""

    max_views: int = 160
    pictures_per_patch: int = 3
    sight: SightSpec = field(default_factory=SightSpec)
    parallax_deg: tuple[float, float] = (8.0, 30.0)
    patch_m: float = 0.9
    elevations_deg: tuple[float, ...] = (-60.0, -40.0, -20.0, 0.0, 20.0, 40.0, 60.0)
    azimuths: int = 12
    least_gain: float = 2.0
    """Planning ends when the next picture would add less than this (a patch's first sharp picture counts 1)."""


    @classmethod
    def of(cls, survey: SurveySpec) -> SurveyViewSpec:
        """What a mission file asks of its survey."""
        sight = SightSpec(survey.distance_m, 0.35 * survey.distance_m, 1.7 * survey.distance_m)
        return cls(survey.max_views, survey.pictures_per_patch, sight)


@dataclass(frozen=True)
class SurveyPlan:
    """Poses in the order they were chosen, and what they are predicted to cover."""

    poses: list[Pose]
    patches: Patches
    coverable: NDArray[np.bool_]
    """(k,) patches that any candidate sees."""
    pictures: NDArray[np.int64]
    """(k,) pictures that show each patch."""
    paired: NDArray[np.int64]
    """(k,) of these, pictures that have useful parallax to an earlier one."""

    def covered_share(self, pictures: int) -> float:
        """Share of the coverable patches shown by at least so many pictures; 1 when there are none."""
        return float((self.pictures[self.coverable] >= pictures).mean()) if self.coverable.any() else 1.0


def plan_survey(grid: VoxelGrid, positions_enu_m: Array, camera: Camera, object_min_enu_m: Array,
                object_max_enu_m: Array, spec: SurveyViewSpec) -> SurveyPlan:
    """Choose at most spec.max_views views from the given positions.

    positions_enu_m: (n, 3) positions that vehicles may hold: free with clearance, and reachable. The plan is empty
    when there is no surface in the box or no position. Ties go to the earlier candidate.
    """
    patches = surface_patches(grid, object_min_enu_m, object_max_enu_m, spec.patch_m)
    pictures, paired = np.zeros(len(patches), dtype=np.int64), np.zeros(len(patches), dtype=np.int64)
    if not len(patches) or not len(positions_enu_m):
        return SurveyPlan([], patches, np.zeros(len(patches), dtype=np.bool_), pictures, paired)
    sightings = find_sightings(grid, patches, positions_enu_m, spec.sight)
    yaw, elevation = _orientations(spec)
    chosen = _cover(sightings, len(patches), len(positions_enu_m), yaw, elevation, camera, spec, pictures, paired)
    coverable = np.bincount(sightings.patch, minlength=len(patches)) > 0
    poses = [Pose(tuple(float(c) for c in positions_enu_m[p]), float(yaw[o]), float(elevation[o]))  # type: ignore[arg-type]
             for p, o in chosen]
    return SurveyPlan(poses, patches, coverable, pictures, paired)


def _orientations(spec: SurveyViewSpec) -> tuple[Array, Array]:
    pairs = [(wrap_pi(2.0 * math.pi * a / spec.azimuths), math.radians(e))
             for e in spec.elevations_deg for a in range(spec.azimuths)]
    yaw, elevation = np.array(pairs).T
    return yaw, elevation


def _cover(sightings: Sightings, patches: int, positions: int, yaw: Array, elevation: Array, camera: Camera,
           spec: SurveyViewSpec, pictures: NDArray[np.int64], paired: NDArray[np.int64]) -> list[tuple[int, int]]:
    """(position, orientation) of the chosen views; fills pictures and paired."""
    shows = in_view(_bin_directions(), yaw, elevation, camera)
    first_view = np.concatenate([[0], np.cumsum(shows.sum(axis=1))])
    first_sighting = np.searchsorted(sightings.patch, np.arange(patches + 1))
    by_position = np.argsort(sightings.position, kind="stable")
    first_at = np.searchsorted(sightings.position[by_position], np.arange(positions + 1))
    low, high = (math.cos(math.radians(a)) for a in spec.parallax_deg)
    chosen = _greedy(sightings.patch, sightings.position, sightings.towards_position_enu, sightings.quality,
                     _direction_bin(-sightings.towards_position_enu), first_view, np.nonzero(shows)[1], shows,
                     first_sighting, by_position, first_at, low, high, spec.pictures_per_patch, spec.max_views,
                     spec.least_gain, pictures, paired)
    return [(int(p), int(o)) for p, o in chosen]


def _direction_bin(directions_enu: Array) -> NDArray[np.int64]:
    """Index of the 3-degree bin of yaw and elevation that a direction falls in."""
    yaw = np.arctan2(directions_enu[:, 1], directions_enu[:, 0]) % (2.0 * math.pi)
    elevation = np.arcsin(np.clip(directions_enu[:, 2], -1.0, 1.0)) + math.pi / 2.0
    scale = BINS_PER_TURN / (2.0 * math.pi)
    row = np.minimum((elevation * scale).astype(np.int64), BINS_PER_TURN // 2 - 1)
    return row * BINS_PER_TURN + np.minimum((yaw * scale).astype(np.int64), BINS_PER_TURN - 1)


def _bin_directions() -> Array:
    step = 2.0 * math.pi / BINS_PER_TURN
    return np.array([forward_enu((a + 0.5) * step, (e + 0.5) * step - math.pi / 2.0)
                     for e in range(BINS_PER_TURN // 2) for a in range(BINS_PER_TURN)])


@nb.njit(cache=True)
def _worth(had, wanted, near, far, directions, towards):  # type: ignore[no-untyped-def]
    """Worth of one more sharp picture of a patch that has `had`, by its best parallax to those.

    The first counts 1, each further one 0.9 of the one before, without useful parallax a fifth of that or less.
    near, far: cosines of the smallest and largest useful parallax.
    """
    if had >= wanted:
        return 0.0
    if had == 0:
        return 1.0
    best = 0.05
    for d in range(min(had, len(directions))):
        cosine = directions[d, 0] * towards[0] + directions[d, 1] * towards[1] + directions[d, 2] * towards[2]
        if far <= cosine <= near:
            best = 1.0
        elif cosine < far:
            best = max(best, 0.2)
    return 0.9**had * best


@nb.njit(cache=True)
def _greedy(patch, position, towards, quality, bin_of, first_view, views, shows,  # type: ignore[no-untyped-def]
            first_sighting, by_position, first_at, near, far, wanted, max_views, least, pictures, paired):
    """Exact greedy: after each choice only the sightings of the patches it shows are valued anew."""
    gains = np.zeros((len(first_at) - 1, shows.shape[1]))
    value = quality.copy()
    for s in range(len(patch)):
        for at in range(first_view[bin_of[s]], first_view[bin_of[s] + 1]):
            gains[position[s], views[at]] += value[s]
    directions = np.zeros((len(pictures), PARALLAX_KEPT, 3))
    chosen = np.zeros((max_views, 2), dtype=np.int64)
    for n in range(max_views):
        best = np.argmax(gains)
        p, o = best // gains.shape[1], best % gains.shape[1]
        if gains[p, o] < least:
            return chosen[:n]
        chosen[n, 0], chosen[n, 1] = p, o
        for q in range(first_at[p], first_at[p + 1]):
            s = by_position[q]
            if not shows[bin_of[s], o]:
                continue
            k = patch[s]
            had = pictures[k]
            if had > 0 and _worth(had, had + 1, near, far, directions[k], towards[s]) > 0.5 * 0.9**had:
                paired[k] += 1
            if had < PARALLAX_KEPT:
                directions[k, had] = towards[s]
            pictures[k] += 1
            for other in range(first_sighting[k], first_sighting[k + 1]):
                worth = quality[other] * _worth(pictures[k], wanted, near, far, directions[k], towards[other])
                change = worth - value[other]
                value[other] = worth
                if change != 0.0:
                    for at in range(first_view[bin_of[other]], first_view[bin_of[other] + 1]):
                        gains[position[other], views[at]] += change
    return chosen
