"""Expected new surface of candidate views, in square metres.

A ray passes through free voxels; every other voxel stops it with a probability that depends on what is known about it,
and is then worth the area that the ray stands for: occlusion-aware volumetric information as in Isler et al.
(ICRA 2016) and Delmerico et al. (Autonomous Robots 2018). Unknown voxels that touch known surface are the likeliest
to be surface, because surfaces continue (their "proximity" and "rear side" terms; frontiers of Yamauchi, CIRA 1997).
A ray of solid angle w stands for min(d, d0)^2 * w of surface at distance d: near voxels hit by many rays are so
counted once, and beyond d0 resolution falls with (d0 / d)^2 as in MACARONS (Guédon et al., CVPR 2023).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from missions.camera import Camera, Pose
from missions.frames import Array
from missions.grid import FREE, OCCUPIED, UNKNOWN, SurfaceVoxels, VoxelGrid
from missions.sensors import fibonacci_directions
from planning.nbv.lattice import Lattice, in_view
from planning.nbv.rays import mark_rays, view_gains

RAYS = 2048
PASSED, OUTSIDE, PASSAGE, INSIDE, FRONTIER, SEEN_ONCE, SEEN_TWICE, SOLID = range(8)
KINDS = 8
LOOKS_MAX = 7


@dataclass(frozen=True)
class GainSpec:
    """How likely unknown space is to be surface, and what seeing it is worth."""

    unknown_per_m: float = 0.12
    """Chance per metre that unknown space inside the object's box stops a ray."""
    outside_per_m: float = 0.03
    """The same outside the box, where nothing is gained."""
    frontier_chance: float = 0.5
    """Chance that an unknown voxel beside known surface is surface."""
    unknown_value: float = 0.6
    """Worth of a square metre that is expected in open unknown space, where no surface is near."""
    passage_value: float = 0.02
    """Worth of a square metre across unknown space outside the box where cameras may stand: it opens the way."""
    again_value: tuple[float, float] = (0.2, 0.1)
    """Worth of a square metre of surface that one picture, or two, have measured."""
    look_discount: float = 0.5
    """Factor for each earlier view that ought to have shown the voxel and did not settle it."""
    full_value_m: float = 12.0
    """d0: up to this distance a picture resolves the surface fully."""
    sensing_range_m: float = 25.0


