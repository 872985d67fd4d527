"""MACARONS learns: from truth, from pictures alone, and on from a checkpoint as if it had never stopped."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from safetensors.torch import load_file
from tensorboardX.proto.event_pb2 import Event  # type: ignore[import-not-found]

from ground_station.train import main
from missions.camera import Pose
from missions.errors import UserError
from perception.macarons.augment import jittered, mirrored
from perception.macarons.depth_net import FARTHEST, NEAREST
from perception.macarons.field import Field
from perception.macarons.inputs import gain_batch, occupancy_batch
from perception.macarons.learner import Learner, LearnSettings
from perception.macarons.losses import dissimilarity, normalised_l1, photometric, supervised_depth
from perception.macarons.online import supervision_m
from perception.macarons.shots import depth_batch
from perception.macarons.surface import Cells, Surface
from perception.macarons.tracks import Track, depth_examples
from perception.macarons.training import TrainingRun, TrainSettings
from perception.macarons.weights import Networks
from tests.walk_scene import full_field, wall_walk

pytestmark = pytest.mark.xdist_group("macarons")
SMALL = LearnSettings(picture_px=(56, 32), batch=2, depth_rate=3e-4, warm_up=4, proxies=1500, queries=60,
                      cloud_points=64, samples=24, cameras=4, gains=1, memory=2, replays=1)
TRUTH = TrainSettings(learn=SMALL, depth_steps=8, scone_steps=1)
ALONE = TrainSettings(learn=SMALL, online=True)


@pytest.fixture(scope="module", autouse=True)
def one_thread() -> Iterator[None]:
    """Threads that wait for each other on a loaded machine take longer than one."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture(scope="module")
def walk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return wall_walk(tmp_path_factory.mktemp("walks"))


@pytest.fixture(scope="module")
def track(walk: Path) -> Track:
    return Track.read(walk, (112, 64), 25.0)


def weights(folder: Path) -> dict[str, torch.Tensor]:
    return {f"{path.name}:{key}": value for path in sorted((folder / "checkpoint").glob("*.safetensors"))
            for key, value in load_file(path).items()}


def run_epochs(run: TrainingRun, epochs: int) -> list[dict[str, float]]:
    out = []
    for _ in range(epochs):
        losses: dict[str, list[float]] = {}
        run.epoch(lambda _, name, values, losses=losses: losses.setdefault(name, []).extend(values))
        out.append({name: float(np.mean(values)) for name, values in losses.items() if values})
    return out


@pytest.mark.parametrize("given_settings", [TRUTH, ALONE], ids=["with truth", "from pictures alone"])
def test_a_run_that_was_stopped_ends_with_the_same_weights_and_the_loss_falls(
        walk: Path, tmp_path: Path, given_settings: TrainSettings) -> None:
    whole = TrainingRun(tmp_path / "whole", given_settings, [walk])
    history = run_epochs(whole, 1)
    shutil.copytree(tmp_path / "whole", tmp_path / "parts")
    resumed = TrainingRun(tmp_path / "parts", given_settings, [walk])
    resumed.resume()
    run_epochs(resumed, 1)
    history += run_epochs(whole, 1)
    first, second = weights(tmp_path / "whole"), weights(tmp_path / "parts")
    assert first.keys() == second.keys()
    assert all(torch.equal(first[key], second[key]) for key in first)
    falling = "depth" if given_settings is TRUTH else "photometric"
    assert history[1][falling] < history[0][falling]


def test_occupancy_and_gain_learn_what_is_true_of_one_map(track: Track) -> None:
    learner, field = Learner(Networks.fresh(1), SMALL), full_field(track, 13)
    rng, pose = np.random.default_rng(0), track.walk.pose(12)
    batch = occupancy_batch(field, rng.permutation(field.open_queries())[:60], pose, 64, rng)
    assert batch is not None
    solid = torch.from_numpy(track.solid(field.proxies[batch.numbers]).astype(np.float32))
    errors = [learner.occupancy(batch, solid)[0] for _ in range(12)]
    assert errors[-1] < 0.8 * errors[0]
    views = gain_batch(field, track.shots[0].camera, [track.walk.pose(n) for n in (3, 8, 14, 16)], pose, 24, rng)
    gains = [learner.gain(views, torch.tensor([4.0, 1.0, 0.0, 2.0])) for _ in range(12)]
    assert gains[-1] < 0.9 * gains[0]


def test_a_checkpoint_of_other_settings_or_none_is_refused(walk: Path, tmp_path: Path) -> None:
    with pytest.raises(UserError, match="no checkpoint"):
        TrainingRun(tmp_path, TRUTH, [walk]).resume()
    TrainingRun(tmp_path, TRUTH, [walk]).save()
    with pytest.raises(UserError, match="other settings"):
        TrainingRun(tmp_path, ALONE, [walk]).resume()


