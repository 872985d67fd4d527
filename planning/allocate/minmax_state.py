"""The state of a min-max search as compiled code changes it: sorties as linked rings of nodes, and random numbers.

Nodes 0..n-1 are views, n + r is home in sortie r. A free tour's ring leaves its home out.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from missions.frames import Array

Ints = NDArray[np.int32]
Costs = NDArray[np.float32]
Records = NDArray[Any]

NODE = np.dtype([("after", "i4"), ("before", "i4"), ("sortie", "i4"), ("wanted", "i4"), ("leg", "f8"), ("tick", "i8"),
                 ("locked", "?")], align=True)
"""after, before: in the ring. sortie: -1 when nobody flies it. wanted: the vehicle that it costs to take the view from;
-1: none. leg: seconds to the node after it. tick: of the last search that priced it. locked: stays where it is, with
nothing put before it."""
SORTIE = np.dtype([("owner", "i4"), ("kind", "i4"), ("size", "i4"), ("used", "f8"), ("budget", "f8")], align=True)
"""owner: the vehicle; its sorties follow each other. size: views in it. used, budget: energy in percent."""


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def uniform(random: NDArray[np.uint64]) -> float:
    """[0, 1) by xorshift64*."""
    x = random[0]
    x ^= x >> np.uint64(12)
    x ^= x << np.uint64(25)
    x ^= x >> np.uint64(27)
    random[0] = x
    return float(((x * np.uint64(0x2545F4914F6CDD1D)) >> np.uint64(11)) * (1.0 / 9007199254740992.0))


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def below(random: NDArray[np.uint64], bound: float) -> int:
    """An integer from 0 up to the bound, below it."""
    return int(uniform(random) * bound)


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def take_out(time: Costs, energy: Costs, nodes: Records, sorties: Records, finish: Array, view: int) -> None:
    """Out of the sortie that flies it."""
    s = nodes[view].sortie
    p, q, k = nodes[view].before, nodes[view].after, sorties[s].kind
    nodes[view].sortie = -1
    sorties[s].size -= 1
    vehicle = sorties[s].owner
    if p == view:
        finish[vehicle] -= nodes[view].leg
        return
    leg = float(time[k, p, q])
    finish[vehicle] += leg - nodes[p].leg - nodes[view].leg
    if len(energy):
        sorties[s].used += float(energy[k, p, q]) - float(energy[k, p, view]) - float(energy[k, view, q])
    nodes[p].after, nodes[p].leg = q, leg
    nodes[q].before = p


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def put_in(time: Costs, energy: Costs, nodes: Records, sorties: Records, finish: Array, free: bool, view: int,
           p: int) -> None:
    """Behind node p; behind the home of an empty free tour: alone."""
    s = nodes[p].sortie
    k, vehicle = sorties[s].kind, sorties[s].owner
    nodes[view].sortie = s
    sorties[s].size += 1
    if free and p >= len(nodes) - len(sorties):
        nodes[view].after = nodes[view].before = view
        nodes[view].leg = time[k, view, view]
        finish[vehicle] += nodes[view].leg
        return
    q = nodes[p].after
    to, on = float(time[k, p, view]), float(time[k, view, q])
    finish[vehicle] += to + on - nodes[p].leg
    if len(energy):
        sorties[s].used += float(energy[k, p, view]) + float(energy[k, view, q]) - float(energy[k, p, q])
    nodes[p].after, nodes[p].leg = view, to
    nodes[view].before, nodes[view].after, nodes[view].leg = p, q, on
    nodes[q].before = view
