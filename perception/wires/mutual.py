"""Lines in space that several pictures found, each from its own samples, drawn together."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from missions.frames import Array
from perception.depth.compiled import compiled

REACH_M = 0.3
"""What was found so near along a line speaks for it."""
ASIDE_M = 0.03
"""And so near across it."""
PARALLEL_COS = math.cos(math.radians(8.0))

Index = NDArray[np.int64]


def drawn_together(places_enu_m: Array, lines: Array, picture: Index) -> tuple[Index, Array, Array]:
    """Of places (n, 3) with unit directions (n, 3) that pictures (n,) found: how many pictures found the same line
    there, own included, and the mean place, across the line, and direction of all of that.

    Cost: n times what lies within REACH_M.
    """
    count, place, line = np.zeros(len(lines), np.int64), places_enu_m.copy(), lines.copy()
    if not len(lines):
        return count, place, line
    cell = np.floor(places_enu_m / REACH_M).astype(np.int64)
    cell -= cell.min(axis=0) - 1
    shape = cell.max(axis=0) + 2
    key = (cell[:, 0] * shape[1] + cell[:, 1]) * shape[2] + cell[:, 2]
    order = np.argsort(key, kind="stable")
    steps = np.array([(i * shape[1] + j) * shape[2] for i in (-1, 0, 1) for j in (-1, 0, 1)])
    last = np.full(int(picture.max()) + 1, -1, np.int64)
    _draw(places_enu_m[order], lines[order], picture[order], key[order], steps, order, last, count, place, line)
    return count, place, line


@compiled
def _draw(places: Array, lines: Array, picture: Index, keys: Index, steps: Index, order: Index, last: Index,
          count: Index, place: Array, line: Array) -> None:
    """All but the results are sorted by cell."""
    total = np.empty(6)
    for i in range(len(places)):
        total[:] = 0.0
        n = 0
        for step in steps:
            first = np.searchsorted(keys, keys[i] + step - 1)
            for k in range(first, len(keys)):
                if keys[k] > keys[i] + step + 1:
                    break
                cosine, along, apart = 0.0, 0.0, 0.0
                for a in range(3):
                    e = places[k, a] - places[i, a]
                    cosine += lines[i, a] * lines[k, a]
                    along += e * lines[i, a]
                    apart += e * e
                if abs(cosine) < PARALLEL_COS or abs(along) > REACH_M or apart - along * along > ASIDE_M * ASIDE_M:
                    continue
                for a in range(3):
                    total[a] += places[k, a] - places[i, a] - along * lines[i, a]
                    total[3 + a] += lines[k, a] if cosine > 0.0 else -lines[k, a]
                n += 1
                if last[picture[k]] != i:
                    last[picture[k]] = i
                    count[order[i]] += 1
        size = np.sqrt(total[3] ** 2 + total[4] ** 2 + total[5] ** 2)
        for a in range(3):
            place[order[i], a] = places[i, a] + total[a] / n
            line[order[i], a] = total[3 + a] / size
