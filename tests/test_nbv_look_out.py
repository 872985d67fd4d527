"""A vehicle between places where it was looks towards what may lead on."""

from __future__ import annotations

import numpy as np

from ground_station.nbv.look_out import LookOut, leg_ends, shut_in
from missions.camera import Camera
from missions.pose_lattice import AXIS_STEPS, PoseLattice
from planning.nbv.lattice import in_view

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


def look_out(start: tuple[int, ...], unseen: np.ndarray, times: int) -> list[int | None]:
    """Steps of a vehicle that was at two places, which the leg east of the second may lead on from."""
    behind, here = place(0, 1, 1), place(1, 1, 1)
    out, at = LookOut(LATTICE, CAMERA), LATTICE.flat(start)  # type: ignore[arg-type]
    steps: list[int | None] = []
    for _ in range(times):
        step = out.first_step(at, legs((behind, EAST), (here, WEST)), legs((here, EAST)), {behind, here},
                              lambda a, b: unseen if (a, b) == (here, place(2, 1, 1)) else np.zeros((0, 3)))
        steps.append(step)
        at = at if step is None else step
    return steps


def sees(pose: int, points: np.ndarray) -> float:
    at, orientation = divmod(pose, LATTICE.orientations)
    yaw, elevation = LATTICE.yaw_elevation_rad[[orientation]].T
    return float(in_view(points - LATTICE.positions_enu_m[at], yaw, elevation, CAMERA).mean())


def test_it_turns_until_it_sees_what_must_be_seen_of_the_leg_onward() -> None:
    along = np.linspace(5.0, 6.5, 9)[:, None] * [1.0, 0.0, 0.0] + [0.0, 4.0, 4.0]
    steps = look_out((0, 1, 1, 1, 4), along, 4)
    at = LATTICE.flat((0, 1, 1, 1, 4))
    for step in steps:
        assert step in LATTICE.steps[at]
        at = step  # type: ignore[assignment]
    assert max(sees(step, along) for step in steps if step is not None) == 1.0


def test_it_does_not_look_for_ever_at_what_no_picture_shows() -> None:
    along = np.linspace(5.0, 6.5, 9)[:, None] * [1.0, 0.0, 0.0] + [0.0, 4.0, 4.0]
    steps = look_out((0, 1, 1, 1, 0), along, 12)
    assert steps[0] is not None
    assert steps[-1] is None


def test_without_anything_to_look_at_there_is_nowhere_to_turn() -> None:
    assert look_out((0, 1, 1, 1, 4), np.zeros((0, 3)), 1) == [None]
