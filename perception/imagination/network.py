"""A small perceptron from what is known around a voxel to how likely it is solid, trained in torch."""

from __future__ import annotations

from itertools import pairwise

import torch
from torch import Tensor, nn

from perception.imagination.surroundings import COUNT

HIDDEN = 48
LAYERS = 2


class ImaginationNet(nn.Module):
    """(n, COUNT) numbers to (n,) logits of solid. mean and scale (COUNT,) bring the numbers to one size."""

    def __init__(self) -> None:
        super().__init__()
        self.register_buffer("mean", torch.zeros(COUNT))
        self.register_buffer("scale", torch.ones(COUNT))
        sizes = [COUNT, *[HIDDEN] * LAYERS]
        self.hidden = nn.ModuleList(nn.Linear(a, b) for a, b in pairwise(sizes))
        self.out = nn.Linear(HIDDEN, 1)

    def standardise(self, samples: Tensor) -> None:
        """Set mean and scale to those of samples (n, COUNT)."""
        self.mean: Tensor = samples.mean(dim=0)
        self.scale: Tensor = 1.0 / samples.std(dim=0).clamp_min(1e-3)

    def forward(self, x: Tensor) -> Tensor:
        """See the class."""
        x = (x - self.mean) * self.scale
        for layer in self.hidden:
            x = torch.relu(layer(x))
        result: Tensor = self.out(x)[:, 0]
        return result
