"""Ruin: strings of neighbouring views are cut out of neighbouring sorties."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from missions.frames import Array
from planning.allocate.minmax_state import Costs, Ints, Records, below, take_out, uniform

TAKEN_MEAN, STRING_MOST = 10.0, 10.0
SPLIT_SHARE, SPLIT_STOP = 0.5, 0.01
"""These are the paper's (see `minmax_anneal`)."""
LAST_SHARE = 0.5
"""Ruins that begin with the vehicle that is home last."""


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _cut_string(time: Costs, energy: Costs, nodes: Records, sorties: Records, finish: Array, random: NDArray[np.uint64],
                log: Ints, count: int, view: int, length: int) -> int:
    """Take a string of `length` views that holds `view` out of its sortie; in half of the cases some inside stay."""
    n, s = len(nodes) - len(sorties), nodes[view].sortie
    kept, size = 0, sorties[s].size
    if 1 < length < size and uniform(random) < SPLIT_SHARE:
        kept = 1
        while length + kept < size and uniform(random) >= SPLIT_STOP:
            kept += 1
    node = view
    for _ in range(below(random, length + kept)):
        if nodes[node].before >= n or nodes[nodes[node].before].locked:
            break
        node = nodes[node].before
    until_kept = 1 + below(random, length - 1)
    for _ in range(length + kept):
        if node >= n or nodes[node].locked or nodes[node].sortie != s:
            break
        follower = nodes[node].after
        if until_kept <= 0 and kept > 0:
            kept -= 1
        else:
            log[count, 0] = node
            log[count, 1] = nodes[node].before if nodes[node].before != node else n + s
            count += 1
            take_out(time, energy, nodes, sorties, finish, node)
        until_kept -= 1
        node = follower
    return count


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _seed_view(nodes: Records, sorties: Records, finish: Array, random: NDArray[np.uint64]) -> int:
    """A view at whose place the ruin begins: in half of the cases one of the vehicle that is home last."""
    n = len(nodes) - len(sorties)
    view = below(random, n)
    if uniform(random) < LAST_SHARE:
        last = np.argmax(finish)
        for _ in range(8 * len(finish)):
            if nodes[view].sortie >= 0 and sorties[nodes[view].sortie].owner == last:
                break
            view = below(random, n)
    return int(view)


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def ruin(time: Costs, energy: Costs, near: Ints, nodes: Records, sorties: Records, finish: Array,
         random: NDArray[np.uint64], log: Ints, ruined: NDArray[np.bool_]) -> int:
    """Takes strings of views out of neighbouring sorties; writes (view, node before it) to `log`; how many."""
    flown, flying = 0, 0
    for s in range(len(sorties)):
        flown += sorties[s].size
        flying += sorties[s].size > 0
    longest = min(STRING_MOST, max(1.0, flown / max(1, flying)))
    strings = 1 + below(random, 4.0 * TAKEN_MEAN / (1.0 + longest) - 1.0)
    seed = _seed_view(nodes, sorties, finish, random)
    ruined[:] = False
    count = 0
    for i in range(-1, near.shape[1]):
        view = seed if i < 0 else near[seed, i]
        s = nodes[view].sortie
        if s < 0 or ruined[s] or nodes[view].locked:
            continue
        length = 1 + below(random, min(float(sorties[s].size), longest))
        count = _cut_string(time, energy, nodes, sorties, finish, random, log, count, view, length)
        ruined[s] = True
        strings -= 1
        if strings == 0:
            break
    return count
