"""A vehicle between places where it was looks towards what may lead on."""

from __future__ import annotations

import numpy as np

from ground_station.nbv.look_out import LookOut
from missions.camera import Camera
from missions.pose_lattice import AXIS_STEPS, PoseLattice
from planning.nbv.lattice import in_view

LATTICE = PoseLattice((0.0, 0.0, 0.0), (8.0, 8.0, 8.0), (3, 3, 3), (-30.0, 0.0, 30.0), 8)
CAMERA = Camera.from_diagonal_fov(96, 64, 84.0)
EAST, WEST, NORTH, SOUTH = (AXIS_STEPS.index(step) for step in ((1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0)))
EVERYWHERE = np.ones(27)


def place(*cell: int) -> int:
    return LATTICE.flat((*cell, 0, 0)) // LATTICE.orientations  # type: ignore[arg-type]


BEHIND, HERE = place(0, 1, 1), place(1, 1, 1)


def legs(*known: tuple[int, int]) -> np.ndarray:
    open_ = np.zeros((27, 6), dtype=np.bool_)
    for position, step in known:
        open_[position, step] = True
    return open_


def look_out(start: tuple[int, ...], unseen: dict[tuple[int, int], np.ndarray], times: int,
             behind: np.ndarray = EVERYWHERE) -> list[int | None]:
    """Steps of a vehicle that reaches two places, where what is unseen of legs from the second may lead on."""
    out, at = LookOut(LATTICE, CAMERA), LATTICE.flat(start)  # type: ignore[arg-type]
    steps: list[int | None] = []
    for _ in range(times):
        step = out.first_step(at, legs((BEHIND, EAST), (HERE, WEST)), legs(*unseen), behind,
                              lambda a, b: unseen[a, int(np.flatnonzero(LATTICE.leg_ends[a] == b)[0])])
        steps.append(step)
        at = at if step is None else step
    return steps


def sees(pose: int, points: np.ndarray) -> float:
    at, orientation = divmod(pose, LATTICE.orientations)
    yaw, elevation = LATTICE.yaw_elevation_rad[[orientation]].T
    return float(in_view(points - LATTICE.positions_enu_m[at], yaw, elevation, CAMERA).mean())


ALONG_EAST = np.linspace(5.0, 6.5, 9)[:, None] * [1.0, 0.0, 0.0] + [0.0, 4.0, 4.0]
ALONG_NORTH = np.linspace(5.0, 6.5, 9)[:, None] * [0.0, 1.0, 0.0] + [4.0, 0.0, 4.0]


def test_it_turns_until_it_sees_what_must_be_seen_of_the_leg_onward() -> None:
    steps = look_out((0, 1, 1, 1, 4), {(HERE, EAST): ALONG_EAST}, 4)
    at = LATTICE.flat((0, 1, 1, 1, 4))
    for step in steps:
        assert step in LATTICE.steps[at]
        at = step  # type: ignore[assignment]
    assert max(sees(step, ALONG_EAST) for step in steps if step is not None) == 1.0


def test_it_looks_first_along_the_leg_with_more_behind_it() -> None:
    unseen = {(HERE, EAST): ALONG_EAST, (HERE, NORTH): ALONG_NORTH}
    for most, along in ((place(2, 1, 1), ALONG_EAST), (place(1, 2, 1), ALONG_NORTH)):
        behind = 0.3 * EVERYWHERE
        behind[most] = 1.0
        [step] = look_out((0, 1, 1, 1, 1), unseen, 1, behind)
        assert step is not None
        assert sees(step, along) == 1.0


def test_it_looks_first_at_the_leg_that_is_nearly_known() -> None:
    """Of one leg nine places are left to be seen, of the other as many as a leg has that nobody looked along."""
    many = np.concatenate([ALONG_EAST + np.array([0.0, 0.0, up]) for up in np.linspace(-0.4, 0.4, 30)])
    few, start = {(HERE, NORTH): ALONG_NORTH}, (0, 1, 1, 1, 1)
    for unseen in (few | {(HERE, EAST): many}, {(HERE, EAST): many} | few):
        [step] = look_out(start, unseen, 1)
        assert step is not None
        assert sees(step, ALONG_NORTH) == 1.0


def test_what_shows_two_legs_is_looked_at_before_what_shows_a_little_better_one() -> None:
    """Two begin side by side in the north-east, the other leads south, with more behind it."""
    north_east = np.array([4.0, 4.0, 4.0]) + np.linspace(1.0, 2.0, 9)[:, None] * [1.0, 1.0, 0.0]
    south = np.array([4.0, 4.0, 4.0]) - np.linspace(1.0, 2.5, 9)[:, None] * [0.0, 1.0, 0.0]
    behind = EVERYWHERE.copy()
    behind[place(1, 0, 1)] = 1.2
    both = {(HERE, EAST): north_east, (HERE, NORTH): north_east, (HERE, SOUTH): south}
    *_, step = look_out((0, 1, 1, 1, 7), both, 2, behind)
    assert step is not None
    assert sees(step, north_east) == 1.0


def test_where_a_sure_way_leads_nothing_is_looked_for() -> None:
    assert look_out((0, 1, 1, 1, 4), {(BEHIND, EAST): ALONG_EAST}, 1) == [None]


def test_it_does_not_look_for_ever_at_what_no_picture_shows() -> None:
    steps = look_out((0, 1, 1, 1, 0), {(HERE, EAST): ALONG_EAST}, 12)
    assert steps[0] is not None
    assert steps[-1] is None


def test_without_anything_to_look_at_there_is_nowhere_to_turn() -> None:
    assert look_out((0, 1, 1, 1, 4), {(HERE, EAST): np.zeros((0, 3))}, 1) == [None]
