"""A vehicle between places where it was looks towards what may lead on."""

from __future__ import annotations

import numpy as np

from ground_station.nbv.look_out import leg_ends, looking_out, shut_in
from missions.camera import Camera
from missions.pose_lattice import AXIS_STEPS, PoseLattice

LATTICE = PoseLattice((0.0, 0.0, 0.0), (8.0, 8.0, 8.0), (3, 3, 3), (-30.0, 0.0, 30.0), 8)
CAMERA = Camera.from_diagonal_fov(96, 64, 84.0)
EAST, WEST = AXIS_STEPS.index((1, 0, 0)), AXIS_STEPS.index((-1, 0, 0))


def place(*cell: int) -> int:
    return LATTICE.flat((*cell, 0, 0)) // LATTICE.orientations  # type: ignore[arg-type]


def legs(*known: tuple[int, int]) -> np.ndarray:
    open_ = np.zeros((27, 6), dtype=np.bool_)
    for position, step in known:
        open_[position, step] = True
    return open_


def test_ends_are_where_steps_lead() -> None:
    ends = leg_ends(LATTICE)
    assert ends[place(1, 1, 1), EAST] == place(2, 1, 1)
    assert ends[place(2, 1, 1), EAST] == -1


def test_shut_in_is_who_reaches_nothing_new() -> None:
    a, b, c = place(0, 1, 1), place(1, 1, 1), place(2, 1, 1)
    to_and_fro = legs((a, EAST), (b, WEST))
    assert shut_in(LATTICE, to_and_fro, a, {a, b})
    assert not shut_in(LATTICE, to_and_fro, a, {a})
    assert not shut_in(LATTICE, to_and_fro | legs((b, EAST)), a, {a, b})
    assert shut_in(LATTICE, to_and_fro | legs((b, EAST)), a, {a, b, c})


def test_of_all_views_those_that_show_the_legs_onward_are_kept() -> None:
    here, behind = place(1, 1, 1), place(0, 1, 1)
    maybe = legs((here, EAST))
    poses = [LATTICE.flat((0, 1, 1, 1, a)) for a in range(8)]
    kept = looking_out(LATTICE, maybe, {here, behind}, poses, CAMERA)
    ahead = LATTICE.yaw_elevation_rad[[p % LATTICE.orientations for p in kept], 0]
    assert (np.cos(ahead) > 0.5).all()
    assert set(kept) <= set(poses)
    assert looking_out(LATTICE, legs(), {here}, poses, CAMERA) == poses
