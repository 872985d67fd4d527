"""What one update of MACARONS' networks is asked: batches of several maps, views of nothing, the rate."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from perception.macarons.inputs import gain_batch, joined, occupancy_batch
from perception.macarons.learner import Learner, LearnSettings
from perception.macarons.tracks import Track, depth_examples
from perception.macarons.weights import Networks
from tests.walk_scene import full_field, wall_walk

pytestmark = pytest.mark.xdist_group("macarons")


@pytest.fixture(scope="module")
def track(tmp_path_factory: pytest.TempPathFactory) -> Track:
    folder: Path = tmp_path_factory.mktemp("walks")
    return Track.read(wall_walk(folder), (112, 64), 25.0)


def test_queries_of_several_maps_are_answered_together_as_alone(track: Track) -> None:
    net, rng, pose = Networks.fresh(1).occupancy.eval(), np.random.default_rng(0), track.walk.pose(12)
    fields = [full_field(track, 13), full_field(track, 9)]
    batches = [occupancy_batch(f, rng.permutation(f.open_queries())[:40], pose, 64, rng) for f in fields]
    first, second = (batch for batch in batches if batch is not None)
    with torch.no_grad():
        alone = torch.cat([first.predict(net), second.predict(net)])
        torch.testing.assert_close(joined([first, second]).predict(net), alone, atol=1e-5, rtol=1e-4)


def test_the_rate_rises_and_then_falls_to_nothing() -> None:
    part = Learner(Networks.fresh(1), LearnSettings(gain_rate=1e-3, warm_up=2, fall=4)).parts["gain"]
    rates = []
    for _ in range(7):
        part.step(torch.stack([p.sum() for p in part.net.parameters()]).sum())
        rates.append(part.optimiser.param_groups[0]["lr"])
    assert rates == pytest.approx([5e-4, 1e-3, 8.536e-4, 5e-4, 1.464e-4, 0.0, 0.0], abs=1e-6)


def test_views_of_nothing_have_no_gain(track: Track) -> None:
    field, rng, pose = full_field(track, 3), np.random.default_rng(0), track.walk.pose(2)
    field.occupancy[:] = 0.0
    views = gain_batch(field, track.shots[0].camera, [pose, track.walk.pose(4)], pose, 24, rng)
    with torch.no_grad():
        assert views.predict(Networks.fresh(1).gain).tolist() == [0.0, 0.0]


def test_sources_lie_on_one_side_of_the_picture_as_in_flight(track: Track) -> None:
    moves = {shot.pose: number for number, shot in enumerate(track.shots)}
    for seed in range(12):
        target, sources, _ = track.depth_example(np.random.default_rng(seed))
        steps = [moves[source.pose] - moves[target.pose] for source in sources]
        assert steps in ([-1, -2], [1, 2])
    assert depth_examples([track], 2, np.random.default_rng(0))[0].sources.shape[:2] == (2, 2)
