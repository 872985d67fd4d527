"""Several vehicles in one space: how near tracks come, and schedules that keep them apart."""

from planning.deconflict.schedule import Conflict, Schedule, Tour, Track, conflicts, schedule
from planning.deconflict.separation import NEVER, distance_to_polyline_m, first_approach, meeting

__all__ = ["NEVER", "Conflict", "Schedule", "Tour", "Track", "conflicts", "distance_to_polyline_m", "first_approach",
           "meeting", "schedule"]
