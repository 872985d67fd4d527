"""Transformer blocks over sets of points, as both SCONE modules use them (Guédon et al., NeurIPS 2022)."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional

HEADS = 4


class Block(nn.Module):
    """Pre-norm attention of four heads and a two-fold GELU feed-forward layer."""

    def __init__(self, width: int, key_width: int) -> None:
        super().__init__()
        self.attention_norm, self.forward_norm = nn.LayerNorm(width), nn.LayerNorm(width)
        self.query, self.key = nn.Linear(width, key_width), nn.Linear(width, key_width)
        self.value, self.out = nn.Linear(width, width), nn.Linear(width, width)
        self.widen, self.narrow = nn.Linear(width, 2 * width), nn.Linear(2 * width, width)

    def forward(self, tokens: Tensor, present: Tensor | None = None) -> Tensor:
        """(b, n, width) from tokens (b, n, width); nobody attends to tokens that are not present (b, n)."""
        x = self.attention_norm(tokens)
        q, k, v = (_heads(part(x)) for part in (self.query, self.key, self.value))
        mask = None if present is None else present[:, None, None, :]
        attended = functional.scaled_dot_product_attention(q, k, v, attn_mask=mask)
        tokens = tokens + self.out(attended.transpose(1, 2).flatten(2))
        result: Tensor = tokens + self.narrow(functional.gelu(self.widen(self.forward_norm(tokens))))
        return result


def _heads(x: Tensor) -> Tensor:
    """(b, heads, n, width / heads)."""
    return x.view(*x.shape[:-1], HEADS, x.shape[-1] // HEADS).transpose(1, 2)


class PointEncoder(nn.Module):
    """A cloud to one vector: two blocks over point embeddings, then maximum and mean over the points."""

    WIDTH, KEY_WIDTH = 128, 32

    def __init__(self, pooled: int) -> None:
        """pooled: length of the result, half of it from the maximum and half from the mean."""
        super().__init__()
        inner = self.WIDTH - 3
        self.first, self.second = nn.Linear(3, inner), nn.Linear(inner, inner)
        self.blocks = nn.ModuleList(Block(self.WIDTH, self.KEY_WIDTH) for _ in range(2))
        self.norm, self.last = nn.LayerNorm(self.WIDTH), nn.Linear(self.WIDTH, pooled // 2)

    def forward(self, points: Tensor) -> Tensor:
        """(b, pooled) from points (b, n, 3)."""
        tokens = torch.cat([self.second(functional.gelu(self.first(points))), points], dim=-1)
        for block in self.blocks:
            tokens = block(tokens)
        features = self.last(self.norm(tokens))
        return torch.cat([features.amax(dim=1), features.mean(dim=1)], dim=-1)
