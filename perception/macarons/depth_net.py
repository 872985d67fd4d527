"""Depth of a picture from two earlier ones: MACARONS' depth module, after ManyDepth (Watson et al., CVPR 2021).

Depths and translations are in units of the sensing range.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional

from perception.macarons.resnet import Trunk

PLANES = 96
NEAREST, FARTHEST_PLANE, FARTHEST = 1.0 / 16.0, 2.0, 10.0
"""Sensing ranges. MACARONS spreads its planes evenly over depths up to 11 ranges, which leaves 9 within the range."""
CHANNELS = (16, 32, 64, 128, 256)
SKIPS = (3, 64, 64, 128, 256)
"""Channels of the picture, conv1, layers 1, 2 and 3, from fine to coarse."""
OUTPUTS = 4
SHARPNESS = 30.0
"""Of the soft minimum over the planes, whose costs have deviation 1."""
PLANES_AT_ONCE = 8
"""Buffers of all planes at once would be fresh pages every time, and take longer to clear than to fill."""
OUTSIDE = 3.0
"""A place beside every picture."""


class DepthNet(nn.Module):
    """14,421,892 parameters."""

    def __init__(self) -> None:
        super().__init__()
        self.trunk = Trunk()
        self.reduce = nn.Conv2d(64 + PLANES, 64, 3, padding=1)
        below = (*CHANNELS[1:], 512)
        self.up = nn.ModuleList(nn.ConvTranspose2d(b, c, 3, padding=1) for b, c in zip(below, CHANNELS, strict=True))
        self.merge = nn.ModuleList(nn.Conv2d(c + s, c, 3) for c, s in zip(CHANNELS, SKIPS, strict=True))
        self.disparity = nn.ModuleList(nn.Conv2d(c, 1, 3, padding=1) for c in CHANNELS[:OUTPUTS])
        for name, values in self.disparity.named_parameters():
            nn.init.zeros_(values) if name.endswith("bias") else values.data.mul_(0.1)

    def forward(self, target: Tensor, sources: Tensor, camera: Tensor, source_from_target: Tensor) -> list[Tensor]:
        """Disparities in 0-1 (b, 1, h / 2^s, w / 2^s) at scales s = 0 to 3.

        target: (b, 3, h, w) RGB in 0-1; sources: (b, k, 3, h, w); camera: (b, 4) fx, fy, cx, cy over the picture's
        width and height; source_from_target: (b, k, 4, 4). The sources' features take no part in learning, which is
        half of its cost: they come from the same layers as the target's.
        """
        first, own = self.trunk.stem(target)
        with torch.no_grad():
            others = self.trunk.stem(sources.flatten(0, 1))[1].view(*sources.shape[:2], *own.shape[1:])
        cost = standardised(cost_volume(own, others, camera, source_from_target))
        matched = functional.relu(self.reduce(torch.cat([own, cost], dim=1)))
        swept = torch.logit(swept_disparity(cost), eps=1e-3)
        skips = [target, first, matched, *self.trunk.deep(matched)]
        x, out = skips.pop(), []
        for stage in reversed(range(len(CHANNELS))):
            x = functional.interpolate(functional.elu(self.up[stage](x)), size=skips[stage].shape[-2:], mode="nearest")
            x = functional.pad(torch.cat([x, skips[stage]], dim=1), (1, 1, 1, 1), mode="reflect")
            x = functional.elu(self.merge[stage](x))
            if stage < OUTPUTS:
                start = functional.interpolate(swept, size=x.shape[-2:], mode="bilinear", align_corners=False)
                out.append(torch.sigmoid(self.disparity[stage](x) + start))
        return out[::-1]


def depth_from_disparity(disparity: Tensor) -> Tensor:
    """Depths between NEAREST and FARTHEST, linear in their inverse."""
    return 1.0 / ((1.0 / NEAREST - 1.0 / FARTHEST) * disparity + 1.0 / FARTHEST)


def plane_depths(device: torch.device) -> Tensor:
    """(96,) depths, evenly spaced in their inverse."""
    return 1.0 / torch.linspace(1.0 / FARTHEST_PLANE, 1.0 / NEAREST, PLANES, device=device)


def cost_volume(own: Tensor, others: Tensor, camera: Tensor, source_from_target: Tensor) -> Tensor:
    """(b, 96, h, w) mean distance between features (b, f, h, w) and the sources' (b, k, f, h, w), averaged over those
    that see a plane; where none does, the distance to nothing, as in MACARONS."""
    b, f, h, w = own.shape
    rays, costs = pixel_rays(camera, h, w), []
    for depths in torch.split(plane_depths(own.device), PLANES_AT_ONCE):
        with torch.no_grad():
            points = (rays[:, None] * depths[:, None, None, None]).flatten(1, 2)
            mean, seen = own.new_zeros(b, f, len(depths) * h, w), own.new_zeros(b, 1, len(depths) * h, w)
            for i in range(others.shape[1]):
                grid, ahead = project(points, source_from_target[:, i], camera)
                inside = ahead & (grid.abs() <= 1.0).all(dim=-1)
                grid = torch.where(inside[..., None], grid, OUTSIDE)
                mean += functional.grid_sample(others[:, i], grid, align_corners=False)
                seen += inside[:, None]
            mean /= seen.clamp_(min=1.0)
        costs.append((own[:, :, None] - mean.view(b, f, len(depths), h, w)).abs().mean(dim=1))
    return torch.cat(costs, dim=1)


def swept_disparity(cost: Tensor) -> Tensor:
    """(b, 1, h, w) disparity of the cheapest planes of standardised costs (b, 96, h, w): what the decoder corrects."""
    planes = (1.0 / plane_depths(cost.device) - 1.0 / FARTHEST) / (1.0 / NEAREST - 1.0 / FARTHEST)
    smooth = functional.avg_pool2d(cost, 3, 1, 1, count_include_pad=False)
    share = torch.softmax(-SHARPNESS * smooth, dim=1)
    return (share * planes[:, None, None]).sum(dim=1, keepdim=True)


def standardised(cost: Tensor) -> Tensor:
    """(b, 96, h, w) costs with mean 0 and deviation 1 over the planes of a pixel: the best plane stands out wherever
    features are strong or faint."""
    middle = cost - cost.mean(dim=1, keepdim=True)
    return middle / (middle.square().mean(dim=1, keepdim=True) + 1e-6).sqrt()


def pixel_rays(camera: Tensor, h: int, w: int) -> Tensor:
    """(b, h, w, 3) directions through the pixel centres with z = 1, for a camera (b, 4) as in DepthNet."""
    v, u = torch.meshgrid((torch.arange(h, device=camera.device) + 0.5) / h,
                          (torch.arange(w, device=camera.device) + 0.5) / w, indexing="ij")
    fx, fy, cx, cy = (c[:, None, None] for c in camera.unbind(-1))
    x, y = (u - cx) / fx, (v - cy) / fy
    return torch.stack([x, y, torch.ones_like(x)], dim=-1)


def project(points: Tensor, source_from_target: Tensor, camera: Tensor) -> tuple[Tensor, Tensor]:
    """(b, h, w, 2) where points (b, h, w, 3) fall in the source, -1 to 1 across it; (b, h, w) which lie ahead."""
    r, t = source_from_target[:, :3, :3], source_from_target[:, :3, 3]
    local = torch.einsum("bij,bhwj->bhwi", r, points) + t[:, None, None]
    z = local[..., 2:].clamp(min=1e-4)
    f, c = camera[:, None, None, :2], camera[:, None, None, 2:]
    return 2.0 * (local[..., :2] / z * f + c) - 1.0, local[..., 2] > 1e-4
