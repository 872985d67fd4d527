"""Of a place that is seen from nearby, what is seen from far away is left out; the rest is kept."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

from perception.reconstruct.nearness import FARTHER, Nearness
from perception.reconstruct.settings import Region

REGION = Region(np.array([-1.0, -1.0, -0.5]), np.array([5.0, 1.0, 0.5]))
BESIDE_NEAR, BESIDE_FAR = np.array([0.0, 0.0, 6.0]), np.array([0.0, 0.0, 6.0 * FARTHER + 0.5])
NEAR_ONLY, FAR_ONLY, BOTH = 0.5, 3.5, 2.0


def patch(east_m: float, n: int = 50) -> np.ndarray:
    """Points within one cell."""
    spread = np.random.default_rng(n).random((n, 3)) * 0.2 + [0.02, 0.02, 0.02]
    spread[:, 0] += np.floor(east_m / 0.25) * 0.25
    return spread.astype(np.float32)


def test_far_points_go_where_there_are_near_ones_and_stay_elsewhere() -> None:
    nearness = Nearness(REGION, 8.0)
    near, far = np.concatenate([patch(NEAR_ONLY), patch(BOTH)]), np.concatenate([patch(FAR_ONLY), patch(BOTH)])
    nearness.add(near, BESIDE_NEAR)
    nearness.add(far, BESIDE_FAR)
    assert nearness.near_enough(near, BESIDE_NEAR).all()
    assert_array_equal(nearness.near_enough(far, BESIDE_FAR), [True] * 50 + [False] * 50)


def test_a_few_stray_points_from_nearby_drive_nothing_out() -> None:
    nearness = Nearness(REGION, 8.0)
    nearness.add(patch(BOTH, 3), BESIDE_NEAR)
    nearness.add(patch(BOTH), BESIDE_FAR)
    assert nearness.near_enough(patch(BOTH), BESIDE_FAR).all()


def test_nothing_is_kept_from_much_farther_than_usual() -> None:
    nearness = Nearness(REGION, 8.0)
    nearness.add(np.concatenate([patch(x) for x in (NEAR_ONLY, BOTH)]), BESIDE_NEAR)
    nearness.add(patch(FAR_ONLY + 1.0), np.array([0.0, 0.0, 40.0]))
    assert not nearness.near_enough(patch(FAR_ONLY + 1.0), np.array([0.0, 0.0, 40.0])).any()
    from_afar = Nearness(REGION, 8.0)
    from_afar.add(patch(FAR_ONLY), np.array([0.0, 0.0, 40.0]))
    assert from_afar.near_enough(patch(FAR_ONLY), np.array([0.0, 0.0, 40.0])).all(), "everything is seen from there"


@given(st.permutations(range(4)), st.sampled_from([REGION, Region(np.full(3, -1.0), np.array([900.0, 900.0, 60.0]))]))
@settings(max_examples=12)
def test_the_order_of_pictures_does_not_matter_and_the_nearest_stays(order: list[int], region: Region) -> None:
    cameras = [np.array([0.0, 0.0, z]) for z in (4.0, 7.0, 12.0, 30.0)]
    ordered, shuffled = Nearness(region, 8.0), Nearness(region, 8.0)
    for k in range(4):
        ordered.add(patch(0.0), cameras[k])
        shuffled.add(patch(0.0), cameras[order[k]])
    kept = [ordered.near_enough(patch(0.0), c) for c in cameras]
    assert_array_equal(kept, [shuffled.near_enough(patch(0.0), c) for c in cameras])
    assert_array_equal([k.all() for k in kept], [True, False, False, False])
    assert not kept[2].any()
