"""Pictures with poses, and pictures as the depth network takes them; depth maps as the field takes them."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from missions.camera import Camera, Pose
from perception.depth.sky import sky_mask
from perception.macarons.depth_net import DepthNet, depth_from_disparity
from perception.macarons.field import Look


@dataclass(frozen=True)
class Shot:
    """One picture at the depth network's size; rgb (h, w, 3), sky (h, w)."""

    rgb: NDArray[np.uint8]
    sky: NDArray[np.bool_]
    camera: Camera
    pose: Pose


def make_shot(rgb: NDArray[np.uint8], camera: Camera, pose: Pose, size_px: tuple[int, int]) -> Shot:
    """A picture (h, w, 3), shrunk by area averaging, with its conservative sky mask."""
    small = camera.scaled(*size_px)
    if (camera.width_px, camera.height_px) != size_px:
        rgb = np.asarray(cv2.resize(rgb, size_px, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    return Shot(rgb, sky_mask(rgb, small, pose), small, pose)


@dataclass(frozen=True)
class DepthBatch:
    """Pictures with their sources, as DepthNet takes them."""

    target: Tensor
    sources: Tensor
    camera: Tensor
    source_from_target: Tensor

    def predict(self, net: DepthNet) -> list[Tensor]:
        """Disparities at four scales."""
        result: list[Tensor] = net(self.target, self.sources, self.camera, self.source_from_target)
        return result


def depth_batch(targets: list[Shot], sources: list[list[Shot]], range_m: float) -> DepthBatch:
    """Targets with equally many sources each; translations become sensing ranges."""
    camera = torch.tensor([[t.camera.fx_px / t.camera.width_px, t.camera.fy_px / t.camera.height_px,
                            t.camera.cx_px / t.camera.width_px, t.camera.cy_px / t.camera.height_px] for t in targets])
    relative = np.stack([[_relative(s, t, range_m) for s in row] for t, row in zip(targets, sources, strict=True)])
    return DepthBatch(torch.stack([_tensor(t) for t in targets]),
                      torch.stack([torch.stack([_tensor(s) for s in row]) for row in sources]), camera,
                      torch.from_numpy(relative.astype(np.float32)))


def _tensor(shot: Shot) -> Tensor:
    """(3, h, w) in 0-1."""
    return torch.from_numpy(shot.rgb).permute(2, 0, 1).float() / 255.0


def _relative(source: Shot, target: Shot, range_m: float) -> NDArray[np.float64]:
    """(4, 4) source from target, translation in sensing ranges."""
    out: NDArray[np.float64] = source.pose.camera_from_enu @ np.linalg.inv(target.pose.camera_from_enu)
    out[:3, 3] /= range_m
    return out


def look_of(disparity: Tensor, shot: Shot, range_m: float) -> Look:
    """The depth map of the finest disparities (1, h, w) of one picture. The sky is infinitely far; not believed are
    pixels where depth jumps though the picture does not."""
    with torch.no_grad():
        depth = depth_from_disparity(disparity)[0].numpy() * range_m
        steep = disparity_gradient(disparity[None], _tensor(shot)[None])[0, 0]
        valid = (steep < steep.mean() + steep.std()).numpy()
    far = np.where(shot.sky, np.inf, depth).astype(np.float32)
    return Look(far, valid | shot.sky, shot.camera, shot.pose)


def disparity_gradient(disparity: Tensor, rgb: Tensor) -> Tensor:
    """(b, 1, h, w) gradient of the mean-normalised disparity, damped at the picture's own edges."""
    flat = disparity / (disparity.mean(dim=(2, 3), keepdim=True) + 1e-7)
    across = (flat[..., 1:] - flat[..., :-1]).abs() * torch.exp(-_edges(rgb[..., 1:] - rgb[..., :-1]))
    down = (flat[..., 1:, :] - flat[..., :-1, :]).abs() * torch.exp(-_edges(rgb[..., 1:, :] - rgb[..., :-1, :]))
    return functional.pad(across, (0, 1, 0, 0)) + functional.pad(down, (0, 0, 0, 1))


def _edges(difference: Tensor) -> Tensor:
    return difference.abs().mean(dim=1, keepdim=True)
