"""The plane sweep's cost volume in torch, for a device that the compiled loops of `cost_volume` do not run on."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch.nn import functional

from perception.depth.cost_volume import WINDOW_PX, Stack
from perception.depth.depth_map import Image

CHUNK = 16
"""Planes warped at once, all sources of a chunk one after the other: small enough for a cache."""


def cost_volume(gray: Image, images: Stack, terms: tuple[Stack, Stack], planes: Image, unseen_cost: float,
                scale: float, device_name: str) -> NDArray[np.int16]:
    """As `perception.depth.cost_volume.cost_volume`, on a torch device such as cpu or cuda."""
    device = torch.device(device_name)
    kept, rim = (len(images) + 1) // 2, WINDOW_PX // 2
    h, w = gray.shape
    with torch.inference_mode():
        volume = torch.full((h, w, len(planes)), round(scale), dtype=torch.int16, device=device)
        reference = _normalised(torch.from_numpy(gray).to(device)[None])
        views = [(torch.from_numpy(image).to(device)[None, None], torch.from_numpy(a).to(device),
                  torch.from_numpy(b).to(device)) for image, a, b in zip(images, *terms, strict=True)]
        for first in range(0, len(planes), CHUNK):
            chunk = torch.from_numpy(planes[first : first + CHUNK]).to(device)
            best: list[torch.Tensor] = []
            for view in views:
                best = _keep_smallest(best, _source_cost(reference, view, chunk, unseen_cost), kept)
            mean = torch.stack(best).mean(dim=0).mul_(scale).round_().to(torch.int16)
            volume[rim : h - rim, rim : w - rim, first : first + len(chunk)] = mean.permute(1, 2, 0)
    result: NDArray[np.int16] = volume.cpu().numpy()
    return result


def _keep_smallest(kept: list[torch.Tensor], new: torch.Tensor, count: int) -> list[torch.Tensor]:
    """The `count` smallest values seen so far, elementwise, in rising order."""
    for i, old in enumerate(kept):
        kept[i], new = torch.minimum(old, new), torch.maximum(old, new)
    return kept if len(kept) == count else [*kept, new]


def _normalised(image: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Interior of images (n, h, w) less its window means, those means, and the reciprocal window deviations."""
    mean = _window_mean(image)
    variance = _window_mean(image * image).sub_(mean * mean)
    return image, mean, variance.clamp_min_(0.5).rsqrt_()


def _window_mean(image: torch.Tensor) -> torch.Tensor:
    """(n, h - window + 1, w - window + 1) means over full windows; sums of slices are 10 times as fast as pooling."""
    h, w = image.shape[-2:]
    rows = image[..., : w - WINDOW_PX + 1] + image[..., 1 : w - WINDOW_PX + 2]
    for i in range(2, WINDOW_PX):
        rows += image[..., i : w - WINDOW_PX + 1 + i]
    total = rows[..., : h - WINDOW_PX + 1, :] + rows[..., 1 : h - WINDOW_PX + 2, :]
    for i in range(2, WINDOW_PX):
        total += rows[..., i : h - WINDOW_PX + 1 + i, :]
    return total.mul_(1.0 / WINDOW_PX**2)


def _source_cost(reference: tuple[torch.Tensor, torch.Tensor, torch.Tensor],
                 view: tuple[torch.Tensor, torch.Tensor, torch.Tensor], planes: torch.Tensor,
                 unseen_cost: float) -> torch.Tensor:
    """(planes, h - window + 1, w - window + 1) 1 - ZNCC against one source."""
    image, mean, inverse_deviation = reference
    gray, a, b = view
    rim = WINDOW_PX // 2
    grid, seen = _sampling_grid(a, b, planes, gray.shape[-1], gray.shape[-2])
    warped = functional.grid_sample(gray.expand(len(planes), 1, -1, -1), grid, padding_mode="border",
                                    align_corners=False)[:, 0]
    _, other_mean, other_inverse = _normalised(warped)
    covariance = _window_mean(warped * image).sub_(other_mean * mean)
    cost = covariance.mul_(inverse_deviation).mul_(other_inverse).neg_().add_(1.0)
    return cost.masked_fill_(~seen[:, rim:-rim, rim:-rim], unseen_cost)


def _sampling_grid(a: torch.Tensor, b: torch.Tensor, w: torch.Tensor, width_px: int,
                   height_px: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Where planes w (n,) lie in a source: (n, h, w, 2) in [-1, 1], and which pixels fall inside it."""
    w = w[:, None, None]
    z = a[2] + b[2] * w
    inverse_z = z.clamp_min(1e-3).reciprocal_()
    grid = torch.empty((*z.shape, 2), device=z.device)
    for axis, size in enumerate((width_px, height_px)):
        grid[..., axis] = (a[axis] + b[axis] * w).mul_(inverse_z).mul_(2.0 / size).sub_(1.0)
    seen = (grid[..., 0].abs() < 1.0) & (grid[..., 1].abs() < 1.0) & (z > 0.1)
    return grid, seen
