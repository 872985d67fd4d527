"""Depth of one picture from 2 to 6 neighbours at known poses: a plane-sweep cost volume.

The geometric half of the MACARONS depth module (Guedon et al. 2023), with two changes: planes lie evenly in inverse
depth, one step per pixel of parallax, and they run out to infinity so that background does not pile up on a last plane.
Cost is 1 - ZNCC over small windows; occluded neighbours drop out by averaging only the better half of them
(Kang, Szeliski & Chai 2001); the volume is smoothed by semi-global aggregation (Hirschmuller 2008).
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from missions.camera import Camera, Pose
from perception.accelerator import torch_device
from perception.depth import semi_global, texture
from perception.depth.cost_volume import WINDOW_PX, cost_volume
from perception.depth.depth_map import DepthMap, Image
from perception.depth.sky import sky_mask

COST_SCALE = 250.0
SIGHT_STEPS = 32
FARTHEST_M = 100.0
"""Depth that stands for all beyond it; pictures of one flight do not tell them apart."""


@dataclass(frozen=True)
class SweepSettings:
    """How the volume is built and what is believed of it."""

    shrink: int = 2
    """The volume has the picture's resolution divided by this."""
    nearest_m: float = 1.0
    planes: int = 96
    evenness: float = .3
    """Step of inverse depth at infinity beside the mean step; 1 is one step everywhere."""
    max_cost: float = 0.4
    """Largest 1 - ZNCC at the winning plane."""
    unseen_cost: float = 0.4
    """Cost of a plane where a source does not see it: the surface may lie there, so a doubtful match must not win."""
    max_ratio: float = 0.93
    """Largest ratio of the best cost to the best cost elsewhere on the ray."""
    min_texture_dn: float = 1.5
    """Smallest standard deviation of grey in the window; noise alone is weaker."""
    min_determinacy: float = 0.1
    """Smallest share of gradient energy along an epipolar line; below, a straight edge matches at any depth."""
    sigma_px: float = 0.35
    """Standard deviation of matching, in pixels of the volume."""
    device: str | None = None
    """A torch device for the volume, "" for the compiled loops; by default the GPU if there is one."""


@dataclass(frozen=True)
class Frame:
    """One picture made ready for matching, at the volume's resolution."""

    camera: Camera
    pose: Pose
    rgb: NDArray[np.uint8]
    gray: Image
    sky: NDArray[np.bool_]


