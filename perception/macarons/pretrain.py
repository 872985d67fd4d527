"""Pretraining with the truth of procedural scenes, in place of ShapeNet: depth, occupancy, gains along known walks."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch.nn import functional

from missions.camera import Pose
from missions.errors import UserError
from perception.macarons.augment import jittered, mirrored
from perception.macarons.depth_net import depth_from_disparity
from perception.macarons.field import UNKNOWN_OCCUPANCY, Field
from perception.macarons.inputs import OccupancyBatch, gain_batch, joined, occupancy_batch
from perception.macarons.learner import Learner
from perception.macarons.losses import normalised_l1, supervised_depth
from perception.macarons.tracks import Track, depth_examples

Losses = dict[str, list[float]]
PER_CELL = 8
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


class Growing:
    """A walk that is looked at move by move: its map of true depth so far, and the voxels that were shown."""

    def __init__(self, learner: Learner, track: Track, seed: int) -> None:
        self.track, self.number = track, -1
        self.field, self.known = track.field(learner.settings.proxies, seed), np.zeros(0, dtype=np.int64)
        self._share = learner.settings.share

    def go_to(self, number: int) -> None:
        """Look at the moves as far as this one."""
        for move in self.track.moves[self.number + 1:number + 1]:
            for frame in move:
                self.field.add(self.track.true_look(frame), self._share)
                self.known = np.union1d(self.known, self.track.shown[frame])
        self.number = number

    @property
    def pose(self) -> Pose:
        """Of the last key view."""
        return self.track.walk.pose(self.track.moves[self.number][-1])


def scone_pass(learner: Learner, tracks: list[Track], steps: int, rng: np.random.Generator) -> Losses:
    """Along some walks at once maps grow; at `steps` of the key views of each occupancy and gain have updates.

    An update of occupancy asks about all the walks: from one after the other it learns little more than the share of
    the last one that is solid.
    """
    losses: Losses = {"occupancy": [], "gain": []}
    walks = [Growing(learner, track, int(rng.integers(2**31))) for track in tracks]
    for numbers in zip(*(sorted(_stops(track, steps, rng)) for track in tracks), strict=False):
        for walk, number in zip(walks, numbers, strict=True):
            walk.go_to(number)
        for _ in range(learner.settings.asks):
            losses["occupancy"] += _occupancy_update(learner, walks, rng)
        for _ in range(learner.settings.gains):
            for walk in walks:
                losses["gain"] += _gain_update(learner, walk, rng)
    return losses


def _stops(track: Track, steps: int, rng: np.random.Generator) -> set[int]:
    """Moves after which there is an update. Those at the walk's end only serve as candidates."""
    last = len(track.moves) - max(2, len(track.moves) // 8)
    if last < 2:
        raise UserError(f"{track.walk.scene}: a walk of {len(track.moves)} moves is too short to learn from; walk on.")
    chosen = rng.permutation(np.arange(1, last))[:steps]
    return {int(n) for n in chosen}


def _occupancy_update(learner: Learner, walks: list[Growing], rng: np.random.Generator) -> list[float]:
    found = [(walk.field, truth, batch) for walk in walks for truth, batch in [_asked(learner, walk, len(walks), rng)]
             if batch is not None]
    if not found:
        return []
    truths = np.concatenate([truth[batch.numbers] for _, truth, batch in found]).astype(np.float32)
    error, predicted = learner.occupancy(joined([batch for _, _, batch in found]), torch.from_numpy(truths))
    parts = torch.split(predicted, [len(batch.numbers) for _, _, batch in found])
    for (field, _, batch), part in zip(found, parts, strict=True):
        field.occupancy[batch.numbers] = part.numpy()
    return [error]


def _asked(learner: Learner, walk: Growing, among: int,
           rng: np.random.Generator) -> tuple[NDArray[np.bool_], OccupancyBatch | None]:
    """Which proxies are solid, and one walk's part of the queries.

    What the network is not asked about is as well known, between not at all and well, as a network may know it.
    """
    field, s = walk.field, learner.settings
    open_queries, truth = field.open_queries(), walk.track.solid(field.proxies)
    field.settle()
    guess = UNKNOWN_OCCUPANCY + rng.random() * (truth[open_queries] - UNKNOWN_OCCUPANCY)
    field.occupancy[open_queries] = np.clip(guess + rng.normal(0.0, DOUBT, len(open_queries)), 0.0, 1.0)
    if not len(open_queries):
        return truth, None
    asked = cells_of(field, open_queries, s.queries // among, rng)
    return truth, occupancy_batch(field, asked, walk.pose, s.cloud_points, rng)


def cells_of(field: Field, queries: NDArray[np.int64], most: int, rng: np.random.Generator) -> NDArray[np.int64]:
    """At most so many queries, PER_CELL of each of some random cells: neighbours have the same answer too often to
    learn from them alone. A cell is as likely to be among them as it has queries, since all are asked in flight."""
    mixed = rng.permutation(queries)
    _, first = np.unique(field.proxy_cell[mixed], return_index=True)
    cells = field.proxy_cell[mixed[np.sort(first)]][:max(1, most // PER_CELL)]
    return np.concatenate([mixed[field.proxy_cell[mixed] == cell][:PER_CELL] for cell in cells])


def _gain_update(learner: Learner, walk: Growing, rng: np.random.Generator) -> list[float]:
    track, s = walk.track, learner.settings
    frames = gain_candidates(track, walk.number, s.cameras, rng)
    truth = torch.tensor([float(len(np.setdiff1d(track.shown[f], walk.known))) for f in frames])
    if float(truth.sum()) == 0.0:
        return []
    poses = [track.walk.pose(f) for f in frames]
    batch = gain_batch(walk.field, track.shots[0].camera, poses, walk.pose, s.samples, rng)
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
        walk, middle = Growing(learner, track, int(rng.integers(2**31))), len(track.moves) // 3
        walk.go_to(middle)
        field, pose = walk.field, walk.pose
        field.settle()
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
        new = torch.tensor([float(len(np.setdiff1d(track.shown[f], walk.known))) for f in frames])
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
