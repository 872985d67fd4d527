"""How likely points of space are solid, from the surface found so far around them (SconeOcc)."""

from __future__ import annotations

import math

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from torch import Tensor, nn
from torch.nn import functional

from perception.macarons.attention import PointEncoder
from perception.macarons.harmonics import COEFFICIENTS

SCALES, NEIGHBOURS = 3, 16
GLOBAL, LOCAL, PLACE = 512, 256, 512


class OccupancyNet(nn.Module):
    """2,257,769 parameters."""

    def __init__(self) -> None:
        super().__init__()
        self.whole = PointEncoder(GLOBAL)
        self.near = nn.ModuleList(PointEncoder(LOCAL) for _ in range(SCALES))
        self.place = nn.ModuleList([nn.Linear(3, 128), nn.Linear(128, 256), nn.Linear(256, PLACE)])
        width = GLOBAL + SCALES * LOCAL + PLACE + COEFFICIENTS
        self.head = nn.ModuleList([nn.Linear(width, 512), nn.Linear(512, 256), nn.Linear(256, 1)])

    def forward(self, clouds: Tensor, queries: Tensor, cloud_of_query: Tensor, neighbours: Tensor,
                views: Tensor) -> Tensor:
        """(q,) probabilities that the queries are solid.

        clouds: (c, n, 3) surface points around c cells; queries: (q, 3); cloud_of_query: (q,) int64; neighbours:
        (q, 3, 16, 3) offsets to the nearest surface points at three densities; views: (q, 64) view harmonics.
        """
        parts = [self.whole(clouds)[cloud_of_query]]
        parts += [encoder(neighbours[:, scale]) for scale, encoder in enumerate(self.near)]
        place = queries
        for layer in self.place:
            place = functional.gelu(layer(place))
        x = torch.cat([*parts, place, views], dim=-1)
        for layer in self.head[:-1]:
            x = layer(x)
            x = functional.gelu(functional.layer_norm(x, x.shape[-1:]))
        return torch.sigmoid(self.head[-1](x).squeeze(-1))


def neighbourhoods(points: NDArray[np.float32], queries: NDArray[np.float32],
                   rng: np.random.Generator) -> NDArray[np.float32]:
    """(q, 3, 16, 3) offsets from queries (q, 3) to their nearest points (n, 3), at n points, and at ever fewer.

    From one density to the next the cloud is thinned at random by floor(sqrt(n / 128)), by 2 where that is 0.
    """
    factor = math.floor(math.sqrt(len(points) / 128)) or 2
    out = np.zeros((len(queries), SCALES, NEIGHBOURS, 3), dtype=np.float32)
    for scale in range(SCALES):
        count = min(NEIGHBOURS, len(points))
        _, index = cKDTree(points).query(queries, k=range(1, count + 1))
        out[:, scale, :count] = points[index] - queries[:, None]
        out[:, scale, count:] = out[:, scale, count - 1:count]
        points = points[rng.permutation(len(points))[:max(1, len(points) // factor)]]
    return out
