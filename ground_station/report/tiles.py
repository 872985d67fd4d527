"""The key numbers: value, what it is held against, and whether it passes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ground_station.report.metrics import STAGE_NAMES
from ground_station.report.run_data import RunData
from ground_station.report.thesis import NOTHING, REPORTED

PASS, ATTENTION, NEUTRAL = "pass", "attention", "neutral"
COVERAGE_TARGET, COMPLETENESS_TARGET = 0.80, 0.75
WALL_TARGET_S, MEMORY_TARGET_MIB = 480.0, 6144.0


@dataclass(frozen=True)
class Tile:
    """One number; `against` is the line of small print below it."""

    name: str
    value: str
    against: str
    state: str = NEUTRAL


def key_numbers(data: RunData, metrics: dict[str, Any]) -> list[Tile]:
    """The tiles of the page's head, most important first."""
    reported = REPORTED.get("" if data.mission.scene.path else data.mission.scene.name, NOTHING)
    return [*_safety(data, metrics), *_quality(metrics, reported), *_effort(data, metrics)]


def _safety(data: RunData, metrics: dict[str, Any]) -> list[Tile]:
    fleet = data.mission.fleet
    collisions, clearance, separation = (metrics[k] for k in ("collisions", "min_clearance_m", "min_separation_m"))
    return [
        Tile("Collisions", number(collisions, "{:d}"), "target 0", _judge(collisions, lambda v: v == 0)),
        Tile("Closest to the structure", number(clearance, "{:.2f} m"), f"body radius {fleet.radius_m:g} m, planned "
             f"clearance {fleet.clearance_m:g} m", _judge(clearance, lambda v: v > fleet.radius_m)),
        Tile("Closest to each other", number(separation, "{:.1f} m"), f"planned {fleet.separation_m:g} m",
             _judge(separation, lambda v: v > 2 * fleet.radius_m)),
    ]


def _quality(metrics: dict[str, Any], thesis: Any) -> list[Tile]:
    coverage, c2m = metrics["coverage"], metrics["c2m"]
    final, ceiling = coverage["final"], coverage["ceiling"]
    relative = final / ceiling if final is not None and ceiling else None
    complete = metrics["c2c"]["completeness"]["0.25"]
    return [
        Tile("Exploration coverage", percent(relative), f"of the reachable {percent(ceiling)}; target 80 %"
             + _beside(thesis.coverage, percent), _judge(relative, lambda v: v >= COVERAGE_TARGET)),
        Tile("C2C completeness, 0.25 m", percent(complete), "target 75 %" + _beside(thesis.c2c_025, percent),
             _judge(complete, lambda v: v >= COMPLETENESS_TARGET)),
        Tile("Mean error (C2M)", millimetres(c2m["mean_m"]), f"median {millimetres(c2m['median_m'])}"
             + _beside(thesis.mean_m, millimetres)),
        Tile("RMS error (C2M)", millimetres(c2m["rms_m"]), f"trimmed at 5 cm {millimetres(c2m['trimmed_5cm']['rms_m'])}"
             + _beside(thesis.rms_m, millimetres)),
        Tile("Within ±2 cm (C2M)", percent(c2m["within_2cm"]), "of the cloud's points"
             + _beside(thesis.within_2cm, percent)),
    ]


def _effort(data: RunData, metrics: dict[str, Any]) -> list[Tile]:
    fleet, threshold = metrics["fleet"], data.mission.battery.threshold_percent
    unreachable, batteries = fleet["views_unreachable"], list((fleet["battery_end_percent"] or {}).values())
    lowest = min(batteries) if batteries else None
    wall = sum(metrics["timing_s"].values()) or None
    memory = _most_memory(metrics["peak_memory_mib"])
    return [
        Tile("Survey views flown", number(fleet["views_flown"], "{:d}"), f"{number(fleet['views_reassigned'], '{:d}')} "
             f"reassigned, {number(unreachable, '{:d}')} unreachable", _judge(unreachable, lambda v: v == 0)),
        Tile("Flight time", clock(fleet["makespan_s"]), f"simulated; {_path(fleet['path_m'])} flown in all"),
        Tile("Lowest battery at end", number(lowest, "{:.0f} %"), f"hand-over at {threshold:g} %",
             _judge(lowest, lambda v: v > 0)),
        Tile("Time on this machine", clock(wall), "all phases; target 8:00 for the bridge",
             _judge(wall, lambda v: v <= WALL_TARGET_S)),
        Tile("Memory", number(memory, "{:,.0f} MiB"), "peaks of the processes that run together; target 6144 MiB",
             _judge(memory, lambda v: v <= MEMORY_TARGET_MIB)),
    ]


def _most_memory(peak_mib: dict[str, float | None]) -> float | None:
    """The flight's processes run together, each later stage alone."""
    flight = sum(v or 0.0 for name, v in peak_mib.items() if name not in STAGE_NAMES)
    return max([flight, *(v or 0.0 for name, v in peak_mib.items() if name in STAGE_NAMES)]) or None


def _judge(value: Any, passes: Any) -> str:
    if value is None:
        return NEUTRAL
    return PASS if passes(value) else ATTENTION


def _beside(value: float | None, form: Any) -> str:
    return "" if value is None else f"; thesis {form(value)}"


def _path(path_m: dict[str, float] | None) -> str:
    return number(sum(path_m.values()), "{:,.0f} m") if path_m else "unknown length"


def number(value: Any, form: str) -> str:
    """A number in a format, or a dash when unknown."""
    return "–" if value is None else form.format(value)


def percent(value: float | None) -> str:
    """A share (0-1) in per cent."""
    return number(None if value is None else 100 * value, "{:.1f} %")


def millimetres(value: float | None) -> str:
    """Metres in millimetres."""
    return number(None if value is None else 1000 * value, "{:.1f} mm")


def clock(seconds: float | None) -> str:
    """Seconds as minutes and seconds."""
    return "–" if seconds is None else f"{round(seconds) // 60}:{round(seconds) % 60:02d} min"
