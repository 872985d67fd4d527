"""Lattice and rays."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from missions.camera import Camera, Pose
from missions.lattice import MOST_POSITIONS, lattice_positions, view_positions
from missions.mission import ExploreSpec
from missions.sensors import fibonacci_directions
from planning.nbv.lattice import build_lattice, in_view
from planning.nbv.rays import segment_blocked

CAMERA = Camera.from_diagonal_fov(114, 64, 84.0)
LOWER, UPPER = np.array([-20.0, -20.0, 0.0]), np.array([20.0, 20.0, 16.0])


def test_lattice_is_made_of_cell_centres() -> None:
    positions = lattice_positions(np.array([0.0, 0.0, 2.0]), np.array([10.0, 1.0, 8.0]), 4.0)
    assert np.allclose(np.unique(positions[:, 0]), [2.5, 7.5])
    assert np.allclose(np.unique(positions[:, 1]), [0.5])
    assert np.allclose(np.unique(positions[:, 2]), [3.5, 6.5])


@given(st.floats(3.0, 300.0), st.floats(3.0, 300.0), st.floats(3.0, 200.0), st.floats(0.5, 12.0))
@settings(deadline=None)
def test_lattice_of_views_keeps_the_step_until_there_are_too_many(x: float, y: float, z: float, step: float) -> None:
    lower, upper = np.zeros(3), np.array([x, y, z])
    positions = view_positions(lower, upper, ExploreSpec(lattice_step_m=step))
    asked = lattice_positions(lower, upper, step) if x * y * z < 1e5 * step**3 else None
    assert 0 < len(positions) <= MOST_POSITIONS
    if asked is not None and len(asked) <= MOST_POSITIONS:
        assert np.array_equal(positions, asked)
    else:
        assert len(positions) > MOST_POSITIONS / 3


def test_lattice_has_every_elevation_with_every_azimuth() -> None:
    lattice = build_lattice(LOWER, UPPER, ExploreSpec())
    degrees = np.round(np.degrees([lattice.elevation_rad, lattice.yaw_enu_rad]))
    pairs = set(zip(*degrees, strict=True))
    assert pairs == {(e, a) for e in (-60, -30, 0, 30, 60) for a in (-180, -144, -108, -72, -36, 0, 36, 72, 108, 144)}


@given(st.floats(-math.pi, math.pi), st.floats(-1.2, 1.2))
@settings(deadline=None)
def test_in_view_agrees_with_projection(yaw: float, elevation: float) -> None:
    directions = fibonacci_directions(200)
    in_camera = directions @ Pose((0.0, 0.0, 0.0), yaw, elevation).enu_from_camera
    half_h, half_v = CAMERA.half_fov_rad
    expected = (in_camera[:, 2] > 0) & (abs(np.arctan2(in_camera[:, 0], in_camera[:, 2])) < half_h) & (
        abs(np.arctan2(in_camera[:, 1], in_camera[:, 2])) < half_v)
    assert np.array_equal(in_view(directions, np.array([yaw]), np.array([elevation]), CAMERA)[:, 0], expected)


points = st.tuples(*[st.floats(0.01, 7.99)] * 3).map(np.array)


@given(st.integers(0, 2**32 - 1), points, points)
@settings(max_examples=100, deadline=None)
def test_segment_blocked_agrees_with_dense_samples(seed: int, start: NDArray[np.float64],
                                                   end: NDArray[np.float64]) -> None:
    state = (np.random.default_rng(seed).random((8, 8, 8)) < 0.95).astype(np.uint8)
    samples = np.floor(start + np.linspace(0.0, 1.0, 5000)[:, None] * (end - start)).astype(int)
    blocked = bool((state[tuple(samples.T)] != 1).any())
    if blocked != segment_blocked(state, 1, start, end, 0.0):
        chords = [chord_m(start, end, cell) for cell in np.argwhere(state != 1)]
        assert any(-1e-9 <= chord < 5e-3 for chord in chords), "they may differ over a grazed corner only"


def chord_m(start: NDArray[np.float64], end: NDArray[np.float64], cell: NDArray[np.int64]) -> float:
    """Length of the segment within a voxel; negative when it misses."""
    with np.errstate(divide="ignore", invalid="ignore"):
        bounds = np.sort((np.stack([cell, cell + 1]) - start) / (end - start), axis=0)
    t = np.clip([np.nanmax(bounds[0]), np.nanmin(bounds[1])], 0.0, 1.0)
    return float((t[1] - t[0]) * np.linalg.norm(end - start))
