"""Laws of the measures: identity, shifts, monotony, and the thesis's equations against plain arithmetic."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from perception.evaluate import accuracy
from perception.evaluate.completeness import completeness, distances_to_cloud

SQUARE = np.array([[0.0, 0, 0], [4, 0, 0], [4, 4, 0], [0, 4, 0]])
FACES = np.array([[0, 1, 2], [0, 2, 3]])


def grid(z: float = 0.0) -> np.ndarray:
    x, y = np.meshgrid(np.linspace(0.2, 3.8, 40), np.linspace(0.2, 3.8, 40))
    return np.stack([x.ravel(), y.ravel(), np.full(x.size, z)], axis=1).astype(np.float32)


def test_identical_cloud_is_perfect() -> None:
    distances = distances_to_cloud(grid().astype(np.float64), grid())
    assert distances.max() == 0.0
    assert set(completeness(distances).values()) == {1.0}
    plain = accuracy.exact(accuracy.signed_distances(grid(), SQUARE, FACES))
    assert plain.mean_m == pytest.approx(0.0, abs=1e-6)
    assert plain.within_2cm == 1.0


@given(st.floats(-0.3, 0.3))
def test_shifted_plane_has_its_shift_as_error(shift: float) -> None:
    signed = accuracy.signed_distances(grid(shift), SQUARE, FACES)
    np.testing.assert_allclose(signed, shift, atol=1e-6)
    overall = accuracy.binned(*accuracy.histogram(signed))
    assert overall.mean_m == pytest.approx(abs(shift), abs=0.6 * accuracy.BIN_M)
    assert overall.rms_m == pytest.approx(abs(shift), abs=0.6 * accuracy.BIN_M)


@given(st.lists(st.floats(0, 2), min_size=1, max_size=200))
def test_completeness_rises_with_the_threshold(distances: list[float]) -> None:
    shares = list(completeness(np.array(distances), (0.1, 0.2, 0.25, 0.5, 2.0)).values())
    assert shares == sorted(shares)
    assert shares[-1] == 1.0


@given(st.lists(st.floats(-3, 3), min_size=1, max_size=300))
def test_bins_agree_with_exact_values_to_half_a_bin(distances: list[float]) -> None:
    d = np.array(distances)
    counts, centres = accuracy.histogram(d)
    overall, plain = accuracy.binned(counts, centres), accuracy.exact(d)
    assert counts.sum() == overall.points == plain.points == len(d)
    assert overall.mean_m == pytest.approx(plain.mean_m, abs=0.501 * accuracy.BIN_M)
    assert overall.rms_m == pytest.approx(plain.rms_m, abs=0.501 * accuracy.BIN_M)
    assert overall.rms_m >= overall.mean_m - 1e-12


def test_equations_on_a_hand_made_histogram() -> None:
    counts, centres = np.array([1, 3, 4, 2]), np.array([-0.03, -0.01, 0.01, 0.05])
    overall = accuracy.binned(counts, centres)
    assert overall.within_2cm == pytest.approx(7 / 10)
    assert overall.mean_m == pytest.approx((0.03 + 0.03 + 0.04 + 0.10) / 10)
    assert overall.rms_m == pytest.approx(np.sqrt((0.0009 + 0.0003 + 0.0004 + 0.005) / 10))


def test_edges_of_bins_lie_at_two_centimetres() -> None:
    overall = accuracy.binned(*accuracy.histogram(np.array([0.0199, -0.0199, 0.0201, -0.0201])))
    assert overall.within_2cm == 0.5


def test_sign_is_the_side_of_the_surface() -> None:
    signed = accuracy.signed_distances(np.array([[1, 1, 0.1], [1, 1, -0.1]], np.float32), SQUARE, FACES)
    np.testing.assert_allclose(signed, [0.1, -0.1], atol=1e-6)


def test_trimming_forgets_gross_errors() -> None:
    assert accuracy.trimmed(np.array([0.01, -0.04, 3.0])).tolist() == [0.01, -0.04]


def test_nothing_measured_is_unknown_not_zero() -> None:
    assert completeness(np.zeros(0)) == {"0.10": None, "0.20": None, "0.25": None, "0.50": None}
    assert accuracy.binned(*accuracy.histogram(np.zeros(0))) == accuracy.Accuracy(None, None, None, 0)
    assert accuracy.exact(np.zeros(0)).mean_m is None
    assert np.all(np.isinf(distances_to_cloud(np.zeros((3, 3)), np.zeros((0, 3), np.float32))))
