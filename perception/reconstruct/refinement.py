"""Depth between the steps of matching: where the pictures of all partners look most like the reference's.

Semi-global matching interpolates between whole disparities, and is off by a quarter of one: 13 mm at 8 m and a base of
2 m, with HD pictures at half their width. From there on each pixel is moved along its ray by least squares of the
pictures' differences (Lucas and Kanade 1981), all partners together, so that wide bases count more. Every pixel of the
window is compared at its own depth, which smooths no edge and needs no plane to be fitted.
"""

from __future__ import annotations

import cv2
import numba
import numpy as np
from numpy.typing import NDArray

from missions.frames import Array
from perception.reconstruct.stereo import Eye, Image, Map

ROUNDS = 3
WINDOW_PX = 11
RELIEF_PX = 9
NOISE_DN = 1.5
"""Contrast that is as likely noise: bare walls are not made as contrasty as joints."""
MIN_LIKENESS = 0.5
"""Normalised cross-correlation of a window, below which a partner does not show the same."""
SMOOTH_PX = 4
SMOOTH_STEP_PX = 2
MAX_BEND_STEPS, MAX_SLOPE_STEPS = 2.0, 8.0
"""Between two opposite neighbours: more is no surface that goes on through the pixel."""


def refined(reference: Eye, partners: list[Eye], depth: Map) -> Map:
    """(height, width) float32 depth, moved by ROUNDS pixels of disparity at most; 0 where no partner looks alike.

    Depths that are 0 or infinite are none. Cost: one warp and four box filters for each partner and round.
    """
    known = (depth > 0.0) & (depth < np.inf)
    if not partners or not known.any():
        return np.where(known, depth, np.float32(0.0))
    inverse = np.divide(np.float32(1.0), depth, out=np.zeros_like(depth), where=known)
    bases = [np.linalg.norm(partner.position_enu_m - reference.position_enu_m) for partner in partners]
    step = np.float32(1.0 / (reference.camera.fx_px * max(bases)))
    own = _relief(reference.grey)
    others = [(_relief(partner.grey), *_partner_from_pixel(reference, partner)) for partner in partners]
    for _ in range(ROUNDS):
        inverse = _moved(own, others, inverse, step)
    return np.divide(np.float32(1.0), inverse, out=np.zeros_like(depth), where=inverse > 0.0)


def _relief(grey: Image) -> Map:
    """The picture less its mean, in units of its standard deviation nearby: alike under other exposure and shade."""
    value = grey.astype(np.float32)
    mean = cv2.boxFilter(value, -1, (RELIEF_PX, RELIEF_PX))
    variance = cv2.boxFilter(value * value, -1, (RELIEF_PX, RELIEF_PX)) - mean * mean
    return np.asarray((value - mean) / np.sqrt(np.maximum(variance, 0.0) + np.float32(NOISE_DN**2)))


def _partner_from_pixel(reference: Eye, partner: Eye) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """(3, 3) M and (3,) e: homogeneous pixel M (u, v, 1) + e / depth in the partner."""
    partner_from_enu = partner.camera.matrix @ partner.enu_from_camera.T
    turn: Array = partner_from_enu @ reference.enu_from_camera @ np.linalg.inv(reference.camera.matrix)
    return (turn.astype(np.float32),
            (partner_from_enu @ (reference.position_enu_m - partner.position_enu_m)).astype(np.float32))


def _moved(own: Map, others: list[tuple[Map, NDArray[np.float32], NDArray[np.float32]]], inverse: Map,
           step: np.float32) -> Map:
    """Inverse depth, smoothed and moved by a step at most; 0 where no partner looks alike."""
    smooth, sums = np.empty_like(inverse), np.empty((4, *inverse.shape), np.float32)
    _smooth(inverse, step, smooth)
    square = _windowed(own * own)
    change, weight = np.zeros_like(inverse), np.zeros_like(inverse)
    for other, turn, shift in others:
        _compare(own, other, smooth, turn, shift, sums)
        slope_difference, slope_square, product, other_square = map(_windowed, sums)
        same = (product > 0.0) & (product * product > np.float32(MIN_LIKENESS**2) * square * other_square)
        change += np.where(same, slope_difference, np.float32(0.0))
        weight += np.where(same, slope_square, np.float32(0.0))
    alike = (smooth > 0.0) & (weight > 0.0)
    moves = np.divide(change, weight, out=np.zeros_like(change), where=alike)
    return np.where(alike, smooth + np.clip(moves, -step, step), np.float32(0.0))


