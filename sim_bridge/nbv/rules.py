"""The rules of a trial, and the lattice of views that a scene gets by them without anybody's hand.

They are the automatic settings of MACARONS (Guedon et al., CVPR 2023) in metres: a camera box around the object's box,
cut into cubes so that about 200 of the positions are free, 5 elevations x 10 azimuths, 4 pictures per step, 101 poses.
"""

from __future__ import annotations

from collections.abc import Callable

import msgspec
import numpy as np

from missions.errors import UserError
from missions.frames import Array
from missions.mission import CameraSpec, FleetSpec
from missions.pose_lattice import PoseLattice
from missions.simulation import RenderSpec
from sim_bridge.scenes.scene import Scene
from sim_bridge.truth import Mask

SENSING_SHARE = 70.0 / 160.0
"""Sensing range over the diagonal of the object's box: MACARONS senses 70 units in scenes of 93 to 210 units."""
MARGIN_SHARE = 0.18
"""The camera box reaches this share of the diagonal beyond the object's box, sideways and above."""
LEAST_MARGIN_M = 3.0
FLOOR_M = 2.0
"""Lowest height of the camera box above the ground."""
FINER = 0.98
MOST_POSITIONS = 4000


class Rules(msgspec.Struct, frozen=True, kw_only=True):
    """What all trials of a campaign have in common."""

    poses: int = 101
    """Key poses of all vehicles together, the starts included."""
    positions: int = 200
    """Free positions of the lattice, about."""
    elevations_deg: tuple[float, ...] = (-60.0, -30.0, 0.0, 30.0, 60.0)
    azimuths: int = 10
    frames_per_step: int = 4
    points: int = 20_000
    """Reference points on the object's exposed surface."""
    seed: int = 1
    camera: CameraSpec = CameraSpec()
    fleet: FleetSpec = FleetSpec()
    render: RenderSpec = RenderSpec()
    in_step: bool = False
    """Vehicles wait for each other before they fly on, so that all are decided for together: what a round costs."""


def sensing_range_m(scene: Scene) -> float:
    """How far pictures count in this scene."""
    return SENSING_SHARE * _diagonal_m(scene)


def lattice_of(scene: Scene, rules: Rules, is_free: Callable[[Array], Mask]) -> PoseLattice:
    """The coarsest lattice of near-cubic cells with at least rules.positions free positions.

    is_free: which of (p, 3) positions are. Raises UserError where no lattice up to MOST_POSITIONS has that many.
    """
    low, high = np.array(scene.object_min_enu_m), np.array(scene.object_max_enu_m)
    margin = max(MARGIN_SHARE * _diagonal_m(scene), LEAST_MARGIN_M)
    low, high = low - margin, high + margin
    low[2] = scene.ground_up_m + FLOOR_M
    if high[2] <= low[2]:
        raise UserError(f"{scene.name}: the object lies under the ground at {scene.ground_up_m:g} m; correct its file.")
    step = float(np.prod(high - low) / rules.positions) ** (1.0 / 3.0)
    while True:
        nx, ny, nz = (max(1, round(float(n))) for n in (high - low) / step)
        if nx * ny * nz > MOST_POSITIONS:
            raise UserError(f"{scene.name}: around the object no {rules.positions} positions are free by "
                            f"{rules.fleet.clearance_m:g} m; check the units of its file, or ask for fewer positions.")
        lattice = PoseLattice(_point(low), _point(high), (nx, ny, nz), rules.elevations_deg, rules.azimuths)
        if is_free(lattice.positions_enu_m).sum() >= rules.positions:
            return lattice
        step *= FINER


def _diagonal_m(scene: Scene) -> float:
    return float(np.linalg.norm(np.array(scene.object_max_enu_m) - np.array(scene.object_min_enu_m)))


def _point(p: Array) -> tuple[float, float, float]:
    x, y, z = (float(c) for c in p)
    return x, y, z
