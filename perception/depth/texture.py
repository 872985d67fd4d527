"""Whether a window holds anything to match, and whether it holds it in the direction in which matches shift."""

from __future__ import annotations

import cv2
import numpy as np

from missions.camera import Camera, Pose
from perception.depth.depth_map import Image


def deviation_dn(gray: Image, window_px: int) -> Image:
    """(h, w) standard deviation of grey in windows."""
    size = (window_px, window_px)
    mean = cv2.blur(gray, size)
    result: Image = np.sqrt(np.maximum(cv2.blur(gray * gray, size) - mean * mean, 0.0))
    return result


def determinacy(gray: Image, camera: Camera, pose: Pose, sources: list[Pose], window_px: int) -> Image:
    """(h, w) share of a window's gradient energy along the epipolar line of its best source, 0 to 1.

    A cable parallel to its epipolar lines matches at any depth (the aperture problem); the share is then near 0.
    """
    dx, dy = (cv2.Sobel(gray, cv2.CV_32F, 1 - axis, axis, ksize=3) for axis in (0, 1))
    size = (window_px, window_px)
    xx, yy, xy = (cv2.blur(product, size) for product in (dx * dx, dy * dy, dx * dy))
    x, y = np.meshgrid(np.arange(camera.width_px) + 0.5, np.arange(camera.height_px) + 0.5)
    best = np.zeros(gray.shape)
    for source in sources:
        towards = np.array(source.position_enu_m) - np.array(pose.position_enu_m)
        epipole = camera.matrix @ (pose.enu_from_camera.T @ towards)
        ex, ey = epipole[0] - x * epipole[2], epipole[1] - y * epipole[2]
        along = (ex * ex * xx + ey * ey * yy + 2.0 * ex * ey * xy) / np.maximum(ex * ex + ey * ey, 1e-12)
        best = np.maximum(best, along / np.maximum(xx + yy, 1e-6))
    return best.astype(np.float32)
