"""One update at a time of each network, whoever says what is true: AdamW with a linear warm-up, as MACARONS."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import msgspec
import torch
from torch import Tensor, nn

from perception.macarons.inputs import GainBatch, OccupancyBatch
from perception.macarons.losses import normalised_l1
from perception.macarons.resnet import finite
from perception.macarons.shots import DepthBatch
from perception.macarons.weights import Networks

FULL_QUERIES = 6000
"""MACARONS weighs the loss of an occupancy batch by its share of so many queries."""


class LearnSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Sizes and rates. The defaults are what a CPU can afford; MACARONS' own numbers stand beside them."""

    picture_px: tuple[int, int] = (228, 128)
    """456 x 256."""
    batch: int = 4
    depth_rate: float = 1e-4
    occupancy_rate: float = 1e-4
    """1e-4 while pretraining, 1e-5 online."""
    gain_rate: float = 1e-4
    warm_up: int = 200
    """Updates until the full rate."""
    fall: int = 0
    """Updates after those in which the rate falls to nothing along half a cosine; 0: it stays, as MACARONS'."""
    proxies: int = 12_000
    """100,000."""
    cloud_points: int = 512
    """2048."""
    queries: int = 600
    """6000."""
    samples: int = 256
    """2048."""
    cameras: int = 8
    """Views whose gains are compared in one update while pretraining: 52. Online it is 4."""
    asks: int = 1
    """Updates of occupancy per state of the maps while pretraining, each on other queries."""
    gains: int = 4
    """Updates of gain per state of the map while pretraining, each on other views: 1."""
    share: float = 0.2
    """Of a depth map's points that go to the surface: 0.05 of four times as many pixels."""
    replays: int = 2
    """Memory replays per move online: 4 of depth, 2 of the others."""
    memory: int = 8
    """Trajectories kept: 5 per scene."""
    seed: int = 1


@dataclass
class Part:
    """One network, its optimiser, and how many updates it has had."""

    net: nn.Module
    optimiser: torch.optim.AdamW
    rate: float
    warm_up: int
    fall: int = 0
    updates: int = 0

    def step(self, loss: Tensor) -> float:
        """One update; the loss. A loss that is not finite changes nothing."""
        self.updates += 1
        for group in self.optimiser.param_groups:
            group["lr"] = self.rate * self._share_of_rate()
        value = float(loss.detach())
        if value != value or value in (float("inf"), float("-inf")):
            return value
        self.optimiser.zero_grad(set_to_none=True)
        loss.backward()  # type: ignore[no-untyped-call]
        nn.utils.clip_grad_norm_(self.net.parameters(), 1.0)
        self.optimiser.step()
        return value

    def _share_of_rate(self) -> float:
        """Linear warm-up, then the fall."""
        if self.updates <= self.warm_up or not self.fall:
            return min(1.0, self.updates / self.warm_up)
        return 0.5 + 0.5 * math.cos(math.pi * min(1.0, (self.updates - self.warm_up) / self.fall))


class Learner:
    """The networks and their optimisers."""

    def __init__(self, networks: Networks, settings: LearnSettings) -> None:
        self.networks, self.settings = networks, settings
        rates = {"depth": settings.depth_rate, "occupancy": settings.occupancy_rate, "gain": settings.gain_rate}
        self.parts = {name: Part(net, torch.optim.AdamW(net.parameters(), lr=rates[name], fused=True), rates[name],
                                 settings.warm_up, settings.fall)
                      for name, net in networks.named().items()}

    def occupancy(self, batch: OccupancyBatch, solid: Tensor) -> tuple[float, Tensor]:
        """One update towards solid (q,), 0 or 1; the mean squared error and the predictions."""
        self.networks.occupancy.train()
        predicted = batch.predict(self.networks.occupancy)
        error = torch.mean((predicted - solid) ** 2)
        self.parts["occupancy"].step(error * min(1.0, len(solid) / min(FULL_QUERIES, self.settings.queries)))
        return float(error.detach()), predicted.detach()

    def gain(self, batch: GainBatch, truth: Tensor) -> float:
        """One update towards gains (c,), of which only the ratios count; the loss."""
        self.networks.gain.train()
        return self.parts["gain"].step(normalised_l1(batch.predict(self.networks.gain), truth))

    def depth(self, batch: DepthBatch, loss_of: Callable[[list[Tensor]], Tensor]) -> float:
        """One update of depth; the loss."""
        self.networks.depth.train()
        return self.parts["depth"].step(loss_of(batch.predict(self.networks.depth)))

    def sound(self) -> bool:
        """Whether no network has run away."""
        return all(finite(net) for net in self.networks.named().values())
