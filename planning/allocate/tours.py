"""The order of one vehicle's views: networkx's travelling-salesman heuristics (thesis section 4.4.2)."""

from __future__ import annotations

import networkx as nx
import numpy as np

from missions.frames import Array


def closed_tour(cost: Array) -> list[int]:
    """Order of all nodes of a symmetric (n, n) cost matrix in a short round trip, beginning with node 0.

    The shorter of networkx's greedy and Christofides tours; its annealing never improved on either.
    """
    n = len(cost)
    if n <= 3:
        return list(range(n))
    graph = nx.from_numpy_array(cost + 1e-9 * (1.0 - np.eye(n)))
    tours = [nx.approximation.greedy_tsp(graph, source=0), nx.approximation.christofides(graph)]
    best: list[int] = min(tours, key=lambda tour: _length(cost, tour))[:-1]
    turn = best.index(0)
    return best[turn:] + best[:turn]


def open_tour(between: Array, from_start: Array, to_home: Array) -> list[int]:
    """Order of the n views of one vehicle from its start over all of them and home.

    between: (n, n) costs; from_start, to_home: (n,) costs. The round trip over the views is cut, and possibly turned
    round, where the ways from the start and home lengthen it least.
    """
    n = len(between)
    if n < 2:
        return list(range(n))
    cycle = closed_tour(between)
    options = []
    for order in (cycle, cycle[::-1]):
        for cut in range(n):
            first, last = order[cut], order[cut - 1]
            options.append((float(from_start[first] + to_home[last] - between[last, first]), order, cut))
    _, order, cut = min(options, key=lambda option: option[0])
    return order[cut:] + order[:cut]


def _length(cost: Array, cycle: list[int]) -> float:
    return float(cost[cycle[:-1], cycle[1:]].sum())
