"""Lens distortion: Brown's model with two radial and two tangential terms, as in OpenCV and in COLMAP's OPENCV camera.

Points are what a pinhole of focal length 1 would see, (x, y) = (X / Z, Y / Z); with r² = x² + y²
x' = x (1 + k1 r² + k2 r⁴) + 2 p1 x y + p2 (r² + 2 x²) and y' = y (1 + k1 r² + k2 r⁴) + p1 (r² + 2 y²) + 2 p2 x y.
"""

from __future__ import annotations

import numpy as np

from missions.camera import Camera
from missions.frames import Array

Distortion = tuple[float, float, float, float]
"""k1, k2, p1, p2. They do not depend on the resolution."""
NONE: Distortion = (0.0, 0.0, 0.0, 0.0)
STEPS = 30


def distorted(points: Array, lens: Distortion) -> Array:
    """(..., 2) where the lens puts points (..., 2)."""
    k1, k2, p1, p2 = lens
    x, y = points[..., 0], points[..., 1]
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + k2 * r2)
    return np.stack([x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
                     y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y], axis=-1)


def undistorted(points: Array, lens: Distortion) -> Array:
    """(..., 2) the points (..., 2) that the lens puts there, by Newton's method; see `invertible`."""
    k1, k2, p1, p2 = lens
    found = np.array(points, dtype=np.float64)
    for _ in range(STEPS):
        x, y = found[..., 0], found[..., 1]
        r2 = x * x + y * y
        radial, slope = 1.0 + r2 * (k1 + k2 * r2), 2.0 * (k1 + 2.0 * k2 * r2)
        xx = radial + slope * x * x + 2.0 * p1 * y + 6.0 * p2 * x
        xy = slope * x * y + 2.0 * (p1 * x + p2 * y)
        yy = radial + slope * y * y + 6.0 * p1 * y + 2.0 * p2 * x
        off = distorted(found, lens) - points
        step = np.stack([yy * off[..., 0] - xy * off[..., 1], xx * off[..., 1] - xy * off[..., 0]], axis=-1)
        found -= step / (xx * yy - xy * xy)[..., None]
        if np.abs(step).max(initial=0.0) < 1e-13:
            break
    return found


def invertible(camera: Camera, lens: Distortion) -> bool:
    """Whether every pixel of the picture is seen along one ray: distances from the axis grow up to the corners."""
    edge = border(camera)
    with np.errstate(all="ignore"):
        rays = undistorted(edge, lens)
    if not np.all(np.isfinite(rays)) or not np.allclose(distorted(rays, lens), edge, atol=1e-9):
        return False
    share = np.linspace(0.05, 1.0, 40)[:, None, None]
    radius = np.linalg.norm(distorted(share * rays, lens), axis=-1)
    return bool(np.all(np.diff(radius, axis=0) > 0.0))


def border(camera: Camera) -> Array:
    """(n, 2) points along the picture's edge."""
    u, v = np.linspace(0.0, camera.width_px, 33), np.linspace(0.0, camera.height_px, 33)
    edge = np.concatenate([np.column_stack([u, np.full(33, w)]) for w in (0.0, camera.height_px)] +
                          [np.column_stack([np.full(33, w), v]) for w in (0.0, camera.width_px)])
    return np.asarray((edge - [camera.cx_px, camera.cy_px]) / [camera.fx_px, camera.fy_px])


def pixel_points(camera: Camera) -> Array:
    """(height, width, 2) points of the pixel centres."""
    return camera.rays_camera()[..., :2]


def pixels(points: Array, camera: Camera) -> Array:
    """(..., 2) pixels of points (..., 2)."""
    return points * [camera.fx_px, camera.fy_px] + [camera.cx_px, camera.cy_px]
