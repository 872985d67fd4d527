"""The same points in two pictures whose poses are known roughly: nearest descriptors near the epipolar lines."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
import pycolmap
from numpy.typing import NDArray

from missions.frames import Array
from perception.reconstruct.features import Features
from perception.reconstruct.optics import Optics
from perception.reconstruct.pictures import SurveyPicture

Matches = NDArray[np.uint32]
"""(m, 2) indices into the features of the first and of the second picture."""
ByPair = dict[tuple[int, int], Matches]
"""Of pictures, the first one's index before the second one's."""

MAX_RATIO = 0.8
"""The second nearest descriptor must be farther by this much (Lowe 2004)."""
MAX_DISTANCE = 0.7 * 512.0
MAX_EPIPOLAR_PX = 3.0
MIN_MATCHES = 30
"""Fewer may agree on a wrong pose where texture repeats."""
SEED = 1


def match(first: SurveyPicture, second: SurveyPicture, a: Features, b: Features, band_px: float,
          epipolar_px: float = MAX_EPIPOLAR_PX, least: int = MIN_MATCHES) -> Matches:
    """Matches within band_px of the epipolar lines of the measured poses that one relative pose explains to
    epipolar_px (five-point RANSAC in COLMAP, seeded); none when there are fewer than `least` of them. Features are
    where a pinhole would see them."""
    found = _nearest(a, b, fundamental(first, second), band_px)
    if len(found) < least:
        return found[:0]
    options = pycolmap.RANSACOptions(max_error=epipolar_px, min_num_trials=30, max_num_trials=1000,
                                     random_seed=SEED)
    camera = Optics(first.camera).colmap(with_lens=False)
    fit = pycolmap.estimate_essential_matrix(a.points_px[found[:, 0]].astype(np.float64),
                                             b.points_px[found[:, 1]].astype(np.float64), camera, camera, options)
    kept = found[fit["inlier_mask"]] if fit else found[:0]
    return kept if len(kept) >= least else kept[:0]


def fundamental(first: SurveyPicture, second: SurveyPicture) -> Array:
    """(3, 3) F with x_second^T F x_first = 0 for pixels of the same point."""
    turn = second.enu_from_camera.T @ first.enu_from_camera
    x, y, z = second.enu_from_camera.T @ (first.position_enu_m - second.position_enu_m)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.linalg.inv(second.camera.matrix).T @ cross @ turn @ np.linalg.inv(first.camera.matrix))


def _nearest(a: Features, b: Features, f: Array, band_px: float) -> Matches:
    """Pairs of mutually nearest descriptors near the lines of f that pass the ratio test from both sides."""
    columns = np.ascontiguousarray(b.points_px.T)
    return _mutual(*_search(a.points_px, columns, a.descriptors, b.descriptors, f.astype(np.float32),
                            np.float32(band_px)))


def nearest_anywhere(a: Features, b: Features) -> Matches:
    """The same wherever they are in the pictures: all products at once, by BLAS."""
    if not len(a) or not len(b):
        return np.zeros((0, 2), np.uint32)
    of_a, of_b = a.descriptors.astype(np.float32), b.descriptors.astype(np.float32)
    return _mutual(*_search_products(of_a @ of_b.T, np.einsum("ij,ij->i", of_a, of_a),
                                     np.einsum("ij,ij->i", of_b, of_b)))


def _mutual(to_b: NDArray[Any], best_a: NDArray[Any], second_a: NDArray[Any], to_a: NDArray[Any],
            second_b: NDArray[Any]) -> Matches:
    i = np.flatnonzero(to_b >= 0)
    j = to_b[i]
    good = (to_a[j] == i) & (best_a[i] < MAX_DISTANCE**2)
    good &= best_a[i] < MAX_RATIO**2 * np.minimum(second_a[i], second_b[j])
    return np.column_stack([i[good], j[good]]).astype(np.uint32)


FAR = 1 << 30
Squares = NDArray[np.int32]
Row = NDArray[np.float32]


def _search_near_lines(a: NDArray[np.float32], b: NDArray[np.float32], of_a: NDArray[np.uint8], of_b: NDArray[np.uint8],
                       f: NDArray[np.float32], band_px: np.float32) -> tuple[Squares, ...]:
    """Nearest candidate near each line, its squared distance and the second's, from a (n, 2) to b (2, m) and back.

    Squared distances are whole numbers, so that every machine finds the same.
    """
    n, m = len(a), b.shape[1]
    to_b, best_a, second_a = np.full(n, -1, np.int32), np.full(n, FAR, np.int32), np.full(n, FAR, np.int32)
    to_a, best_b, second_b = np.full(m, -1, np.int32), np.full(m, FAR, np.int32), np.full(m, FAR, np.int32)
    off = np.empty(m, np.float32)
    for i in range(n):
        x, y = a[i, 0], a[i, 1]
        across = f[0, 0] * x + f[0, 1] * y + f[0, 2]
        down = f[1, 0] * x + f[1, 1] * y + f[1, 2]
        rest = f[2, 0] * x + f[2, 1] * y + f[2, 2]
        scale = np.float32(1.0) / np.sqrt(across * across + down * down + np.float32(1e-20))
        across, down, rest = across * scale, down * scale, rest * scale
        for j in range(m):  # a loop of its own, so that it is vectorised
            off[j] = abs(across * b[0, j] + down * b[1, j] + rest)
        for j in range(m):
            if off[j] >= band_px:
                continue
            apart = np.int32(0)
            for k in range(of_a.shape[1]):
                step = np.int32(of_a[i, k]) - np.int32(of_b[j, k])
                apart += step * step
            if apart < best_a[i]:
                to_b[i], second_a[i], best_a[i] = j, best_a[i], apart
            elif apart < second_a[i]:
                second_a[i] = apart
            if apart < best_b[j]:
                to_a[j], second_b[j], best_b[j] = i, best_b[j], apart
            elif apart < second_b[j]:
                second_b[j] = apart
    return to_b, best_a, second_a, to_a, second_b


_search = numba.njit(nogil=True, cache=True)(_search_near_lines)


def _search_all_products(products: Row, squares_a: Row, squares_b: Row) -> tuple[Squares | Row, ...]:
    """Nearest of all candidates, as above, from products of descriptors (n, m) and their squared lengths.

    Descriptors are whole numbers, and their products stay below 2^24: exact in float32, in whatever order BLAS adds.
    """
    n, m = products.shape
    to_b, best_a, second_a = np.full(n, -1, np.int32), np.empty(n, np.float32), np.empty(n, np.float32)
    to_a, best_b, second_b = np.full(m, -1, np.int32), np.full(m, FAR, np.float32), np.full(m, FAR, np.float32)
    apart = np.empty(m, np.float32)
    for i in range(n):
        for j in range(m):  # loops of their own, so that they are vectorised
            apart[j] = squares_a[i] + squares_b[j] - np.float32(2.0) * products[i, j]
        best, second = np.float32(FAR), np.float32(FAR)
        for j in range(m):
            if apart[j] < second:
                if apart[j] < best:
                    to_b[i], second, best = j, best, apart[j]
                else:
                    second = apart[j]
        best_a[i], second_a[i] = best, second
        for j in range(m):
            to_a[j] = i if apart[j] < best_b[j] else to_a[j]
            second_b[j] = min(second_b[j], max(apart[j], best_b[j]))
            best_b[j] = min(best_b[j], apart[j])
    return to_b, best_a, second_a, to_a, second_b


_search_products = numba.njit(nogil=True, cache=True)(_search_all_products)