def test_shipped_weights_are_half_as_large_and_predict_the_same(tmp_path: Path) -> None:
    networks = Networks.fresh(3)
    networks.save(tmp_path / "half", torch.float16)
    back = Networks.load(tmp_path / "half")
    size = sum(path.stat().st_size for path in (tmp_path / "half").iterdir())
    assert size < 37e6
    for before, after in zip(networks.gain.parameters(), back.gain.parameters(), strict=True):
        torch.testing.assert_close(before, after, atol=1e-3, rtol=1e-3)
    (tmp_path / "half" / "gain.safetensors").write_bytes(b"not weights")
    with pytest.raises(UserError, match=r"gain\.safetensors"):
        Networks.load(tmp_path / "half")


def true_disparity(track: Track, frame: int) -> torch.Tensor:
    depth = torch.from_numpy(track.walk.depth_m[frame].astype(np.float32))[None, None] / track.range_m
    full = torch.nn.functional.interpolate(depth, size=(64, 112), mode="nearest").clamp(NEAREST, FARTHEST)
    return (1.0 / full - 1.0 / FARTHEST) / (1.0 / NEAREST - 1.0 / FARTHEST)


def test_the_true_depth_explains_the_pictures_best(track: Track) -> None:
    a, b, c, d = (track.shots[n] for n in track.moves[2])
    batch = depth_batch([c], [[b, a]], track.range_m)
    others = depth_batch([c], [[b, a, d]], track.range_m)
    truth, everywhere = true_disparity(track, track.moves[2][2]), torch.ones(1, 1, 64, 112)

    def loss(disparity: torch.Tensor) -> float:
        scales = [torch.nn.functional.interpolate(disparity, scale_factor=0.5**s, mode="area") for s in range(4)]
        return float(photometric(scales, batch, others.sources, others.source_from_target, everywhere))

    best = loss(truth)
    assert best < 0.6 * min(loss(0.6 * truth), loss(1.5 * truth))
    assert loss(truth) < loss(truth.flip(-1).roll(7, -1) * 0.8)


def test_losses_are_zero_for_the_truth_and_gains_count_by_their_ratios(track: Track) -> None:
    depth = torch.from_numpy(track.walk.depth_m[4].astype(np.float32))[None, None] / track.range_m
    size = [(64, 112), (32, 56), (16, 28), (8, 14)]
    exact = ((1.0 / depth.clamp(min=NEAREST) - 1.0 / FARTHEST) / (1.0 / NEAREST - 1.0 / FARTHEST)).clamp(0.0, 1.0)
    scales = [torch.nn.functional.interpolate(exact, size=s, mode="nearest") for s in size]
    assert float(supervised_depth(scales, depth)) == pytest.approx(0.0, abs=1e-5)
    rgb = torch.rand(2, 3, 16, 20)
    assert float(dissimilarity(rgb, rgb).abs().max()) < 1e-6
    gains = torch.tensor([1.0, 4.0, 0.0])
    assert float(normalised_l1(7.0 * gains, gains)) == pytest.approx(0.0, abs=1e-6)
    assert float(normalised_l1(gains.flip(0), gains)) > 0.3


def test_the_mirrored_world_has_mirrored_depth(track: Track) -> None:
    networks = Networks.fresh(0)
    batch, _ = depth_examples([track], 1, np.random.default_rng(1))
    twice = mirrored(mirrored(batch))
    torch.testing.assert_close(twice.target, batch.target)
    torch.testing.assert_close(twice.source_from_target, batch.source_from_target)
    plain = batch.sources.mean(), mirrored(batch).sources.mean()
    torch.testing.assert_close(*plain)
    assert jittered(batch, np.random.default_rng(2)).target.shape == batch.target.shape
    networks.depth.eval()
    with torch.no_grad():
        assert all(torch.isfinite(d).all() for d in mirrored(batch).predict(networks.depth))


def test_carving_leaves_the_wall_and_opens_the_space_before_it(track: Track) -> None:
    field = full_field(track, 17)
    field.settle()
    seen = field.looks > 3
    north = field.proxies[:, 1]
    assert field.solid()[seen & (north > 0.2)].all()
    assert (field.passed[seen & (north < -0.9)] > 0).mean() < 1.0
    assert (field.occupancy[field.looks == 0] == 0.5).all()
    np.testing.assert_allclose(field.surface.points[:, 1], 0.0, atol=0.1)


def test_a_leg_through_the_wall_is_blocked_and_one_before_the_box_is_not(track: Track) -> None:
    field = full_field(track, 17)
    assert field.blocked(np.array([0.0, -8.0, 4.0]), np.array([0.0, 4.0, 4.0]), 1.0) > 0
    assert field.blocked(np.array([-4.0, -8.0, 4.0]), np.array([4.0, -8.0, 4.0]), 1.0) == 0


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=20, deadline=None)
def test_the_surface_keeps_one_point_per_voxel_whatever_comes(seed: int) -> None:
    rng = np.random.default_rng(seed)
    surface = Surface(Cells.of_box(np.zeros(3), np.array([9.0, 5.0, 3.0])))
    for _ in range(3):
        new, cells = surface.add(rng.uniform(-1.0, 10.0, (200, 3)))
        assert set(cells) == set(surface.cells.numbers(new))
    voxel = np.floor(surface.points / surface.cells.spacing_m)
    assert len(np.unique(voxel, axis=0)) == len(surface.points)
    assert not len(surface.add(surface.points)[0])


