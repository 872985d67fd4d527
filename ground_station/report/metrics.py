"""metrics.json: every number of a run in one document, null where it is unknown."""

from __future__ import annotations

from typing import Any

from ground_station.report.alignment import alignment
from ground_station.report.energy import energy_numbers
from ground_station.report.measure import Measured
from ground_station.report.run_data import RunData
from ground_station.report.service import service_numbers
from perception.evaluate.comparison import (
    c2c_numbers,
    c2m_numbers,
    confidence_numbers,
    part_numbers,
    reach_numbers,
)

FLEET_KEYS = ("makespan_s", "path_m", "battery_end_percent", "views_flown", "views_reassigned", "views_unreachable")
COVERAGE_KEYS = ("final", "ceiling", "auc", "per_view")


def assemble(data: RunData, measured: Measured | None) -> dict[str, Any]:
    """The document. Shares are 0-1, lengths metres, times seconds."""
    compared = None if measured is None else measured.comparison
    fleet, coverage = data.flight.get("fleet") or {}, data.referee.get("coverage") or {}
    return {
        "title": data.mission.title,
        "collisions": data.referee.get("collisions"),
        "min_clearance_m": data.referee.get("min_clearance_m"),
        "min_separation_m": data.referee.get("min_separation_m"),
        "coverage": {key: coverage.get(key) for key in COVERAGE_KEYS},
        "alignment": alignment(data),
        "c2c": c2c_numbers(compared),
        "reachable": None if measured is None or measured.reachable is None
        else reach_numbers(measured.comparison, measured.reachable),
        "c2m": c2m_numbers(compared),
        "parts": [] if compared is None else part_numbers(compared),
        "confidence": [] if compared is None else confidence_numbers(compared),
        "inspection": None if measured is None else measured.inspection.numbers(measured.asked),
        "fleet": {key: fleet.get(key) for key in FLEET_KEYS},
        "service": service_numbers(data),
        "energy": energy_numbers(data),
        "timing_s": timing(data),
        "peak_memory_mib": {r["name"]: r.get("peak_memory_mib") for r in data.run.process_records()},
        "seed": data.mission.seed,
        "mission_hash": data.mission.mission_hash,
        "notes": [*(data.flight.get("notes") or []), *(f"scene: {n}" for n in data.referee.get("notes") or []),
                  *data.notes],
    }


def timing(data: RunData) -> dict[str, float]:
    """Wall seconds by phase: of the flight's phases from flight.json, of the stages after it from their records."""
    phases = {name: phase.get("wall_s") for name, phase in (data.flight.get("phases") or {}).items()}
    stages = {r["name"]: r.get("wall_s") for r in data.run.process_records() if r["name"] in STAGE_NAMES}
    ordered = {**phases, **{name: stages[name] for name in STAGE_NAMES if name in stages}}
    return {name: seconds for name, seconds in ordered.items() if seconds is not None}


STAGE_NAMES = ("reconstruct", "evaluate", "report")
