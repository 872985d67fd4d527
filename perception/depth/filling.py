"""A best guess for pixels that nothing trustworthy was found for: from the trusted ones around that look alike."""

from __future__ import annotations

import numpy as np

from perception.depth.compiled import compiled
from perception.depth.depth_map import Image, Mask

REACH_PX = 48
ALIKE_DN = np.float32(12.0)
"""Difference of grey that halves a neighbour's say."""
APART_PX = np.float32(6.0)
"""Distance that halves it."""


def filled(depth_m: Image, trusted: Mask, gray: Image) -> Image:
    """(h, w) depths, those not trusted replaced by the weighted median of the nearest trusted ones in eight directions.

    As Hirschmuller (2008, section 2.5) fills gaps, with the say of a neighbour falling with distance and with the
    difference of grey. A pixel that sees no trusted one within REACH_PX keeps what it has.
    """
    near, result = (1.0 / depth_m).astype(np.float32), depth_m.copy()
    _fill(near, trusted, gray, result)
    return result


@compiled
def _fill(near: Image, trusted: Mask, gray: Image, result: Image) -> None:
    h, w = near.shape
    value, say = np.empty(8, np.float32), np.empty(8, np.float32)
    for y in range(h):
        for x in range(w):
            if trusted[y, x]:
                continue
            count = 0
            total = np.float32(0.0)
            for k in range(9):
                dy, dx = k // 3 - 1, k % 3 - 1
                if dy == 0 and dx == 0:
                    continue
                for step in range(1, REACH_PX):
                    v, u = y + dy * step, x + dx * step
                    if v < 0 or v >= h or u < 0 or u >= w:
                        break
                    if trusted[v, u]:
                        unlike = abs(gray[v, u] - gray[y, x]) / ALIKE_DN
                        away = np.float32(step) / APART_PX
                        weight = np.float32(1.0) / ((np.float32(1.0) + unlike * unlike) * (np.float32(1.0) + away))
                        value[count], say[count] = near[v, u], weight
                        total += weight
                        count += 1
                        break
            if count:
                result[y, x] = np.float32(1.0) / _weighted_median(value[:count], say[:count], total)


@compiled
def _weighted_median(value: Image, say: Image, total: np.float32) -> np.float32:
    """The least value up to which half of all weight lies; values (n,) need no order and are put into it."""
    for i in range(1, len(value)):
        v, s, j = value[i], say[i], i - 1
        while j >= 0 and value[j] > v:
            value[j + 1], say[j + 1] = value[j], say[j]
            j -= 1
        value[j + 1], say[j + 1] = v, s
    reached, i = say[0], 0
    while reached + reached < total and i < len(value) - 1:
        i += 1
        reached += say[i]
    result: np.float32 = value[i]
    return result
