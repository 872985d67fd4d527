"""The three networks of MACARONS: their sizes, and the laws that their parts obey."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import sph_harm_y
from torch import nn

from perception.macarons.depth_net import (
    DepthNet,
    cost_volume,
    depth_from_disparity,
    pixel_rays,
    plane_depths,
    standardised,
    swept_disparity,
)
from perception.macarons.gain_net import GainNet, gain, visibility
from perception.macarons.harmonics import (
    BINS,
    COEFFICIENTS,
    DEGREES,
    bin_directions,
    harmonics,
    nearest_bin,
    view_harmonics,
)
from perception.macarons.occupancy_net import OccupancyNet, neighbourhoods
from perception.macarons.resnet import parameters

CAMERA = torch.tensor([[0.6, 1.0, 0.5, 0.5]])


@pytest.mark.parametrize(("net", "count"), [(DepthNet, 14_421_892), (OccupancyNet, 2_257_769), (GainNet, 1_392_888)])
def test_networks_have_the_published_number_of_parameters(net: type[nn.Module], count: int) -> None:
    assert parameters(net()) == count


def unit(rng: np.random.Generator, n: int) -> np.ndarray:
    d = rng.normal(size=(n, 3))
    return d / np.linalg.norm(d, axis=1, keepdims=True)


def test_harmonics_are_the_real_ones_of_the_textbook() -> None:
    d = unit(np.random.default_rng(0), 50)
    polar, azimuth = np.arccos(d[:, 1]), np.arctan2(d[:, 0], d[:, 2])
    mine = harmonics(torch.from_numpy(d)).numpy()
    for degree in range(DEGREES):
        for m in range(degree + 1):
            y = sph_harm_y(degree, m, polar, azimuth)
            scale = math.sqrt(2.0) if m else 1.0
            np.testing.assert_allclose(mine[:, degree * degree + degree + m], scale * y.real, atol=1e-9)
            if m:
                np.testing.assert_allclose(mine[:, degree * degree + degree - m], scale * y.imag, atol=1e-9)


def test_harmonics_are_orthonormal() -> None:
    nodes, weights = np.polynomial.legendre.leggauss(16)
    azimuth = 2.0 * np.pi * np.arange(32) / 32
    up, a = np.meshgrid(nodes, azimuth, indexing="ij")
    flat = np.sqrt(1.0 - up**2)
    y = harmonics(torch.from_numpy(np.stack([flat * np.sin(a), up, flat * np.cos(a)], axis=-1).reshape(-1, 3))).numpy()
    gram = y.T @ (y * np.repeat(weights * 2.0 * np.pi / 32, 32)[:, None])
    np.testing.assert_allclose(gram, np.eye(COEFFICIENTS), atol=1e-12)


def test_every_bin_is_nearest_to_its_own_direction() -> None:
    np.testing.assert_array_equal(nearest_bin(bin_directions()), np.arange(BINS))


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=25, deadline=None)
def test_a_view_state_in_another_frame_is_the_same_function_on_the_sphere(seed: int) -> None:
    rng = np.random.default_rng(seed)
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    turn *= np.sign(np.linalg.det(turn))
    seen, d = rng.random((4, BINS)) < 0.2, unit(rng, 20)
    here = view_harmonics(seen, np.eye(3)) @ harmonics(torch.from_numpy(d.astype(np.float32))).T
    there = view_harmonics(seen, turn) @ harmonics(torch.from_numpy((d @ turn.T).astype(np.float32))).T
    torch.testing.assert_close(here, there, atol=2e-4, rtol=1e-3)


def test_nothing_seen_has_no_harmonics() -> None:
    assert not view_harmonics(np.zeros((3, BINS), dtype=np.bool_), np.eye(3)).any()


def test_planes_lie_within_twice_the_range_evenly_in_inverse_depth() -> None:
    planes = plane_depths(torch.device("cpu"))
    assert (planes <= 1.0).sum() > 90
    steps = (1.0 / planes).diff()
    torch.testing.assert_close(steps, steps[:1].expand_as(steps), rtol=1e-3, atol=1e-4)


def test_disparity_spans_the_depths_the_network_can_tell() -> None:
    ends = depth_from_disparity(torch.tensor([1.0, 0.0]))
    torch.testing.assert_close(ends, torch.tensor([1.0 / 16.0, 10.0]))


def wall_features(depth: float, shift: float, h: int = 32, w: int = 56) -> tuple[torch.Tensor, torch.Tensor]:
    """Features of a frontal wall seen from the origin and from `shift` to the right; (1, 2, h, w) each."""
    def look(x_camera: float) -> torch.Tensor:
        at = pixel_rays(CAMERA, h, w)[0] * depth + torch.tensor([x_camera, 0.0, 0.0])
        return torch.stack([torch.sin(17.0 * at[..., 0]) + torch.cos(11.0 * at[..., 1]), torch.sin(29.0 * at[..., 0])])
    return look(0.0)[None], look(shift)[None]


@given(st.floats(0.15, 0.9))
@settings(max_examples=15, deadline=None)
def test_the_cheapest_plane_is_the_one_the_wall_is_on(depth: float) -> None:
    own, other = wall_features(depth, 0.12)
    source_from_target = torch.eye(4)[None, None].clone()
    source_from_target[..., 0, 3] = -0.12
    cost = cost_volume(own, other[:, None], CAMERA, source_from_target)[0, :, 4:-4, 24:-8]
    planes = plane_depths(torch.device("cpu"))
    found = 1.0 / planes[cost.mean(dim=(1, 2)).argmin()]
    assert abs(found - 1.0 / depth) <= 0.6 * (1.0 / planes[1] - 1.0 / planes[0])


def test_the_sweep_begins_at_the_cheapest_plane_and_standardising_keeps_the_order() -> None:
    cost = 0.5 + 0.1 * torch.rand(1, 96, 6, 8)
    cost[:, 40] = 0.1
    flat = standardised(cost)
    torch.testing.assert_close(flat.mean(dim=1), torch.zeros(1, 6, 8), atol=1e-5, rtol=0.0)
    assert torch.equal(flat.argsort(dim=1), cost.argsort(dim=1))
    found = depth_from_disparity(swept_disparity(flat))
    torch.testing.assert_close(found, plane_depths(cost.device)[40].expand_as(found), rtol=1e-3, atol=1e-4)


def test_depth_comes_out_at_four_scales_of_any_picture_size() -> None:
    with torch.no_grad():
        out = DepthNet().eval()(torch.rand(1, 3, 72, 120), torch.rand(1, 2, 3, 72, 120), CAMERA,
                                torch.eye(4).expand(1, 2, 4, 4))
    assert [tuple(o.shape) for o in out] == [(1, 1, 72, 120), (1, 1, 36, 60), (1, 1, 18, 30), (1, 1, 9, 15)]
    assert all((o >= 0).all() and (o <= 1).all() for o in out)


def occupancy_inputs(rng: np.random.Generator, cells: int, queries: int) -> list[torch.Tensor]:
    clouds = rng.normal(size=(cells, 80, 3)).astype(np.float32)
    at = rng.normal(size=(queries, 3)).astype(np.float32)
    near = neighbourhoods(clouds[0], at, rng)
    owner = rng.integers(0, cells, queries)
    return [torch.from_numpy(a) for a in (clouds, at, owner, near, rng.normal(size=(queries, 64)).astype(np.float32))]


def test_occupancy_is_a_probability_and_ignores_the_order_of_points_and_queries() -> None:
    rng = np.random.default_rng(3)
    clouds, at, owner, near, views = occupancy_inputs(rng, 2, 9)
    net = OccupancyNet().eval()
    with torch.no_grad():
        p = net(clouds, at, owner, near, views)
        order = torch.randperm(9)
        q = net(clouds[:, torch.randperm(80)], at[order], owner[order], near[order], views[order])
    assert ((p >= 0) & (p <= 1)).all()
    torch.testing.assert_close(p[order], q, atol=1e-5, rtol=1e-4)


def test_neighbourhoods_hold_the_nearest_points_at_full_density() -> None:
    rng = np.random.default_rng(4)
    points, queries = rng.normal(size=(700, 3)).astype(np.float32), rng.normal(size=(5, 3)).astype(np.float32)
    found = np.linalg.norm(neighbourhoods(points, queries, rng), axis=-1)
    true = np.sort(np.linalg.norm(points[None] - queries[:, None], axis=-1), axis=1)[:, :16]
    np.testing.assert_allclose(found[:, 0], true, rtol=1e-4)
    assert (found[:, 1] >= found[:, 0] - 1e-6).all()
    assert (found[:, 2] >= found[:, 1] - 1e-6).all()


def test_neighbourhoods_of_fewer_points_than_neighbours_repeat_the_last() -> None:
    points = np.arange(9, dtype=np.float32).reshape(3, 3)
    found = neighbourhoods(points, np.zeros((1, 3), np.float32), np.random.default_rng(0))
    assert np.isfinite(found).all()
    np.testing.assert_array_equal(found[0, 0, 2:], np.repeat(found[0, 0, 2:3], 14, axis=0))


def test_padding_changes_no_point_and_candidates_are_independent() -> None:
    net, (a, b) = GainNet().eval(), (5, 9)
    tokens, views = torch.rand(2, b, 4), torch.rand(2, b, 64)
    present = torch.ones(2, b, dtype=torch.bool)
    present[0, a:] = False
    with torch.no_grad():
        both = net(tokens, views, present)
        alone = net(tokens[:1, :a], views[:1, :a], present[:1, :a])
    torch.testing.assert_close(both[:1, :a], alone, atol=1e-5, rtol=1e-4)


def test_visibility_is_a_share_and_gain_counts_draws() -> None:
    c = torch.randn(2, 6, 64)
    to = torch.nn.functional.normalize(torch.randn(2, 6, 3), dim=-1)
    seen = visibility(c, to)
    assert ((seen > 0) & (seen < 1)).all()
    count, volume = torch.tensor([[1.0, 3.0, 0.0]]), torch.tensor([8.0])
    value = gain(torch.tensor([[1.0, 0.5, 1.0]]), count, volume)
    torch.testing.assert_close(value, torch.tensor([8.0 * (1.0 + 3 * 0.5) / 4.0]))
