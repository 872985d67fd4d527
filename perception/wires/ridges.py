"""Thin lines in a picture: ridges of brightness to a fraction of a pixel, linked to chains.

Ridges are found and placed by the second derivatives of the smoothed picture (Steger, PAMI 1998): across a line the
brightness has an extremum, whose place is where its first derivative vanishes. Grass and gravel have ridges, too, but
short and crooked ones, which linking leaves out.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from perception.depth.compiled import compiled

SMOOTHING_PX = 1.2
"""Standard deviation of the smoothing: best for lines 1 to 4 pixels wide."""
LEVELS = 2
"""The picture and its reduction by two, which has the lines that are wide in the picture."""
SEED, FOLLOW = 1.6, 0.7
"""Curvature across a line (grey levels per pixel squared) from which a chain begins, and on which it goes on."""
BORDER_PX = 5
SHORTEST_PX = 30
"""Of a chain, at its own level."""
MAX_BEND_COS = 0.94
"""Between neighbours in a chain: 20 degrees."""
SIDES_SHARE = 0.35
"""A line stands out from both its sides, from the lesser by so much of what it stands out from the other; else it is
the shoulder of an edge."""
SIDE_PX = 3.0
GAP_PX = 3
"""So far along itself a line may be lost."""
FIT_PX = 10
"""Place and direction are those of a straight line through so many neighbours to both sides."""
STRAIGHT_PX = 0.5
"""Root mean square from that line."""
SAMPLE_PX = 3
"""One in so many of a chain's points is kept."""

Float = NDArray[np.float32]
Index = NDArray[np.int32]


@dataclass(frozen=True)
class Ridges:
    """Samples of a picture's chains: place (n, 2) in pixels (the first one's centre is 0.5, 0.5), unit direction along
    the line (n, 2), and chain number (n,)."""

    place_px: Float
    direction: Float
    chain: Index

    def __len__(self) -> int:
        return len(self.chain)

    def select(self, which: NDArray[np.int64]) -> Ridges:
        """The samples with these indices."""
        return Ridges(self.place_px[which], self.direction[which], self.chain[which])


