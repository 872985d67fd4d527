"""Generated worlds for the simulated campaign: voxel scenes with narrow places, and random views in them.

Nothing here is a real place: the scenes are drawn from a seed, to be as awkward for a fleet as scenes can be.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from missions.frames import Array
from missions.grid import FREE, OCCUPIED, VoxelGrid
from missions.messages import SiteBrief
from missions.mission import BatterySpec, ExploreSpec, FleetSpec, Mission, SiteSpec
from missions.pads import geofence, hover_points
from planning.paths import Reach, VoxelField, reachable

VOXEL_M = 0.5
SIZE_M = (36.0, 24.0, 9.0)
"""Of the structure: from the origin to here."""
FENCE_MARGIN_M = 4.0
PAD_ROWS, PAD_STEP_M, PAD_GAP_M = 2, 6.0, 8.0
BORE_M = 3.0
"""Width and height of tunnels and holes: two vehicles cannot pass each other there."""
VIEW_CLEARANCE_M = 1.1
VIEW_FROM_HOVER_M = 4.0
"""No view is so near to a hover point that a vehicle waiting there would block it."""
NARROW_SHARE = 0.7
"""Views drawn from places within NARROW_M of something solid, where there are any."""
NARROW_M = 1.75

Solid = NDArray[np.bool_]
Random = np.random.Generator


@dataclass(frozen=True)
class World:
    """One generated place: what is solid, who flies there, and the views that are asked for."""

    kind: str
    mission: Mission
    site: SiteBrief
    grid: VoxelGrid
    field: VoxelField
    views_enu_m: Array
    """(n, 3), each reachable from every hover point when nobody else flies."""


def make_world(seed: int, least_vehicles: int, most_vehicles: int, kind: str | None = None) -> World:
    """The world of a seed; kind: one of KINDS, drawn as well when left out."""
    random = np.random.default_rng(seed)
    kind = kind or str(random.choice(sorted(KINDS)))
    vehicles = int(random.integers(least_vehicles, most_vehicles + 1))
    site, mission = _site(), _mission(vehicles, seed)
    solid = np.zeros(tuple(round(s / VOXEL_M) for s in SIZE_M), dtype=np.bool_)
    KINDS[kind](solid, random)
    grid = _grid(mission, site, solid)
    field = VoxelField.from_grid(grid)
    count = int(vehicles * random.integers(2, 6))
    return World(kind, mission, site, grid, field, _views(mission, site, field, count, random))


def world_with(vehicles: int, carve: Callable[[Solid], None], views_enu_m: Array) -> World:
    """A world made by hand: a solid block of SIZE_M of which `carve` takes passages out, and views."""
    site, mission = _site(), _mission(vehicles, 1)
    solid = np.ones(tuple(round(s / VOXEL_M) for s in SIZE_M), dtype=np.bool_)
    carve(solid)
    grid = _grid(mission, site, solid)
    return World("by hand", mission, site, grid, VoxelField.from_grid(grid), views_enu_m)


def _site() -> SiteBrief:
    return SiteBrief(object_min_enu_m=(0.0, 0.0, 0.0), object_max_enu_m=SIZE_M, ground_up_m=0.0)


def _grid(mission: Mission, site: SiteBrief, solid: Solid) -> VoxelGrid:
    """The structure in the geofence, everything else free."""
    grid = VoxelGrid.unknown(*geofence(mission, site), VOXEL_M)
    grid.state[:] = FREE
    first = np.round((np.zeros(3) - grid.origin_enu_m) / VOXEL_M).astype(int)
    inner = tuple(slice(a, a + n) for a, n in zip(first, solid.shape, strict=True))
    grid.state[inner][solid] = OCCUPIED
    return grid


def _mission(vehicles: int, seed: int) -> Mission:
    columns = -(-vehicles // PAD_ROWS)
    pads = [(0.5 * SIZE_M[0] + (k // PAD_ROWS - 0.5 * (columns - 1)) * PAD_STEP_M,
             -PAD_GAP_M - (k % PAD_ROWS) * PAD_STEP_M, 0.2) for k in range(vehicles)]
    return Mission(
        title=f"campaign {seed}", seed=seed, fleet=FleetSpec(vehicles=vehicles, takeoff_enu_m=pads),
        site=SiteSpec(camera_margin_m=FENCE_MARGIN_M, geofence_margin_m=0.5),
        battery=BatterySpec(model="distance", percent_per_m=0.0), explore=ExploreSpec(voxel_m=VOXEL_M))


def _views(mission: Mission, site: SiteBrief, field: VoxelField, count: int, random: Random) -> Array:
    hovers = np.array(hover_points(mission, site))
    reach = reachable(field, hovers[0], mission.fleet.clearance_m)
    voxels = np.argwhere(np.isfinite(reach.distance_m) & (field.distance >= VIEW_CLEARANCE_M))
    places = field.origin + voxels * field.voxel_m
    far = np.linalg.norm(places[:, None] - hovers, axis=2).min(axis=1) >= VIEW_FROM_HOVER_M
    low = site.ground_up_m + mission.site.camera_floor_m
    places, voxels = places[far & (places[:, 2] >= low)], voxels[far & (places[:, 2] >= low)]
    narrow = (field.distance[tuple(voxels.T)] <= NARROW_M) & np.all((places > 0.0) & (places < SIZE_M), axis=1)
    weight = np.where(narrow, NARROW_SHARE / max(1, int(narrow.sum())), (1.0 - NARROW_SHARE) / max(1, (~narrow).sum()))
    picked = places[random.choice(len(places), size=count, replace=False, p=weight / weight.sum())]
    return np.asarray(picked[np.isfinite(reach.distance_to(picked))])


def reach_from(world: World, position_enu_m: Array) -> Reach:
    """What one vehicle alone reaches from a place."""
    return reachable(world.field, position_enu_m, world.mission.fleet.clearance_m)


def _cells(metres: float) -> int:
    return round(metres / VOXEL_M)


def bore(solid: Solid, a: Array, b: Array, width_m: float = BORE_M) -> None:
    """Take a straight, axis-parallel passage out of the solid, from a to b (metres, its middle line)."""
    half = 0.5 * width_m
    lo = np.round((np.minimum(a, b) - half) / VOXEL_M).astype(int)
    hi = np.round((np.maximum(a, b) + half) / VOXEL_M).astype(int)
    cut = tuple(slice(max(0, p), max(0, q)) for p, q in zip(lo, hi, strict=True))
    solid[cut] = False


def _tunnels(solid: Solid, random: Random) -> None:
    """Dead ends: tunnels from the front into a block, some with a branch."""
    solid[:] = True
    for x in np.arange(4.0, SIZE_M[0] - 3.0, 8.0):
        z, deep = float(random.uniform(3.0, 6.5)), float(random.uniform(10.0, 21.0))
        bore(solid, np.array([x, 0.0, z]), np.array([x, deep, z]))
        if random.random() < 0.6:
            aside = x + float(random.choice([-3.5, 3.5]))
            y = float(random.uniform(5.0, deep))
            bore(solid, np.array([x, y, z]), np.array([aside, y, z]))


def _corridors(solid: Solid, random: Random) -> None:
    """Passages right through a block, joined by one across."""
    solid[:] = True
    z, y = float(random.uniform(3.0, 6.0)), float(random.uniform(6.0, 18.0))
    for x in (6.0, 18.0, 30.0):
        bore(solid, np.array([x, 0.0, z]), np.array([x, SIZE_M[1], z]))
    bore(solid, np.array([6.0, y, z]), np.array([30.0, y, z]))


def _walls(solid: Solid, random: Random) -> None:
    """Rooms one behind the other, under a roof; one or two holes in each wall."""
    solid[:, :, -_cells(1.0):] = True
    solid[:_cells(1.0)] = solid[-_cells(1.0):] = True
    for y in (0.0, 8.0, 16.0, 23.0):
        solid[:, _cells(y):_cells(y + 1.0)] = True
        for _ in range(int(random.integers(1, 3)) if y < 23.0 else 0):
            x, z = float(random.uniform(4.0, SIZE_M[0] - 4.0)), float(random.uniform(3.5, 5.5))
            bore(solid, np.array([x, y, z]), np.array([x, y + 1.0, z]))


def _slots(solid: Solid, random: Random) -> None:
    """Under a bridge: a low deck on walls, open at front and back, some bays closed at the back."""
    deck = _cells(float(random.uniform(5.0, 6.0)))
    solid[:, _cells(3.0):_cells(21.0), deck:deck + _cells(1.5)] = True
    for x in np.arange(0.0, SIZE_M[0], 5.0):
        solid[_cells(x):_cells(x + 1.0), _cells(3.0):_cells(21.0), :deck] = True
        if random.random() < 0.4:
            solid[_cells(x):_cells(x + 6.0), _cells(20.0):_cells(21.0), :deck] = True


def _courtyard(solid: Solid, random: Random) -> None:
    """A roofed yard with a single door."""
    solid[:] = True
    solid[_cells(8.0):_cells(28.0), _cells(4.0):_cells(20.0), :-_cells(1.0)] = False
    x = float(random.uniform(10.0, 26.0))
    bore(solid, np.array([x, 0.0, 3.5]), np.array([x, 4.5, 3.5]))


def _blocks(solid: Solid, random: Random) -> None:
    """Buildings with alleys in between."""
    for x in np.arange(1.0, SIZE_M[0] - 5.0, 9.0):
        for y in np.arange(1.0, SIZE_M[1] - 5.0, 8.0):
            up = _cells(float(random.uniform(4.0, SIZE_M[2])))
            solid[_cells(x):_cells(x + 6.0), _cells(y):_cells(y + 5.0), :up] = True


def _open(solid: Solid, random: Random) -> None:
    """A few boxes in the open."""
    for _ in range(6):
        x, y = random.uniform(0.0, SIZE_M[0] - 4.0), random.uniform(0.0, SIZE_M[1] - 4.0)
        solid[_cells(x):_cells(x + 4.0), _cells(y):_cells(y + 3.0), :_cells(float(random.uniform(3.0, 8.0)))] = True


KINDS: dict[str, Callable[[Solid, Random], None]] = {
    "tunnels": _tunnels, "corridors": _corridors, "walls": _walls, "slots": _slots, "courtyard": _courtyard,
    "blocks": _blocks, "open": _open}