def test_cells_are_near_cubes_about_a_hundred_of_them() -> None:
    cells = Cells.of_box(np.zeros(3), np.array([60.0, 10.0, 20.0]))
    assert 70 <= cells.count <= 140
    assert cells.size_m.max() / cells.size_m.min() < 1.6
    assert len(cells.around(0)) == 8


def test_batches_turn_with_the_world(track: Track) -> None:
    """In the view frame it makes no difference where north is."""
    pose, turned = _turned(track.walk.pose(12))
    batches = []
    for quarter, at in ((False, pose), (True, turned)):
        field = full_field(track, 13)
        if quarter:
            _turn(field)
        batches.append((field, at))
    rng = [np.random.default_rng(0), np.random.default_rng(0)]
    camera = track.shots[0].camera
    a, b = (gain_batch(f, camera, [at], at, 24, r) for (f, at), r in zip(batches, rng, strict=True))
    torch.testing.assert_close(a.to_camera, b.to_camera, atol=1e-4, rtol=1e-4)
    torch.testing.assert_close(a.tokens[..., 3], b.tokens[..., 3])


def _turned(pose: Pose) -> tuple[Pose, Pose]:
    x, y, z = pose.position_enu_m
    return pose, Pose((-y, x, z), pose.yaw_enu_rad + np.pi / 2.0, pose.elevation_rad)


def _turn(field: Field) -> None:
    field.proxies = np.stack([-field.proxies[:, 1], field.proxies[:, 0], field.proxies[:, 2]], axis=1)


def test_occupancy_is_asked_only_where_there_is_surface(track: Track) -> None:
    field = full_field(track, 13)
    queries = np.arange(len(field.proxies))
    batch = occupancy_batch(field, queries, track.walk.pose(12), 32, np.random.default_rng(0))
    assert batch is not None
    asked = field.proxy_cell[batch.numbers]
    assert all(len(field.surface.near(int(cell))) > 64 for cell in np.unique(asked))
    empty = track.field(100, 0)
    assert occupancy_batch(empty, np.arange(100), track.walk.pose(0), 32, np.random.default_rng(0)) is None


def test_supervision_reaches_farther_as_the_flight_goes_on(track: Track) -> None:
    field = track.field(100, 0)
    reach = [supervision_m(field, move) for move in range(0, 101, 10)]
    assert reach == sorted(reach)
    assert reach[0] == pytest.approx(3.0 * field.spacing_m)
    assert reach[-1] == pytest.approx(2.0 * field.cells.diagonal_m)


def test_the_command_trains_and_writes_what_tensorboard_reads(walk: Path, tmp_path: Path,
                                                             capsys: pytest.CaptureFixture[str]) -> None:
    sizes = ["picture_px=56x32", "batch=2", "depth_steps=2", "scone_steps=1", "proxies=800", "queries=30", "samples=16",
             "cloud_points=32", "cameras=3"]
    begin = [a for size in sizes for a in ("--set", size)]
    common = ["--scenes", str(walk.parent), "--validate", str(walk.parent), "--out", str(tmp_path), "--threads", "1",
              "--json", *begin]
    assert main([*common, "--epochs", "1"]) == 0
    assert main([*common, "--epochs", "2", "--resume"]) == 0
    told = json.loads(capsys.readouterr().out.split("\n}\n", 1)[1])
    assert [row["epoch"] for row in told["history"]] == [1.0, 2.0]
    assert {"depth", "occupancy", "validation/depth_abs_rel", "validation/gain_rank"} <= told["history"][0].keys()
    Networks.load(tmp_path / "weights")
    first = sorted((tmp_path / "log").iterdir())[0]
    tags = [value.tag for event in events(first) for value in event.summary.value]
    assert {"depth", "occupancy", "validation/depth_abs_rel"} <= set(tags)


def events(path: Path) -> list[Event]:
    """The records of an event file: length, its checksum, the event, its checksum."""
    content, at, found = path.read_bytes(), 0, []
    while at < len(content):
        length = int.from_bytes(content[at:at + 8], "little")
        found.append(Event.FromString(content[at + 12:at + 12 + length]))
        at += 16 + length
    return found


def test_strange_settings_are_refused(walk: Path, tmp_path: Path) -> None:
    common = ["--scenes", str(walk.parent), "--validate", "--out", str(tmp_path), "--epochs", "1"]
    with pytest.raises(UserError, match="profundity"):
        main([*common, "--set", "profundity=3"])
    with pytest.raises(UserError, match="split"):
        main(["--scenes", "split:nothing", "--validate", "--out", str(tmp_path), "--epochs", "1"])
