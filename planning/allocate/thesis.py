"""Allocation as in the thesis (section 4.4): a Ward cluster per vehicle, a networkx tour per cluster."""

from __future__ import annotations

import numpy as np

from missions.frames import Array
from planning.allocate.cost import LegCost
from planning.allocate.tours import open_tour
from planning.allocate.ward import clusters_to_vehicles, ward_clusters


def allocate(view_positions_enu_m: Array, starts_enu_m: Array, cost: LegCost,
             between: Array | None = None, from_start: Array | None = None) -> list[list[int]]:
    """A tour of view indices for every vehicle; each view is in exactly one tour.

    view_positions_enu_m: (n, 3). starts_enu_m: (m, 3), where each vehicle begins and ends. between: (n, n) and
    from_start: (m, n), symmetric costs of flown legs where they are known; `cost` of straight legs otherwise.
    """
    positions = np.asarray(view_positions_enu_m, dtype=np.float64).reshape(-1, 3)
    starts = np.asarray(starts_enu_m, dtype=np.float64).reshape(-1, 3)
    between = cost.between(positions, positions) if between is None else between
    from_start = cost.between(starts, positions) if from_start is None else from_start
    shares = clusters_to_vehicles(ward_clusters(positions, len(starts)), from_start)
    tours = []
    for vehicle, share in enumerate(shares):
        ends = from_start[vehicle, share]
        order = open_tour(between[np.ix_(share, share)], ends, ends)
        tours.append([int(share[i]) for i in order])
    return tours
