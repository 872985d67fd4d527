"""Learning in flight, from pictures and poses alone, with replay of what was flown before (MACARONS, section 4)."""

from __future__ import annotations

import math

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from missions.camera import Pose
from missions.frames import Array
from perception.macarons.augment import jittered
from perception.macarons.field import Field, Look
from perception.macarons.inputs import GainBatch, gain_batch, occupancy_batch
from perception.macarons.learner import Learner
from perception.macarons.losses import photometric
from perception.macarons.memory import DEPTHS_EVERY, Memory, Trajectory
from perception.macarons.pretrain import Losses, cells_of
from perception.macarons.shots import Shot, depth_batch, look_of
from perception.macarons.tracks import Track

POSES = 100
"""Moves over which the curriculum grows."""
FIRST_CELLS, LAST_CELLS = 5, 20
FIRST_SPACINGS, LAST_DIAGONALS = 3.0, 2.0
MOST_REPLAYED_LOOKS = 29
REPLAY_CURRICULUM = 50


class OnlineLearner:
    """Follows one trajectory move by move: predicts, maps, and learns from what the next pictures say."""

    def __init__(self, learner: Learner, memory: Memory, field: Field, seed: int) -> None:
        self.learner, self.memory, self.field, self._seed = learner, memory, field, seed
        self._rng = np.random.default_rng([seed, 0x4F4E])
        self._shots: list[Shot] = []
        self._looks: list[Look] = []
        self._frames = self._moves = 0
        self._last: Pose | None = None

    def move(self, shots: list[Shot]) -> Losses:
        """Take in the pictures of a move, in order, the first of them where the move began, the last the key view."""
        losses: Losses = {"photometric": [], "occupancy_online": [], "gain_online": []}
        if len(shots) >= 3:
            losses["photometric"] += self._learn_depth(shots)
        looks = looks_of(self.learner, shots, self.field.range_m)
        losses["gain_online"] += self._map(looks)
        losses["occupancy_online"] += learn_occupancy(self.learner, self.field, self.field.solid(), shots[-1].pose,
                                                      self._moves, self._rng)
        if self.memory.trajectories:
            self._replay(losses)
        self._moves += 1
        self._shots += shots[1:]
        return losses

    def end(self) -> None:
        """The trajectory goes to the memory."""
        if self._looks and self._shots:
            f = self.field
            self.memory.add(Trajectory(self._shots, self._looks, f.lower_enu_m, f.upper_enu_m, f.range_m, self._seed,
                                       f.solid()))

    def _learn_depth(self, shots: list[Shot]) -> list[float]:
        windows = [shots[k:k + 4] for k in range(len(shots) - 3)] or [[*shots[:3], shots[1]]]
        return [learn_depth(self.learner, windows, self.field.range_m, self._rng)]

    def _map(self, looks: list[Look]) -> list[float]:
        """Predict what the first four pictures of the move bring, see it, and learn from the difference."""
        cameras = looks[:4]
        batch = _gains(self.learner, self.field, cameras, self._rng)
        new = [np.zeros((0, 3))]
        for look in looks:
            if look.pose == self._last:
                continue
            new.append(self.field.add(look, self.learner.settings.share))
            self._last = look.pose
            if self._frames % DEPTHS_EVERY == 0:
                self._looks.append(look)
            self._frames += 1
        return learn_gain(self.learner, batch, np.concatenate(new), cameras, self.field)

    def _replay(self, losses: Losses) -> None:
        s = self.learner.settings
        for _ in range(s.replays):
            t = self.memory.trajectories[int(self._rng.integers(len(self.memory.trajectories)))]
            starts = [int(k) for k in self._rng.integers(0, max(1, len(t.shots) - 3), s.batch)]
            windows = [t.shots[k:k + 4] for k in starts]
            if all(len(w) == 4 for w in windows):
                losses["photometric"].append(learn_depth(self.learner, windows, t.range_m, self._rng))
            replayed = replay_scone(self.learner, t, self._rng)
            for name, values in replayed.items():
                losses[name] += values


def looks_of(learner: Learner, shots: list[Shot], range_m: float) -> list[Look]:
    """Predicted depth maps of a move's pictures, each from the two nearest others; none of fewer than three."""
    if len(shots) < 3:
        return []
    sources = [sorted((n for n in range(len(shots)) if n != k), key=lambda n: abs(n - k))[:2]
               for k in range(len(shots))]
    learner.networks.depth.eval()
    with torch.no_grad():
        out = depth_batch(shots, [[shots[n] for n in row] for row in sources], range_m).predict(learner.networks.depth)
    return [look_of(d, shot, range_m) for d, shot in zip(out[0], shots, strict=True)]


