"""How much new surface a camera would see, from the likely solid points in its view (SconeVis)."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional

from perception.macarons.attention import Block
from perception.macarons.harmonics import COEFFICIENTS, harmonics


class GainNet(nn.Module):
    """1,392,888 parameters. Gives per point a function on the sphere: how visible, and new, it is from where."""

    WIDTH, KEY_WIDTH, EMBEDDING = 256, 64, 126

    def __init__(self) -> None:
        super().__init__()
        self.first, self.second = nn.Linear(4, self.EMBEDDING), nn.Linear(self.EMBEDDING, self.EMBEDDING)
        self.blocks = nn.ModuleList(Block(self.WIDTH, self.KEY_WIDTH) for _ in range(3))
        self.norm, self.narrow = nn.LayerNorm(self.WIDTH), nn.Linear(self.WIDTH, 192)
        self.mix = nn.Linear(192 + COEFFICIENTS, 128)
        self.last = nn.Linear(128, COEFFICIENTS)

    def forward(self, tokens: Tensor, views: Tensor, present: Tensor) -> Tensor:
        """(c, n, 64) harmonics of visibility per point.

        tokens: (c, n, 4) x, y, z and occupancy of what c cameras have in view; views: (c, n, 64) view harmonics;
        present: (c, n) bool, false for padding, true at least once for every camera.
        """
        x = self.second(functional.gelu(self.first(tokens)))
        most = x.masked_fill(~present[..., None], -torch.inf).amax(dim=1, keepdim=True)
        x = torch.cat([x, most.expand_as(x), tokens], dim=-1)
        for block in self.blocks:
            x = block(x, present)
        x = functional.gelu(self.narrow(self.norm(x)))
        x = self.mix(torch.cat([x, views], dim=-1))
        x = functional.gelu(functional.layer_norm(x, x.shape[-1:]))
        result: Tensor = self.last(x)
        return result


def visibility(coefficients: Tensor, to_camera: Tensor) -> Tensor:
    """(..., n) in 0-1: functions (..., n, 64) in the unit directions (..., n, 3) from points to camera."""
    return torch.sigmoid((coefficients * harmonics(to_camera)).sum(dim=-1))


def gain(seen: Tensor, count: Tensor, volume: Tensor) -> Tensor:
    """(c,) coverage gain: what samples (c, n) see, drawn `count` times each, times the solid volume (c,) in view."""
    return (seen * count).sum(dim=-1) / count.sum(dim=-1).clamp(min=1.0) * volume
