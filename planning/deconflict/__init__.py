"""Several vehicles in one space: how near tracks come, and schedules that keep them apart."""

from planning.deconflict.separation import NEVER, distance_to_polyline_m, first_approach

__all__ = ["NEVER", "distance_to_polyline_m", "first_approach"]
