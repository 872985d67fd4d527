"""What the three networks learn from: pictures that must agree, carving's verdict, and what new views brought."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional

from perception.macarons.depth_net import NEAREST, depth_from_disparity, pixel_rays, project
from perception.macarons.shots import DepthBatch, disparity_gradient

SSIM_SHARE, SMOOTHNESS = 0.85, 1e-3
C1, C2 = 0.01**2, 0.03**2
BACKGROUND, SKY_SHARE = 2.0, 0.3


def photometric(disparities: list[Tensor], batch: DepthBatch, sources: Tensor, source_from_target: Tensor,
                foreground: Tensor) -> Tensor:
    """Self-supervised loss of depth (MACARONS, after Monodepth2, Godard et al. 2019).

    Sources (b, k, 3, h, w) at (b, k, 4, 4) are warped into the target through the predicted depth; per pixel the best
    of them counts, over the foreground (b, 1, h, w). Disparities come at four scales and are compared at full size.
    """
    total = batch.target.new_zeros(())
    size = batch.target.shape[-2:]
    for scale, disparity in enumerate(disparities):
        full = functional.interpolate(disparity, size=size, mode="bilinear", align_corners=False)
        points = pixel_rays(batch.camera, *size) * depth_from_disparity(full)[:, 0, ..., None]
        errors = []
        for i in range(sources.shape[1]):
            grid, _ = project(points, source_from_target[:, i], batch.camera)
            warped = functional.grid_sample(sources[:, i], grid, padding_mode="border", align_corners=False)
            errors.append(dissimilarity(warped, batch.target))
        best = torch.cat(errors, dim=1).amin(dim=1, keepdim=True)
        total = total + (best * foreground).sum() / foreground.sum().clamp(min=1.0)
        small = functional.interpolate(batch.target, size=disparity.shape[-2:], mode="area")
        total = total + SMOOTHNESS / 2**scale * disparity_gradient(disparity, small).mean()
    return total / len(disparities)


def dissimilarity(a: Tensor, b: Tensor) -> Tensor:
    """(n, 1, h, w) 0.85 (1 - SSIM) / 2 + 0.15 L1 of pictures (n, 3, h, w), over 3 x 3 windows."""
    x, y = (functional.pad(p, (1, 1, 1, 1), mode="reflect") for p in (a, b))
    mean_x, mean_y = functional.avg_pool2d(x, 3, 1), functional.avg_pool2d(y, 3, 1)
    var_x = functional.avg_pool2d(x * x, 3, 1) - mean_x**2
    var_y = functional.avg_pool2d(y * y, 3, 1) - mean_y**2
    both = functional.avg_pool2d(x * y, 3, 1) - mean_x * mean_y
    ssim = (2 * mean_x * mean_y + C1) * (2 * both + C2) / ((mean_x**2 + mean_y**2 + C1) * (var_x + var_y + C2))
    unlike = ((1.0 - ssim) / 2.0).clamp(0.0, 1.0)
    return (SSIM_SHARE * unlike + (1.0 - SSIM_SHARE) * (a - b).abs()).mean(dim=1, keepdim=True)


def supervised_depth(disparities: list[Tensor], depth: Tensor) -> Tensor:
    """Mean absolute logarithm of predicted over true depth (b, 1, h, w), in sensing ranges, inf in the sky.

    At four scales. Beyond BACKGROUND ranges nothing is asked but to be as far: SKY_SHARE of what is nearer than that.
    """
    near = (depth < BACKGROUND).to(depth.dtype)
    truth = depth.clamp(NEAREST, BACKGROUND).log()
    total = depth.new_zeros(())
    for disparity in disparities:
        size = disparity.shape[-2:]
        wanted, weight = (functional.interpolate(x, size=size, mode="nearest") for x in (truth, near))
        beyond = depth_from_disparity(disparity).log() - wanted
        total = total + (weight * beyond.abs() + (1.0 - weight) * SKY_SHARE * functional.relu(-beyond)).mean()
    return total / len(disparities)


def normalised_l1(predicted: Tensor, truth: Tensor) -> Tensor:
    """Mean over cameras (c,) of the difference between shares of the mean: only the order and ratios of gains count."""
    return (predicted / predicted.mean().clamp(min=1e-6) - truth / truth.mean().clamp(min=1e-6)).abs().mean()
