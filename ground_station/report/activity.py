"""What every vehicle did when, from its recorded modes and the flight's phases."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ground_station.report.run_data import Track

GROUND, SWAP, TAKEOFF, EXPLORE, SURVEY, WAIT, HOLD, RETURN, LAND, EMERGENCY = (
    "on the ground", "battery swap", "taking off", "exploring", "surveying", "waiting for a way", "holding",
    "returning", "landing", "emergency landing")
ACTIVITIES = (GROUND, SWAP, TAKEOFF, EXPLORE, SURVEY, WAIT, HOLD, RETURN, LAND, EMERGENCY)
ON_THE_GROUND = ("standby", "swap")
_BY_MODE = {"standby": GROUND, "swap": SWAP, "takeoff": TAKEOFF, "wait": WAIT, "hold": HOLD, "return": RETURN,
            "land": LAND, "emergency": EMERGENCY}


@dataclass(frozen=True)
class Span:
    """One vehicle doing one thing for a while."""

    activity: str
    start_s: float
    end_s: float


def spans(track: Track, phases: dict[str, Any]) -> list[Span]:
    """The vehicle's whole track, cut where its activity changes."""
    if not len(track.mode):
        return []
    done = _activities(track, phases)
    cuts = np.flatnonzero(done[1:] != done[:-1]) + 1
    first = np.concatenate([[0], cuts])
    last = np.concatenate([cuts, [len(done) - 1]])
    return [Span(str(done[a]), float(track.t_s[a]), float(track.t_s[b])) for a, b in zip(first, last, strict=True)]


def airborne(track: Track) -> NDArray[np.bool_]:
    """(n,) whether the vehicle was off the ground; everywhere where no mode was recorded."""
    return ~np.isin(track.mode, ON_THE_GROUND) if len(track.mode) else np.ones(len(track.t_s), dtype=np.bool_)


def _activities(track: Track, phases: dict[str, Any]) -> NDArray[np.str_]:
    """A plan under way is exploration until the survey begins."""
    explored = float((phases.get("explore") or {}).get("end_s", 0.0))
    flying = np.where(track.t_s < explored, EXPLORE, SURVEY)
    named = np.array([_BY_MODE.get(str(mode), "") for mode in track.mode])
    return np.where(named == "", flying, named)