def _windowed(values: Map) -> Map:
    return np.asarray(cv2.boxFilter(values, -1, (WINDOW_PX, WINDOW_PX), normalize=False))


def _smooth_pixels(inverse: Map, step: np.float32, out: Map) -> None:
    """Mean of a pixel and of those pairs of opposite neighbours that may lie on one plane with it.

    Inverse depth is linear across a plane's picture, so pairs leave every plane where it is, also beside its edge.
    """
    height, width = inverse.shape
    bend, slope = np.float32(MAX_BEND_STEPS) * step, np.float32(MAX_SLOPE_STEPS) * step
    for v in range(height):
        for u in range(width):
            own = inverse[v, u]
            out[v, u] = 0.0
            if not own > 0.0:
                continue
            total, count = own, np.float32(1.0)
            for dv in range(0, min(SMOOTH_PX, v, height - 1 - v) + 1, SMOOTH_STEP_PX):
                for du in range(-SMOOTH_PX, SMOOTH_PX + 1, SMOOTH_STEP_PX):
                    if (dv == 0 and du <= 0) or min(u + du, u - du) < 0 or max(u + du, u - du) >= width:
                        continue
                    one, opposite = inverse[v + dv, u + du], inverse[v - dv, u - du]
                    if (one > 0.0 and opposite > 0.0 and abs(one - opposite) < slope
                            and abs(one + opposite - own - own) < bend):
                        total, count = total + one + opposite, count + np.float32(2.0)
            out[v, u] = total / count


def _compare_pixels(own: Map, other: Map, inverse: Map, turn: NDArray[np.float32], shift: NDArray[np.float32],
                    sums: NDArray[np.float32]) -> None:
    """Per pixel: slope times difference, slope squared, product, square of the other; slopes by inverse depth."""
    height, width = other.shape
    half, one = np.float32(0.5), np.float32(1.0)
    for v in range(inverse.shape[0]):
        for u in range(inverse.shape[1]):
            sums[:, v, u] = 0.0
            q = inverse[v, u]
            if not q > 0.0:
                continue
            x, y = np.float32(u) + half, np.float32(v) + half
            z = turn[2, 0] * x + turn[2, 1] * y + turn[2, 2] + shift[2] * q
            if z < np.float32(0.05):
                continue
            across = (turn[0, 0] * x + turn[0, 1] * y + turn[0, 2] + shift[0] * q) / z
            down = (turn[1, 0] * x + turn[1, 1] * y + turn[1, 2] + shift[1] * q) / z
            if not (across > one and down > one and across < width - 1 and down < height - 1):
                continue
            i, j = int(down - half), int(across - half)
            fv, fu = down - half - np.float32(i), across - half - np.float32(j)
            top, bottom = other[i, j + 1] - other[i, j], other[i + 1, j + 1] - other[i + 1, j]
            upper, lower = other[i, j] + fu * top, other[i + 1, j] + fu * bottom
            seen = upper + fv * (lower - upper)
            slope = ((top + fv * (bottom - top)) * (shift[0] - across * shift[2])
                     + (lower - upper) * (shift[1] - down * shift[2])) / z
            sums[0, v, u] = slope * (own[v, u] - seen)
            sums[1, v, u] = slope * slope
            sums[2, v, u] = own[v, u] * seen
            sums[3, v, u] = seen * seen


_smooth = numba.njit(nogil=True, cache=True, error_model="numpy")(_smooth_pixels)
_compare = numba.njit(nogil=True, cache=True, error_model="numpy")(_compare_pixels)
