"""What is imagined where nothing was seen: training walks, partial maps, the network, its training and its judging."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from missions.errors import UserError
from missions.grid import FREE, OCCUPIED, UNKNOWN, VoxelGrid
from missions.training_walks import TrainingWalk, walk_files
from perception.imagination.adapt import AdaptiveImagination, AdaptSettings
from perception.imagination.checkpoint import Training, save_net
from perception.imagination.imagine import WEIGHTS, Imagination, Unseen
from perception.imagination.layers import gradients
from perception.imagination.network import ImaginationNet
from perception.imagination.partial_maps import partial_maps
from perception.imagination.samples import Samples, samples_of
from perception.imagination.scores import Scores
from perception.imagination.surroundings import COUNT, Floats
from perception.imagination.symmetry import evidence
from perception.imagination.train import begin, log_loss, main, train_step
from sim_bridge.nbv.clearance import distances, segments_clear
from sim_bridge.nbv.rules import Rules
from sim_bridge.scenes.scene import Part, Scene
from sim_bridge.scenes.solids import Solid, box, joined, plate
from sim_bridge.training_walks import Stage, make_stage, sealed, surface_voxels, take_walk
from sim_bridge.truth import Truth

STEPS = 60
RULES = Rules(positions=40)
BOX = (np.array([-4.0, -3.0, 0.0]), np.array([4.0, 3.0, 5.0]))


def part(solid: Solid, is_object: bool) -> Part:
    return Part("part", solid.vertices_m, solid.faces, None, None, (90, 90, 90), is_object, procedural=True)


def hut() -> Scene:
    """A block with a tower on it, on flat ground."""
    body = joined([box((-4.0, -3.0, 0.0), (4.0, 3.0, 3.0)), box((-1.0, -1.0, 3.0), (1.0, 1.0, 5.0))])
    parts = [part(body, True), part(plate((-60.0, -60.0), (60.0, 60.0), 0.0), False)]
    return Scene("hut", parts, (-4.0, -3.0, 0.0), (4.0, 3.0, 5.0), 0.0)


@pytest.fixture(scope="module")
def stage() -> Stage:
    return make_stage("hut", hut(), np.random.default_rng(3), RULES)


@pytest.fixture(scope="module")
def walk(stage: Stage) -> TrainingWalk:
    return take_walk(stage, 2, 0.8, 12, np.random.default_rng(5))


@pytest.fixture(scope="module")
def folder(walk: TrainingWalk, tmp_path_factory: pytest.TempPathFactory) -> Path:
    home = tmp_path_factory.mktemp("walks")
    walk.save(home / "hut.walk.npz")
    return home


@pytest.fixture(scope="module")
def untrained(tmp_path_factory: pytest.TempPathFactory) -> Imagination:
    path = tmp_path_factory.mktemp("weights") / "net.safetensors"
    torch.manual_seed(1)
    save_net(path, ImaginationNet())
    return Imagination.load(path)


def run(training: Training, samples: Samples, until: int) -> None:
    while training.step < until:
        train_step(training, samples, STEPS, 1)


def half_seen_wall() -> VoxelGrid:
    """A wall of 20 m at x = 2, seen up to y = 0 from the side of negative x."""
    grid = VoxelGrid.unknown(np.array([-8.0, -14.0, -1.0]), np.array([10.0, 14.0, 10.0]), 0.5)
    state = grid.state
    at = grid.index(np.array([2.0, 0.0, 0.25]))
    state[: at[0], : at[1], at[2] :] = FREE
    state[at[0], 8 : at[1], at[2] : at[2] + 12] = OCCUPIED
    return grid


def test_surface_has_no_holes_and_what_it_encloses_is_solid() -> None:
    scene, low, high = hut(), np.array([-6.0, -5.0, -1.0]), np.array([6.0, 5.0, 7.0])
    surface = surface_voxels(Truth(*scene.mesh()), low, high, 0.5)
    grid = VoxelGrid(low, 0.5, np.zeros(surface.shape, np.uint8))
    middles = grid.centers(np.stack(np.indices(surface.shape), axis=-1))
    assert np.array_equal(surface.ravel(), distances(Truth(*scene.mesh()), middles.reshape(-1, 3)) <= 0.25)
    solid = surface | sealed(surface)
    inside = np.all((middles > np.array([-4.0, -3.0, 0.0])) & (middles < np.array([4.0, 3.0, 3.0])), axis=-1)
    assert solid[inside].all()
    assert solid[middles[..., 2] < 0.0].all()
    assert not solid[middles[..., 2] > 5.5].any()


def test_walks_step_along_free_legs_of_the_lattice(stage: Stage, walk: TrainingWalk) -> None:
    assert walk.key_poses[-1] == 12
    assert np.array_equal(np.unique(walk.key_poses), np.arange(1, 13))
    at = walk.poses[:, :3]
    assert (distances(stage.truth, at) >= stage.radius_m).all()
    for vehicle in range(2):
        keys = [at[np.flatnonzero(walk.key_poses == n)[0]] for n in range(1 + vehicle, 13, 2)]
        assert segments_clear(stage.truth, np.array(keys[:-1]), np.array(keys[1:]), stage.radius_m).all()


def test_a_walk_comes_back_from_its_file(folder: Path, walk: TrainingWalk) -> None:
    back = TrainingWalk.load(walk_files(folder)[0])
    assert np.array_equal(back.solid, walk.solid)
    assert np.array_equal(back.depth_m, walk.depth_m)
    assert back.camera == walk.camera
    assert back.pose(3) == walk.pose(3)


def test_a_file_that_is_no_walk_is_refused_by_name(tmp_path: Path) -> None:
    (tmp_path / "x.walk.npz").write_bytes(b"PK")
    with pytest.raises(UserError, match=r"x\.walk\.npz"):
        TrainingWalk.load(tmp_path / "x.walk.npz")
    with pytest.raises(UserError, match="no training walks"):
        walk_files(tmp_path / "nowhere")


def test_maps_grow_along_a_walk_and_know_free_from_solid(walk: TrainingWalk) -> None:
    maps = partial_maps(walk, np.random.default_rng(1), (2, 6, 12))
    assert maps.key_poses == [2, 6, 12]
    unknown = [(g.state == UNKNOWN).sum() for g in maps.grids]
    assert unknown == sorted(unknown, reverse=True)
    last = maps.grids[-1].state
    assert maps.solid[last == FREE].mean() < 0.02
    assert ndimage.binary_dilation(maps.solid)[last == OCCUPIED].mean() > 0.9


@settings(deadline=None, max_examples=15)
@given(shape=st.tuples(*[st.integers(1, 30)] * 3), voxel_m=st.floats(0.3, 1.0), seed=st.integers(0, 2**16))
def test_what_is_known_stays_and_the_rest_is_a_chance(untrained: Imagination, shape: tuple[int, int, int],
                                                      voxel_m: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    state = rng.integers(0, 3, shape).astype(np.uint8)
    grid = VoxelGrid(rng.uniform(-8.0, 2.0, 3), voxel_m, state)
    occupancy = untrained.occupancy(grid, *BOX, 0.0)
    assert occupancy.dtype == np.float32
    assert occupancy.shape == shape
    assert (occupancy[state == FREE] == 0.0).all()
    assert (occupancy[state == OCCUPIED] == 1.0).all()
    assert ((occupancy[state == UNKNOWN] > 0.0) & (occupancy[state == UNKNOWN] <= 1.0)).all()


def test_a_wall_is_imagined_to_go_on() -> None:
    grid = half_seen_wall()
    occupancy = Imagination.load().occupancy(grid, np.array([1.5, -10.0, 0.0]), np.array([6.0, 10.0, 6.0]), 0.0)
    on, high = grid.index(np.array([[2.25, 0.25, 3.0], [2.25, 0.25, 9.0]]))
    assert occupancy[tuple(on)] > 0.5
    assert occupancy[tuple(on)] > 4.0 * occupancy[tuple(high)]


def test_a_turned_or_mirrored_map_is_imagined_alike() -> None:
    grid, (low, high) = half_seen_wall(), (np.array([1.5, -10.0, 0.0]), np.array([6.0, 10.0, 6.0]))
    far = grid.origin_enu_m + np.array(grid.state.shape) * grid.voxel_m
    imagination = Imagination.load()
    straight = imagination.occupancy(grid, low, high, 0.0)
    turned = VoxelGrid(np.array([-far[1], grid.origin_enu_m[0], -1.0]), 0.5, np.rot90(grid.state))
    there = imagination.occupancy(turned, np.array([-high[1], low[0], 0.0]), np.array([-low[1], high[0], 6.0]), 0.0)
    assert np.abs(np.rot90(straight) - there).mean() < 0.01
    mirrored = VoxelGrid(np.array([-far[0], grid.origin_enu_m[1], -1.0]), 0.5, grid.state[::-1])
    there = imagination.occupancy(mirrored, low * (0, 1, 1) - high * (1, 0, 0), high * (0, 1, 1) - low * (1, 0, 0), 0.0)
    assert np.abs(straight[::-1] - there).mean() < 0.01


def test_a_training_run_learns_and_resumes_to_the_same_weights(folder: Path, tmp_path: Path) -> None:
    samples = samples_of(walk_files(folder)[0], seed=1)
    whole, half, rest = (begin(samples, 1) for _ in range(3))
    before = log_loss(whole.net, samples)
    run(whole, samples, STEPS)
    assert log_loss(whole.net, samples) < 0.6 * before
    run(half, samples, 5)
    half.save(tmp_path / "half.checkpoint")
    rest.resume(tmp_path / "half.checkpoint")
    run(rest, samples, STEPS)
    for a, b in zip(whole.net.parameters(), rest.net.parameters(), strict=True):
        assert torch.equal(a, b)


def test_the_command_trains_and_its_weights_can_be_loaded(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "net.safetensors"
    assert main([str(folder), "--out", str(out), "--steps", "2", "--workers", "1"]) == 0
    grid = half_seen_wall()
    assert Imagination.load(out).occupancy(grid, *BOX, 0.0).shape == grid.state.shape


def test_it_flies_as_it_was_trained(untrained: Imagination) -> None:
    torch.manual_seed(1)
    known = np.random.default_rng(1).normal(size=(100, COUNT)).astype(np.float32)
    trained = torch.sigmoid(ImaginationNet()(torch.from_numpy(known))).detach().numpy()
    np.testing.assert_allclose(untrained.chance(known), trained, atol=1e-6)


def test_files_that_are_no_weights_are_refused(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(UserError, match="no weights at"):
        Imagination.load(tmp_path / "none.safetensors")
    (tmp_path / "bad.safetensors").write_bytes(b"nothing")
    with pytest.raises(UserError, match=r"bad\.safetensors"):
        Imagination.load(tmp_path / "bad.safetensors")
    with pytest.raises(UserError, match="no checkpoint"):
        begin(samples_of(walk_files(folder)[0], seed=1), 1).resume(tmp_path / "bad.safetensors")


def test_the_weights_are_small() -> None:
    assert WEIGHTS.stat().st_size < 5_000_000


def test_imagining_needs_no_torch() -> None:
    code = "import sys, perception.imagination.imagine as m; m.Imagination.load(); sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_scores_know_good_chances_from_bad() -> None:
    rng = np.random.default_rng(1)
    chance = rng.uniform(0.0, 1.0, 100_000).astype(np.float32)
    true = rng.random(100_000) < chance
    honest, bold = Scores(), Scores()
    honest.add(chance, true)
    bold.add(np.clip(1.5 * (chance - 0.5) + 0.5, 0.0, 1.0), true)
    assert honest.calibration_error < 0.01 < bold.calibration_error
    assert honest.brier < bold.brier
    assert honest.log_loss < bold.log_loss
    assert honest.brier == pytest.approx(1.0 / 6.0, abs=0.003)


def states_of_a_wall(count: int) -> list[VoxelGrid]:
    """A wall of 20 m at x = 2 in a box where the network expects something else, seen from one end to the other."""
    low = np.array([-8.0, -14.0, -1.0])
    whole = VoxelGrid.unknown(low, np.array([10.0, 14.0, 10.0]), 0.5)
    whole.state[:20, :, 2:] = FREE
    whole.state[20, 8:48, 2:14] = OCCUPIED
    grids = []
    for n in range(1, count + 1):
        state = np.zeros_like(whole.state)
        seen = state.shape[1] * n // count
        state[:, :seen] = whole.state[:, :seen]
        grids.append(VoxelGrid(low, 0.5, state))
    return grids


def chances_in_flight(imagination: AdaptiveImagination, grids: list[VoxelGrid]) -> list[Floats]:
    return [imagination.occupancy(grid, *BOX, 0.0) for grid in grids]


def test_imagination_that_learns_in_flight_foresees_better_what_the_next_map_shows(untrained: Imagination) -> None:
    grids = states_of_a_wall(12)
    learning = AdaptiveImagination(untrained, AdaptSettings(rate=3e-3))
    plain, learnt = Scores(), Scores()
    for before, chance, after in zip(grids[5:-1], chances_in_flight(learning, grids)[5:-1], grids[6:], strict=True):
        new = (before.state == UNKNOWN) & (after.state != UNKNOWN)
        for scores, said in ((plain, untrained.occupancy(before, *BOX, 0.0)), (learnt, chance)):
            scores.add(said[new], after.state[new] == OCCUPIED)
    assert learnt.log_loss < 0.7 * plain.log_loss


def test_equal_flights_learn_the_same_and_a_map_that_stands_still_teaches_nothing() -> None:
    grids, shipped = states_of_a_wall(6), Imagination.load()
    first, second = (chances_in_flight(AdaptiveImagination(shipped), grids) for _ in range(2))
    assert all(np.array_equal(a, b) for a, b in zip(first, second, strict=True))
    unseen = Unseen.of(grids[2], *BOX, 0.0)
    untaught = shipped.occupancy_of(grids[2], unseen, 0.0, evidence(grids[2], unseen.index, *BOX))
    still = chances_in_flight(AdaptiveImagination(shipped), [grids[2]] * 4)
    assert all(np.array_equal(chance, untaught) for chance in still)


def test_slopes_are_those_that_torch_finds(untrained: Imagination) -> None:
    torch.manual_seed(1)
    net, rng = ImaginationNet(), np.random.default_rng(2)
    known, target, weight = (rng.random(s, dtype=np.float32) for s in ((50, COUNT), 50, 50))
    loss = torch.nn.functional.binary_cross_entropy_with_logits(
        net(torch.from_numpy(known)), torch.from_numpy(target), torch.from_numpy(weight), reduction="sum")
    loss.backward()  # type: ignore[no-untyped-call]
    found = gradients(known, target, weight, untrained.mean, untrained.scale, *untrained.layers)
    for slope, (_, parameter) in zip(found, net.named_parameters(), strict=True):
        assert parameter.grad is not None
        np.testing.assert_allclose(slope, parameter.grad.numpy().T.squeeze(), atol=1e-5)