def learn_depth(learner: Learner, windows: list[list[Shot]], range_m: float, rng: np.random.Generator) -> float:
    """One update on windows t-2, t-1, t, t+1: t's depth, from t-1 and t-2, must explain t by all three others."""
    targets = [w[2] for w in windows]
    batch = jittered(depth_batch(targets, [[w[1], w[0]] for w in windows], range_m), rng)
    others = depth_batch(targets, [[w[1], w[0], w[3]] for w in windows], range_m)
    foreground = torch.from_numpy(np.stack([~t.sky for t in targets]).astype(np.float32))[:, None]
    plain = depth_batch(targets, [[w[1], w[0]] for w in windows], range_m)
    return learner.depth(batch, lambda out: photometric(out, plain, others.sources, others.source_from_target,
                                                        foreground))


def supervision_m(field: Field, move: int) -> float:
    """How near a surface a proxy must have been seen to be learnt from: grows with the moves, by an arc tangent."""
    first, last = FIRST_SPACINGS * field.spacing_m, LAST_DIAGONALS * field.cells.diagonal_m
    share = math.atan(4.0 * min(move, POSES) / POSES) / math.atan(4.0)
    return float(first + (last - first) * share)


def learn_occupancy(learner: Learner, field: Field, solid: NDArray[np.bool_], pose: Pose, move: int,
                    rng: np.random.Generator) -> list[float]:
    """One update towards carving's verdict in some cells; updates what the field believes."""
    field.settle()
    near = np.flatnonzero((field.looks > 0) & (field.nearest_m < supervision_m(field, move)))
    cells = rng.permutation(np.unique(field.proxy_cell[near]))
    cells = cells[:round(FIRST_CELLS + (LAST_CELLS - FIRST_CELLS) * min(move, POSES) / POSES)]
    asked = cells_of(field, near[np.isin(field.proxy_cell[near], cells)], learner.settings.queries, rng)
    batch = occupancy_batch(field, asked, pose, learner.settings.cloud_points, rng) if len(asked) else None
    if batch is None:
        return []
    error, predicted = learner.occupancy(batch, torch.from_numpy(solid[batch.numbers].astype(np.float32)))
    field.occupancy[batch.numbers] = predicted.numpy()
    field.settle()
    return [error]


def _gains(learner: Learner, field: Field, cameras: list[Look], rng: np.random.Generator) -> GainBatch | None:
    if len(cameras) < 2 or not len(field.surface.points):
        return None
    return gain_batch(field, cameras[0].camera, [look.pose for look in cameras], cameras[0].pose,
                      learner.settings.samples, rng)


def learn_gain(learner: Learner, batch: GainBatch | None, new_enu_m: Array, cameras: list[Look],
               field: Field) -> list[float]:
    """One update towards what each camera had of the move's new surface, beyond what the first one sees."""
    if batch is None or not len(new_enu_m) or not float(batch.volume.sum()):
        return []
    spacing = field.cells.spacing_m
    near = []
    for look in cameras:
        points = look.points(field.range_m)
        near.append(cKDTree(points).query(new_enu_m)[0] < spacing if len(points) else np.zeros(len(new_enu_m), bool))
    truth = torch.tensor([float((mine & ~near[0]).sum()) for mine in near])
    return [learner.gain(batch, truth)] if float(truth.sum()) else []


def replay_scone(learner: Learner, t: Trajectory, rng: np.random.Generator) -> Losses:
    """A partial state from some consecutive depth maps of a trajectory; the ones after it supervise."""
    if len(t.looks) < 5:
        return {}
    count = int(rng.integers(1, min(MOST_REPLAYED_LOOKS, len(t.looks) - 4) + 1))
    first = int(rng.integers(0, len(t.looks) - 3 - count))
    field = Field(t.lower_enu_m, t.upper_enu_m, t.range_m, len(t.solid), t.seed)
    for look in t.looks[first:first + count]:
        field.add(look, learner.settings.share)
    cameras = t.looks[first + count - 1:first + count + 3]
    error = learn_occupancy(learner, field, t.solid, cameras[0].pose, int(rng.integers(REPLAY_CURRICULUM)), rng)
    batch = _gains(learner, field, cameras, rng)
    new = [field.add(look, learner.settings.share) for look in cameras[1:]]
    return {"occupancy_online": error, "gain_online": learn_gain(learner, batch, np.concatenate(new), cameras, field)}


def online_pass(learner: Learner, memory: Memory, track: Track, rng: np.random.Generator) -> Losses:
    """One walk, learnt from as if it were flown now."""
    seed = int(rng.integers(2**31))
    online = OnlineLearner(learner, memory, track.field(learner.settings.proxies, seed), seed)
    losses: Losses = {}
    for move in track.moves:
        for name, values in (online.move([track.shots[n] for n in move]) if len(move) >= 3 else {}).items():
            losses.setdefault(name, []).extend(values)
    online.end()
    return losses