def ridges(grey: NDArray[np.uint8]) -> Ridges:
    """Of a picture (h, w)."""
    found, first, picture = [], 0, grey.astype(np.float32)
    for level in range(LEVELS):
        rows, chains = _linked(picture)
        rows[:, :2] = (rows[:, :2] + 0.5) * 2.0**level
        found.append(Ridges(rows[:, :2], rows[:, 2:], chains + first))
        first += int(chains.max(initial=-1)) + 1
        picture = cv2.resize(picture, (picture.shape[1] // 2, picture.shape[0] // 2), interpolation=cv2.INTER_AREA)
    return Ridges(np.concatenate([r.place_px for r in found]), np.concatenate([r.direction for r in found]),
                  np.concatenate([r.chain for r in found]))


def _linked(picture: Float) -> tuple[Float, Index]:
    """(n, 4) column, row and direction of samples, and their chains."""
    smooth = cv2.GaussianBlur(picture, (0, 0), SMOOTHING_PX)
    gx, gy = (cv2.Sobel(smooth, cv2.CV_32F, *order, ksize=3, scale=0.125) for order in ((1, 0), (0, 1)))
    gxx = cv2.filter2D(smooth, cv2.CV_32F, np.array([[1.0, -2.0, 1.0]], np.float32))
    gyy = cv2.filter2D(smooth, cv2.CV_32F, np.array([[1.0], [-2.0], [1.0]], np.float32))
    gxy = cv2.Sobel(smooth, cv2.CV_32F, 1, 1, ksize=3, scale=0.25)
    points = np.zeros((*picture.shape, 5), np.float32)
    _place(smooth, gx, gy, gxx, gxy, gyy, points)
    seeds = np.flatnonzero(points[..., 0] >= SEED)
    seeds = seeds[np.argsort(-points[..., 0].ravel()[seeds], kind="stable")]
    rows = np.zeros((int((points[..., 0] > 0).sum()) // SAMPLE_PX + 1, 4), np.float32)
    chains = np.zeros(len(rows), np.int32)
    count = _link(points, seeds, rows, chains)
    return rows[:count], chains[:count]


@compiled
def _stands_out(smooth: Float, x: int, y: int, dx: float, dy: float, sense: float) -> bool:
    """Whether a pixel differs from both its sides in the same sense, and from neither far less than from the other."""
    there = smooth[int(np.rint(y + dy)), int(np.rint(x + dx))]
    here = smooth[int(np.rint(y - dy)), int(np.rint(x - dx))]
    one, other = (smooth[y, x] - there) * np.sign(sense), (smooth[y, x] - here) * np.sign(sense)
    return bool(min(one, other) > SIDES_SHARE * max(one, other))


@compiled
def _place(smooth: Float, gx: Float, gy: Float, gxx: Float, gxy: Float, gyy: Float, points: Float) -> None:
    """Per pixel that a ridge passes: size of the curvature, its sign, place (column, row) and direction as an angle."""
    h, w = gx.shape
    for y in range(BORDER_PX, h - BORDER_PX):
        for x in range(BORDER_PX, w - BORDER_PX):
            a, b, c = gxx[y, x], gxy[y, x], gyy[y, x]
            mean, spread = 0.5 * (a + c), np.sqrt(0.25 * (a - c) ** 2 + b * b)
            across = mean + spread if mean > 0 else mean - spread
            if abs(across) < FOLLOW or abs(mean + spread if mean < 0 else mean - spread) > 0.5 * abs(across):
                continue
            angle = 0.5 * np.arctan2(2.0 * b, a - c) + (0.0 if mean > 0 else 0.5 * np.pi)
            nx, ny = np.cos(angle), np.sin(angle)
            step = -(gx[y, x] * nx + gy[y, x] * ny) / across
            if abs(step * nx) > 0.6 or abs(step * ny) > 0.6:
                continue
            if not _stands_out(smooth, x, y, SIDE_PX * nx, SIDE_PX * ny, -across):
                continue
            points[y, x, 0], points[y, x, 1] = abs(across), 1.0 if across > 0 else -1.0
            points[y, x, 2], points[y, x, 3] = x + step * nx, y + step * ny
            points[y, x, 4] = angle + 0.5 * np.pi


@compiled
def _link(points: Float, seeds: NDArray[np.int64], rows: Float, chains: Index) -> int:
    """Follows ridges from the strongest pixels both ways; writes samples of what is long and straight."""
    h, w, _ = points.shape
    used = np.zeros((h, w), np.bool_)
    way = np.zeros((2, h + w, 2), np.int32)
    count, chain = 0, 0
    for seed in seeds:
        y, x = seed // w, seed % w
        if used[y, x]:
            continue
        used[y, x] = True
        there = _follow(points, used, x, y, 1.0, way[0])
        back = _follow(points, used, x, y, -1.0, way[1])
        if there + back + 1 < SHORTEST_PX:
            continue
        line = np.empty((there + back + 1, 2), np.float32)
        for k in range(back):
            line[k] = points[way[1, back - 1 - k, 1], way[1, back - 1 - k, 0], 2:4]
        line[back] = points[y, x, 2:4]
        for k in range(there):
            line[back + 1 + k] = points[way[0, k, 1], way[0, k, 0], 2:4]
        before = count
        count = _sample(line, rows, chains, count, chain)
        chain += 1 if count > before else 0
    return count


@compiled
def _follow(points: Float, used: NDArray[np.bool_], x: int, y: int, sense: float, way: Index) -> int:
    """Pixels of the line that begins at a pixel and goes one way; they are used up."""
    h, w, _ = points.shape
    sign = points[y, x, 1]
    dx, dy = sense * np.cos(points[y, x, 4]), sense * np.sin(points[y, x, 4])
    n = 0
    while n < len(way):
        best, to_x, to_y, to_dx, to_dy = 9.0, -1, -1, 0.0, 0.0
        for reach in range(1, GAP_PX + 1):
            cx, cy = int(np.rint(x + reach * dx)), int(np.rint(y + reach * dy))
            for j in range(max(BORDER_PX, cy - 1), min(h - BORDER_PX, cy + 2)):
                for i in range(max(BORDER_PX, cx - 1), min(w - BORDER_PX, cx + 2)):
                    if used[j, i] or points[j, i, 0] == 0.0 or points[j, i, 1] != sign:
                        continue
                    ex, ey = points[j, i, 2] - points[y, x, 2], points[j, i, 3] - points[y, x, 3]
                    ahead, aside = ex * dx + ey * dy, abs(ex * dy - ey * dx)
                    if ahead < 0.3 or aside > 0.6 * ahead:
                        continue
                    tx, ty = np.cos(points[j, i, 4]), np.sin(points[j, i, 4])
                    turn = tx * dx + ty * dy
                    if abs(turn) < MAX_BEND_COS:
                        continue
                    cost = ahead + 2.0 * aside + 3.0 * (1.0 - abs(turn))
                    if cost < best:
                        s = 1.0 if turn > 0 else -1.0
                        best, to_x, to_y, to_dx, to_dy = cost, i, j, s * tx, s * ty
            if to_x >= 0:
                break
        if to_x < 0:
            break
        x, y = to_x, to_y
        # the direction is averaged along the way: single ones are uncertain where the line is faint
        dx, dy = 0.6 * dx + 0.4 * to_dx, 0.6 * dy + 0.4 * to_dy
        size = np.sqrt(dx * dx + dy * dy)
        dx, dy = dx / size, dy / size
        used[y, x] = True
        way[n, 0], way[n, 1] = x, y
        n += 1
    return n


@compiled
def _sample(line: Float, rows: Float, chains: Index, count: int, chain: int) -> int:
    """Fits a straight line around every SAMPLE_PX-th point of a chain; what is crooked is left out."""
    n = len(line)
    for k in range(SAMPLE_PX // 2, n, SAMPLE_PX):
        first, last = max(0, k - FIT_PX), min(n, k + FIT_PX + 1)
        mx, my = 0.0, 0.0
        for i in range(first, last):
            mx, my = mx + line[i, 0], my + line[i, 1]
        mx, my = mx / (last - first), my / (last - first)
        xx, xy, yy = 0.0, 0.0, 0.0
        for i in range(first, last):
            ex, ey = line[i, 0] - mx, line[i, 1] - my
            xx, xy, yy = xx + ex * ex, xy + ex * ey, yy + ey * ey
        angle = 0.5 * np.arctan2(2.0 * xy, xx - yy)
        dx, dy = np.cos(angle), np.sin(angle)
        off = (dy * dy * xx - 2.0 * dx * dy * xy + dx * dx * yy) / (last - first)
        if off > STRAIGHT_PX * STRAIGHT_PX or count >= len(rows):
            continue
        along = (line[k, 0] - mx) * dx + (line[k, 1] - my) * dy
        rows[count, 0], rows[count, 1], rows[count, 2], rows[count, 3] = mx + along * dx, my + along * dy, dx, dy
        chains[count] = chain
        count += 1
    return count
