"""Pictures made to look different without changing what is true of them."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from perception.macarons.shots import DepthBatch

LIGHT, HUE = 0.2, 0.1
"""Largest relative change of brightness, contrast and saturation, and of the balance between the colours."""


def jittered(batch: DepthBatch, rng: np.random.Generator) -> DepthBatch:
    """Brightness, contrast, saturation and colour balance changed alike in all pictures of the batch.

    MACARONS turns the hue; a random gain per channel does nearly the same and costs nothing.
    """
    brightness, contrast, saturation = (float(v) for v in rng.uniform(1.0 - LIGHT, 1.0 + LIGHT, 3))
    balance = torch.from_numpy(rng.uniform(1.0 - HUE, 1.0 + HUE, (3, 1, 1)).astype(np.float32))

    def change(rgb: Tensor) -> Tensor:
        grey = rgb.mean(dim=-3, keepdim=True)
        out = (grey + saturation * (rgb - grey)) * balance * brightness
        middle = out.mean(dim=(-3, -2, -1), keepdim=True)
        return (middle + contrast * (out - middle)).clamp(0.0, 1.0)

    return DepthBatch(change(batch.target), change(batch.sources), batch.camera, batch.source_from_target)


def mirrored(batch: DepthBatch) -> DepthBatch:
    """The world in a mirror: left and right change places in pictures and poses alike."""
    camera = batch.camera.clone()
    camera[:, 2] = 1.0 - camera[:, 2]
    turn = torch.diag(torch.tensor([-1.0, 1.0, 1.0, 1.0]))
    return DepthBatch(batch.target.flip(-1), batch.sources.flip(-1), camera, turn @ batch.source_from_target @ turn)
