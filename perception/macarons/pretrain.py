"""Pretraining with the truth of procedural scenes, in place of ShapeNet: depth, occupancy, gains along known walks."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch.nn import functional

from missions.errors import UserError
from perception.macarons.augment import jittered, mirrored
from perception.macarons.depth_net import depth_from_disparity
from perception.macarons.field import UNKNOWN_OCCUPANCY, Field
from perception.macarons.inputs import gain_batch, occupancy_batch
from perception.macarons.learner import Learner
from perception.macarons.losses import normalised_l1, supervised_depth
from perception.macarons.tracks import Track, depth_examples

Losses = dict[str, list[float]]
PER_CELL = 16
DOUBT = 0.25
"""Standard deviation of the error that is put on the occupancy of proxies the network was not asked about."""


def depth_pass(learner: Learner, tracks: list[Track], steps: int, rng: np.random.Generator) -> Losses:
    """Updates of depth towards true depth, each on pictures of several walks."""
    losses = []
    for _ in range(steps):
        batch, truth = depth_examples(tracks, learner.settings.batch, rng)
        batch = jittered(batch, rng)
        if rng.random() < 0.5:
            batch, truth = mirrored(batch), truth.flip(-1)
        losses.append(learner.depth(batch, lambda out, truth=truth: supervised_depth(out, truth)))  # type: ignore[misc]
    return {"depth": losses}


def scone_pass(learner: Learner, track: Track, steps: int, rng: np.random.Generator) -> Losses:
    """Along one walk, maps of true depth grow; at `steps` of its key views occupancy and gain have an update each."""
    losses: Losses = {"occupancy": [], "gain": []}
    field, known = track.field(learner.settings.proxies, int(rng.integers(2**31))), np.zeros(0, dtype=np.int64)
    stops = _stops(track, steps, rng)
    for number, move in enumerate(track.moves[:max(stops, default=-1) + 1]):
        for frame in move:
            field.add(track.true_look(frame), learner.settings.share)
            known = np.union1d(known, track.shown[frame])
        if number in stops:
            losses["occupancy"] += _occupancy_update(learner, track, field, move[-1], rng)
            for _ in range(learner.settings.gains):
                losses["gain"] += _gain_update(learner, track, field, known, number, rng)
    return losses


def _stops(track: Track, steps: int, rng: np.random.Generator) -> set[int]:
    """Moves after which there is an update. Those at the walk's end only serve as candidates."""
    last = len(track.moves) - max(2, len(track.moves) // 8)
    if last < 2:
        raise UserError(f"{track.walk.scene}: a walk of {len(track.moves)} moves is too short to learn from; walk on.")
    chosen = rng.permutation(np.arange(1, last))[:steps]
    return {int(n) for n in chosen}


def _occupancy_update(learner: Learner, track: Track, field: Field, frame: int,
                      rng: np.random.Generator) -> list[float]:
    """What the network is not asked about is as well known, between not at all and well, as a network may know it."""
    open_queries = field.open_queries()
    truth = track.solid(field.proxies)
    field.settle()
    guess = UNKNOWN_OCCUPANCY + rng.random() * (truth[open_queries] - UNKNOWN_OCCUPANCY)
    field.occupancy[open_queries] = np.clip(guess + rng.normal(0.0, DOUBT, len(open_queries)), 0.0, 1.0)
    asked = cells_of(field, open_queries, learner.settings.queries, rng)
    batch = occupancy_batch(field, asked, track.walk.pose(frame), learner.settings.cloud_points, rng)
    if batch is None:
        return []
    error, predicted = learner.occupancy(batch, torch.from_numpy(truth[batch.numbers].astype(np.float32)))
    field.occupancy[batch.numbers] = predicted.numpy()
    return [error]


def cells_of(field: Field, queries: NDArray[np.int64], most: int, rng: np.random.Generator) -> NDArray[np.int64]:
    """At most so many queries, PER_CELL of each of some random cells: neighbours have the same answer too often to
    learn from them alone. A cell is as likely to be among them as it has queries, since all are asked in flight."""
    mixed = rng.permutation(queries)
    _, first = np.unique(field.proxy_cell[mixed], return_index=True)
    cells = field.proxy_cell[mixed[np.sort(first)]][:max(1, most // PER_CELL)]
    return np.concatenate([mixed[field.proxy_cell[mixed] == cell][:PER_CELL] for cell in cells])


def _gain_update(learner: Learner, track: Track, field: Field, known: NDArray[np.int64], number: int,
                 rng: np.random.Generator) -> list[float]:
    frames = gain_candidates(track, number, learner.settings.cameras, rng)
    truth = torch.tensor([float(len(np.setdiff1d(track.shown[f], known))) for f in frames])
    if float(truth.sum()) == 0.0:
        return []
    s = learner.settings
    poses = [track.walk.pose(f) for f in frames]
    batch = gain_batch(field, track.shots[0].camera, poses, track.walk.pose(track.moves[number][-1]), s.samples, rng)
    return [learner.gain(batch, truth)]


def gain_candidates(track: Track, number: int, count: int, rng: np.random.Generator) -> list[int]:
    """Key views that come later in the walk: they see what is new, what is known, and nothing at all."""
    later = [move[-1] for move in track.moves[number + 1:]]
    return [later[int(k)] for k in rng.permutation(len(later))[:count]]


def validation(learner: Learner, track: Track, rng: np.random.Generator) -> dict[str, float]:
    """The networks' errors on one walk: absolute relative depth error within range, its share below 1.25, the mean
    squared error of occupancy, the loss of gains and their rank correlation with the truth."""
    for net in learner.networks.named().values():
        net.eval()
    s = learner.settings
    with torch.no_grad():
        out = _depth_errors(learner, track, rng)
        field, known = track.field(s.proxies, int(rng.integers(2**31))), np.zeros(0, dtype=np.int64)
        middle = len(track.moves) // 3
        for frame in [f for move in track.moves[:middle + 1] for f in move]:
            field.add(track.true_look(frame), s.share)
            known = np.union1d(known, track.shown[frame])
        field.settle()
        pose = track.walk.pose(track.moves[middle][-1])
        batch = occupancy_batch(field, cells_of(field, field.open_queries(), 2 * s.queries, rng), pose, s.cloud_points,
                                rng)
        if batch is not None:
            predicted = batch.predict(learner.networks.occupancy).numpy()
            truth = track.solid(field.proxies[batch.numbers])
            out["occupancy_mse"] = float(((predicted - truth) ** 2).mean())
            field.occupancy[batch.numbers] = predicted
        frames = gain_candidates(track, middle, 24, rng)
        gains = gain_batch(field, track.shots[0].camera, [track.walk.pose(f) for f in frames], pose, s.samples, rng)
        found = gains.predict(learner.networks.gain)
        new = torch.tensor([float(len(np.setdiff1d(track.shown[f], known))) for f in frames])
        out["gain_l1"] = float(normalised_l1(found, new))
        out["gain_rank"] = _rank_correlation(found.numpy(), new.numpy())
    return out


def _depth_errors(learner: Learner, track: Track, rng: np.random.Generator) -> dict[str, float]:
    relative, close = [], []
    for _ in range(4):
        batch, truth = depth_examples([track], learner.settings.batch, rng)
        depth = depth_from_disparity(batch.predict(learner.networks.depth)[0])
        found = functional.interpolate(depth, size=truth.shape[-2:], mode="area")
        near = truth < 1.0
        ratio = found[near] / truth[near]
        relative.append(float((ratio - 1.0).abs().mean()))
        close.append(float((torch.maximum(ratio, 1.0 / ratio) < 1.25).float().mean()))
    return {"depth_abs_rel": float(np.mean(relative)), "depth_delta": float(np.mean(close))}


def _rank_correlation(a: NDArray[np.float32], b: NDArray[np.float32]) -> float:
    """Spearman's, 0 where either is constant."""
    ranks = [np.argsort(np.argsort(x, kind="stable")).astype(np.float64) for x in (a, b)]
    if np.ptp(a) == 0.0 or np.ptp(b) == 0.0:
        return 0.0
    return float(np.corrcoef(ranks[0], ranks[1])[0][1])