@dataclass(frozen=True)
class GainField:
    """The map as rays read it: label = kind + KINDS * looks for every voxel, and the box in which views gain."""

    grid: VoxelGrid
    label: NDArray[np.uint8]
    lower_enu_m: Array
    upper_enu_m: Array
    spec: GainSpec

    @property
    def chance(self) -> Array:
        """(256,) probability that a voxel with this label stops a ray."""
        voxel, spec = self.grid.voxel_m, self.spec
        kinds = np.zeros(KINDS)
        kinds[[OUTSIDE, PASSAGE]] = 1.0 - math.exp(-spec.outside_per_m * voxel)
        kinds[INSIDE] = 1.0 - math.exp(-spec.unknown_per_m * voxel)
        kinds[FRONTIER] = spec.frontier_chance
        kinds[[SEEN_ONCE, SEEN_TWICE, SOLID]] = 1.0
        return np.resize(kinds, 256)

    @property
    def value(self) -> Array:
        """(256,) worth of a stopped ray by label; nothing once LOOKS_MAX is reached."""
        kinds = np.zeros(KINDS)
        kinds[PASSAGE], kinds[INSIDE], kinds[FRONTIER] = self.spec.passage_value, self.spec.unknown_value, 1.0
        kinds[SEEN_ONCE], kinds[SEEN_TWICE] = self.spec.again_value
        looks = self.spec.look_discount ** np.arange(256 // KINDS)
        looks[LOOKS_MAX:] = 0.0
        return np.outer(looks, kinds).ravel()


def gain_field(grid: VoxelGrid, surface: SurfaceVoxels, object_min_enu_m: Array, object_max_enu_m: Array,
               spec: GainSpec, looks: NDArray[np.uint8] | None = None,
               camera_bounds_enu_m: tuple[Array, Array] | None = None) -> GainField:
    """Label every voxel for ray casting.

    The box is grown by a voxel sideways and upwards, not into the ground. looks: grid-shaped count of earlier views
    that ought to have shown each voxel (see `count_looks`), or None. camera_bounds_enu_m: (lower, upper) of where
    cameras may stand, when views shall also open the way there.
    """
    lower = np.asarray(object_min_enu_m, dtype=np.float64) - np.array([1.0, 1.0, 0.0]) * grid.voxel_m
    upper = np.asarray(object_max_enu_m, dtype=np.float64) + grid.voxel_m
    kind = np.full(grid.state.shape, PASSED, dtype=np.uint8)
    box = _box(grid, lower, upper)
    unknown, solid = grid.state == UNKNOWN, grid.state == OCCUPIED
    kind[unknown] = OUTSIDE
    if camera_bounds_enu_m is not None:
        around = kind[_box(grid, *camera_bounds_enu_m)]
        around[around == OUTSIDE] = PASSAGE
    kind[solid] = SOLID
    near = ndimage.binary_dilation(solid[box], np.ones((3, 3, 3), dtype=bool))
    inside = kind[box]
    inside[unknown[box]] = INSIDE
    inside[unknown[box] & near] = FRONTIER
    seen = _seen_count(grid, surface)[box]
    inside[solid[box] & (seen == 1)] = SEEN_ONCE
    inside[solid[box] & (seen == 2)] = SEEN_TWICE
    if looks is not None:
        kind += KINDS * np.minimum(looks, LOOKS_MAX - 1).astype(np.uint8) * (grid.state != FREE)
    if camera_bounds_enu_m is not None:
        lower, upper = np.minimum(lower, camera_bounds_enu_m[0]), np.maximum(upper, camera_bounds_enu_m[1])
    return GainField(grid, kind, lower, upper, spec)


def lattice_gains(field: GainField, lattice: Lattice, camera: Camera,
                  chosen: NDArray[np.int64] | None = None, rays: int = RAYS) -> Array:
    """(p, o) expected new surface in m^2 of every candidate view; rows only of the `chosen` positions when given."""
    directions = fibonacci_directions(rays)
    mask = in_view(directions, lattice.yaw_enu_rad, lattice.elevation_rad, camera)
    first = np.concatenate([[0], np.cumsum(mask.sum(axis=1))])
    starts = lattice.positions_enu_m if chosen is None else lattice.positions_enu_m[chosen]
    origin, voxel = field.grid.origin_enu_m, field.grid.voxel_m
    gains: Array = view_gains(field.label, field.chance, field.value, (starts - origin) / voxel, directions,
                              (field.lower_enu_m - origin) / voxel, (field.upper_enu_m - origin) / voxel,
                              field.spec.sensing_range_m / voxel, field.spec.full_value_m / voxel,
                              first, np.nonzero(mask)[1], mask.shape[1])
    return gains * (4.0 * math.pi / rays) * voxel**2


def visible_voxels(field: GainField, pose: Pose, camera: Camera, least: float = 0.3) -> NDArray[np.bool_]:
    """Grid-shaped mask of the voxels that a picture is expected to show with a probability of at least `least`."""
    width = max(8, math.ceil(field.spec.sensing_range_m / field.grid.voxel_m * camera.width_px / camera.fx_px))
    height = max(8, math.ceil(width * camera.height_px / camera.width_px))
    rays = camera.scaled(width, height).rays_camera().reshape(-1, 3) @ pose.enu_from_camera.T
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    seen = np.zeros(field.label.shape, dtype=np.bool_)
    start = (np.array(pose.position_enu_m) - field.grid.origin_enu_m) / field.grid.voxel_m
    mark_rays(field.label, field.chance, seen, start, rays, field.spec.sensing_range_m / field.grid.voxel_m, least)
    return seen


def with_claims(field: GainField, poses: list[Pose], camera: Camera) -> GainField:
    """The field in which everything that the given views will show is worth nothing any more."""
    label = field.label.copy()
    for pose in poses:
        seen = visible_voxels(field, pose, camera) & (label % KINDS != PASSED)
        label[seen] = label[seen] % KINDS + KINDS * LOOKS_MAX
    return GainField(field.grid, label, field.lower_enu_m, field.upper_enu_m, field.spec)


def count_looks(field: GainField, looks: NDArray[np.uint8], pose: Pose, camera: Camera) -> NDArray[np.uint8]:
    """looks with one more for every voxel that the picture taken at pose ought to have shown."""
    seen = visible_voxels(field, pose, camera)
    return np.where(seen, np.minimum(looks, 254) + 1, looks).astype(np.uint8)


def _box(grid: VoxelGrid, lower: Array, upper: Array) -> tuple[slice, ...]:
    first = np.clip(grid.index(lower), 0, grid.state.shape)
    last = np.clip(grid.index(upper - 1e-9) + 1, 0, grid.state.shape)
    return tuple(slice(int(a), int(b)) for a, b in zip(first, last, strict=True))


def _seen_count(grid: VoxelGrid, surface: SurfaceVoxels) -> NDArray[np.int64]:
    count = np.zeros(grid.state.shape, dtype=np.int64)
    index = grid.index(surface.position_enu_m)
    ok = grid.inside(index)
    np.maximum.at(count, tuple(index[ok].T), surface.seen_count[ok])
    return count
