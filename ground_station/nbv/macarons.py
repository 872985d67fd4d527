"""Method "macarons": one step to the view with the most gain, by MACARONS' three networks (Guédon et al., CVPR 2023).

From pictures and poses alone: the foreground is what its own depth and sky estimate say, and where it may fly what its
own map has seen past. The published release takes both from the true mesh.
"""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np
import torch

from ground_station.nbv.options import options_of
from missions.camera import Pose
from missions.nbv_trial import Choice, Frame, TrialBrief
from missions.pose_lattice import Index5
from perception.macarons.field import Field
from perception.macarons.inputs import gain_batch, occupancy_batch
from perception.macarons.learner import Learner, LearnSettings
from perception.macarons.memory import Memory
from perception.macarons.online import OnlineLearner
from perception.macarons.shots import Shot, depth_batch, look_of, make_shot
from perception.macarons.weights import SHIPPED, Networks

BATCH = 4
"""Depth maps that are predicted at once."""


class MacaronsOptions(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What `--option NAME=VALUE` can change."""

    weights: str = ""
    """A folder with depth, occupancy and gain .safetensors; those that ship when left out."""
    adapt: bool = False
    """Learn in flight from the pictures of the flight."""
    proxies: int = 12_000
    queries: int = 1500
    """Proxies whose occupancy is asked for anew per decision, at most."""
    samples: int = 256
    cloud_points: int = 256
    width_px: int = 228
    height_px: int = 128
    share: float = 0.2
    """Of a depth map's points that go to the surface."""
    threads: int = 0
    """Of torch; 0 leaves its own choice."""


def make_macarons(brief: TrialBrief) -> Macarons:
    """The method for a trial. Raises UserError for options that it does not have."""
    options = options_of(brief, MacaronsOptions)
    if options.threads:
        torch.set_num_threads(options.threads)
    return Macarons(brief, options, Networks.load(Path(options.weights) if options.weights else SHIPPED))


class Macarons:
    """The maps and networks of one trial; all vehicles share them."""

    def __init__(self, brief: TrialBrief, options: MacaronsOptions, networks: Networks) -> None:
        self._brief, self._options, self._lattice, self._networks = brief, options, brief.lattice, networks
        lower, upper = np.array(brief.object_min_enu_m), np.array(brief.object_max_enu_m)
        spacing = float(np.prod(upper - lower) / options.proxies) ** (1.0 / 3.0)
        lower[2] = min(max(lower[2], brief.ground_up_m + 0.5 * spacing), upper[2] - spacing)
        self.field = Field(lower, upper, brief.sensing_range_m, options.proxies, brief.seed)
        self._random = np.random.default_rng([brief.seed, 0x4E4256])
        self._shots: dict[int, list[Shot]] = {vehicle: [] for vehicle in range(1, len(brief.starts) + 1)}
        self._mapped = dict.fromkeys(self._shots, 0)
        self._at = dict(enumerate(brief.starts, 1))
        self._came_from = {vehicle: start[:3] for vehicle, start in self._at.items()}
        self._visited: set[Index5] = set(brief.starts)
        self._online: dict[int, OnlineLearner] = {}
        if options.adapt:
            learner = Learner(networks, LearnSettings(
                picture_px=(options.width_px, options.height_px), depth_rate=1e-5, occupancy_rate=1e-5, gain_rate=1e-5,
                proxies=options.proxies, samples=options.samples, share=options.share, replays=0, warm_up=1))
            self._online = {v: OnlineLearner(learner, Memory(0), self.field, brief.seed + v) for v in self._shots}

    def see(self, frame: Frame) -> None:
        """Takes a picture in; it is mapped at the next decision, when those before and after it are there."""
        size = self._options.width_px, self._options.height_px
        self._shots[frame.vehicle].append(make_shot(frame.rgb, self._brief.camera, frame.pose, size))

    def choose(self, vehicle: int, candidates: list[Index5]) -> Choice:
        """The candidate with the largest predicted gain among those not visited yet whose way the map has seen past."""
        for v in self._shots:
            self._map(v)
        here = self._lattice.pose(self._at[vehicle])
        self._update_occupancy(here)
        options = self._reachable(vehicle, candidates)
        gains = self._gains([self._lattice.pose(c) for c in options], here)
        best = int(gains.argmax())
        self._came_from[vehicle], self._at[vehicle] = self._at[vehicle][:3], options[best]
        self._visited.add(options[best])
        return Choice(vehicle=vehicle, index=options[best], predicted_gain=float(gains[best]) * self.field.spacing_m**2)

    def _map(self, vehicle: int) -> None:
        """Depth of the pictures since the last decision, into the field."""
        shots, first = self._shots[vehicle], self._mapped[vehicle]
        if len(shots) < 3 or first == len(shots):
            return
        self._mapped[vehicle] = len(shots)
        if self._online:
            self._online[vehicle].move(shots[max(0, first - 1):])
            for net in self._networks.named().values():
                net.eval()
            return
        for at in range(first, len(shots), BATCH):
            targets = list(range(at, min(at + BATCH, len(shots))))
            sources = [[shots[n] for n in ((k - 1, k - 2) if k >= 2 else (1 - k, 2))] for k in targets]
            batch = depth_batch([shots[k] for k in targets], sources, self.field.range_m)
            with torch.no_grad():
                finest = batch.predict(self._networks.depth)[0]
            for disparity, k in zip(finest, targets, strict=True):
                self.field.add(look_of(disparity, shots[k], self.field.range_m), self._options.share)

    def _update_occupancy(self, here: Pose) -> None:
        """Ask for the occupancy of what is open in cells that changed, the nearest first."""
        field = self.field
        field.settle()
        queries = field.open_queries()
        queries = queries[field.changed[field.proxy_cell[queries]]]
        away = np.linalg.norm(field.cells.centres() - np.array(here.position_enu_m), axis=1)
        queries = queries[np.lexsort((field.proxy_cell[queries], away[field.proxy_cell[queries]]))]
        queries = queries[:self._options.queries]
        field.occupancy[queries] = 0.0
        field.changed[field.proxy_cell[queries]] = False
        batch = occupancy_batch(field, queries, here, self._options.cloud_points, self._random)
        if batch is not None:
            with torch.no_grad():
                field.occupancy[batch.numbers] = batch.predict(self._networks.occupancy).numpy()

    def _reachable(self, vehicle: int, candidates: list[Index5]) -> list[Index5]:
        """Candidates not visited yet with the least in their way; back to where the vehicle came from where that is
        less."""
        start = np.array(self._lattice.pose(self._at[vehicle]).position_enu_m)
        ways = {c[:3]: np.array(self._lattice.pose(c).position_enu_m) for c in candidates}
        blocked = {cell: self.field.blocked(start, end, self._brief.fleet.clearance_m) for cell, end in ways.items()}
        if self._came_from[vehicle] in blocked:
            blocked[self._came_from[vehicle]] = 0
        clear = [c for c in candidates if blocked[c[:3]] == 0]
        if not clear:
            least = min(blocked.values())
            clear = [c for c in candidates if blocked[c[:3]] == least]
        return [c for c in clear if c not in self._visited] or clear

    def _gains(self, poses: list[Pose], here: Pose) -> np.ndarray[tuple[int], np.dtype[np.float32]]:
        """Predicted gains, all candidates in one pass."""
        batch = gain_batch(self.field, self._brief.camera, poses, here, self._options.samples, self._random)
        with torch.no_grad():
            gains: np.ndarray[tuple[int], np.dtype[np.float32]] = batch.predict(self._networks.gain).numpy()
        return gains
