"""Which legs of the lattice are known to be free, and which are hoped to be."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from ground_station.nbv.explored import box_counter
from ground_station.nbv.hopes import FADING, MAYBE_OPEN, SOON, Hopes
from missions.pose_lattice import AXIS_STEPS, PoseLattice

LATTICE = PoseLattice((0.0, 0.0, 0.0), (8.0, 2.0, 1.0), (8, 2, 1), (0.0,), 4)
POSITIONS = 16
FORWARD, BACK = AXIS_STEPS.index((1, 0, 0)), AXIS_STEPS.index((-1, 0, 0))


def pose(x: int, y: int = 0) -> int:
    return LATTICE.flat((x, y, 0, 0, 0))


def place(x: int, y: int = 0) -> int:
    return pose(x, y) // LATTICE.orientations


def known_up_to(x: int) -> np.ndarray:
    """Legs along y = 0 are known as far as x."""
    known = np.ones((POSITIONS, len(AXIS_STEPS)), dtype=np.bool_)
    for beyond in range(x, 7):
        known[place(beyond), FORWARD] = known[place(beyond + 1), BACK] = False
    return known


def test_the_first_unknown_leg_that_is_counted_on_soon_fades_both_ways_and_no_other_does() -> None:
    hopes, open_, known = Hopes(LATTICE), np.ones((POSITIONS, len(AXIS_STEPS)), dtype=np.bool_), known_up_to(2)
    before = hopes.likely(open_, known)
    assert before[place(2), FORWARD] == MAYBE_OPEN
    for times in (1, 2, 3):
        hopes.count_on(pose(0), [pose(x) for x in (1, 2, 3, 4)], hopes.likely(open_, known))
        after = hopes.likely(open_, known)
        for leg in ((place(2), FORWARD), (place(3), BACK)):
            assert after[leg] == MAYBE_OPEN * FADING**times
            after[leg] = before[leg]
        np.testing.assert_array_equal(after, before)


def test_what_is_known_or_closed_stays_so_and_legs_far_ahead_do_not_fade() -> None:
    hopes, open_, known = Hopes(LATTICE), np.ones((POSITIONS, len(AXIS_STEPS)), dtype=np.bool_), known_up_to(SOON)
    open_[place(0, 1)] = False
    hopes.count_on(pose(0), [pose(x) for x in range(1, 8)], hopes.likely(open_, known))
    likely = hopes.likely(open_, known)
    assert set(np.unique(likely)) == {0.0, MAYBE_OPEN, 1.0}
    hopes.count_on(pose(1), [pose(x) for x in range(2, 8)], likely)
    assert hopes.likely(open_, np.ones_like(known)).max() == 1.0
    assert (hopes.likely(open_, known)[~open_] == 0.0).all()
    assert hopes.likely(open_, known)[place(SOON), FORWARD] == MAYBE_OPEN * FADING


@given(st.integers(0, 2**32 - 1))
def test_boxes_are_counted_exactly_also_where_they_reach_beyond_the_grid(seed: int) -> None:
    rng = np.random.default_rng(seed)
    voxels = rng.random(tuple(rng.integers(1, 6, 3))) < 0.3
    first = rng.integers(-2, 6, (20, 3))
    end = first + rng.integers(0, 5, (20, 3))
    counted = box_counter(voxels)(first, end)
    for box, count in zip(np.stack([first, end], axis=1), counted, strict=True):
        low, high = np.clip(box, 0, voxels.shape)
        assert count == voxels[low[0]:high[0], low[1]:high[1], low[2]:high[2]].sum()