def make_frame(rgb: NDArray[np.uint8], camera: Camera, pose: Pose, shrink: int = 2) -> Frame:
    """A picture (h, w, 3), shrunk by area averaging, with its conservative sky mask."""
    small = camera.scaled(camera.width_px // shrink, camera.height_px // shrink)
    rgb_small = cv2.resize(rgb, (small.width_px, small.height_px), interpolation=cv2.INTER_AREA)
    gray = cv2.cvtColor(rgb_small.astype(np.float32), cv2.COLOR_RGB2GRAY)
    rgb_small = np.asarray(rgb_small, dtype=np.uint8)
    return Frame(small, pose, rgb_small, np.asarray(gray, dtype=np.float32), sky_mask(rgb_small, small, pose))


def inverse_depths(settings: SweepSettings) -> Image:
    """(planes,) rising inverse depths from 0, infinity; closer together the farther they are."""
    share = np.linspace(0.0, 1.0, settings.planes)
    even = settings.evenness
    return ((even * share + (1.0 - even) * share**2) / settings.nearest_m).astype(np.float32)


def _parallax_rate_px(a: Image, b: Image) -> float:
    """Mean shift in a source, in pixels per unit of inverse depth, around 10 m."""
    sparse = a[:, 8::16, 8::16].reshape(3, -1)
    near, far = (sparse + b[:, None] * w for w in (0.11, 0.09))
    shift = np.hypot(*(near[:2] / near[2] - far[:2] / far[2])) / 0.02
    seen = (near[2] > 0.1) & (far[2] > 0.1)
    return float(shift[seen].mean()) if seen.any() else 0.0


def estimate(target: Frame, sources: list[Frame], settings: SweepSettings | None = None) -> DepthMap:
    """Depth of the target from its sources (all at one resolution). Raises ValueError without sources."""
    if not sources:
        raise ValueError("plane sweep needs at least one source picture")
    settings = settings or SweepSettings()
    planes = inverse_depths(settings)
    a, b = _epipolar_terms(target, sources)
    raw = _cost_volume(target, sources, (a, b), planes, settings)
    smooth = semi_global.aggregate(raw, target.gray)
    best, offset, second = semi_global.winners(smooth)
    cost = np.take_along_axis(raw, best[..., None].astype(np.int64), axis=2)[..., 0] / COST_SCALE
    near = np.interp(best + offset, np.arange(len(planes)), planes)
    depth = (1.0 / np.maximum(near, 1.0 / FARTHEST_M)).astype(np.float32)
    ratio = np.take_along_axis(smooth, best[..., None].astype(np.int64), axis=2)[..., 0] / np.maximum(second, 1.0)
    confidence = np.clip(1.0 - cost / 0.8, 0.0, 1.0) * np.clip((1.0 - ratio) * 4.0, 0.0, 1.0)
    valid = (cost < settings.max_cost) & (ratio < settings.max_ratio) & _matchable(target, sources, settings)
    valid &= (best < len(planes) - 1) & ~target.sky
    valid[:2], valid[-2:], valid[:, :2], valid[:, -2:] = False, False, False, False
    rate = float(np.median([_parallax_rate_px(*terms) for terms in zip(a, b, strict=True)]))
    return DepthMap(target.camera, target.pose, depth, valid, confidence.astype(np.float32),
                    target.sky, settings.sigma_px / max(rate, 1e-6), sight=_sight(a, b, 1.0 / settings.nearest_m))


def _matchable(target: Frame, sources: list[Frame], settings: SweepSettings) -> NDArray[np.bool_]:
    """(h, w) windows with texture, some of it along the epipolar lines."""
    along = texture.determinacy(target.gray, target.camera, target.pose, [s.pose for s in sources], WINDOW_PX)
    strength = texture.deviation_dn(target.gray, WINDOW_PX)
    return (strength > settings.min_texture_dn) & (along > settings.min_determinacy)


def _epipolar_terms(target: Frame, sources: list[Frame]) -> tuple[Image, Image]:
    """a (sources, 3, h, w), b (sources, 3): a target pixel at inverse depth w lies at the homogeneous pixel a + b * w
    of each source."""
    enu_from_target, rays = np.linalg.inv(target.pose.camera_from_enu), target.camera.rays_camera()
    a, b = np.empty((len(sources), 3, *rays.shape[:2]), np.float32), np.empty((len(sources), 3), np.float32)
    for n, source in enumerate(sources):
        source_from_target = source.pose.camera_from_enu @ enu_from_target
        k = source.camera.matrix
        a[n] = np.moveaxis(rays @ (k @ source_from_target[:3, :3]).T, -1, 0)
        b[n] = k @ source_from_target[:3, 3]
    return a, b


def _sight(a: Image, b: Image, nearest: float) -> Image:
    """(h, w) largest inverse depth, of even steps up to `nearest`, at which two sources see a pixel's ray, or one if
    there is but one; from every eighth pixel. Terms as `_epipolar_terms` gives them, for each source."""
    h, w = a.shape[2:]
    steps = np.linspace(0.0, nearest, SIGHT_STEPS + 1, dtype=np.float32)[1:]
    ahead = a[:, :, 4::8, 4::8, None] + b[:, :, None, None, None] * steps
    u, v = (ahead[:, axis] / np.maximum(ahead[:, 2], 1e-3) for axis in (0, 1))
    seen = (ahead[:, 2] > 0.1) & (u > 0.0) & (u < w) & (v > 0.0) & (v < h)
    enough = seen.sum(axis=0) >= min(2, len(a))
    coarse = np.where(enough, steps, np.float32(0.0)).max(axis=-1)
    return np.asarray(cv2.resize(coarse, (w, h), interpolation=cv2.INTER_LINEAR), np.float32)


def _cost_volume(target: Frame, sources: list[Frame], terms: tuple[Image, Image], planes: Image,
                 settings: SweepSettings) -> NDArray[np.int16]:
    """(h, w, planes) mean 1 - ZNCC of the better half of the sources, times COST_SCALE."""
    images = np.stack([source.gray for source in sources])
    device = torch_device() if settings.device is None else settings.device
    if device:
        from perception.depth import torch_volume  # here, for torch takes seconds and memory to import

        return torch_volume.cost_volume(target.gray, images, terms, planes, settings.unseen_cost, COST_SCALE, device)
    return cost_volume(target.gray, images, terms, planes, settings.unseen_cost, COST_SCALE)
