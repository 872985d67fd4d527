"""`swarmscan bench energy`: the power model beside the published multirotor, and predictions beside what runs consumed.

Runs are folders that `swarmscan fly` made. For the plans that were flown to their end the prediction at their upload
stands beside what the vehicle's battery lost, and beside Algorithm 1 of the thesis, the mission's rate over the path
that was flown in the end.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from rich.console import Group
from rich.table import Table

from ground_station.report.energy import predicted_plans, used_percent
from ground_station.report.run_data import RunData, read_run
from missions.console import print_result
from missions.frames import Array
from missions.mission import AirframeSpec
from missions.mission_file import find_mission, load_mission
from missions.run_folder import RunFolder
from planning.trajectories.power import PowerModel, fit, published

SPEEDS_M_S = np.arange(0.0, 16.5, 1.0)
FINE_M_S = np.arange(0.5, 16.0, 0.01)
TOLERANCE = 0.03


@dataclass(frozen=True)
class Published:
    """A flight of the specification: power that it tells, power of the model, and the model's own best speed."""

    flight: str
    speed_m_s: float
    published_w: float
    model_w: float
    model_best_m_s: float


@dataclass(frozen=True)
class Consumption:
    """The plans of one phase of a run, summed, percent of a full battery; errors are shares of what was used."""

    run: str
    phase: str
    plans: int
    used_percent: float
    predicted_percent: float
    error: float
    algorithm_1_error: float
    waited: int
    """Plans in which the vehicle waited for a teammate or a map, which nobody could foresee."""
    error_without_waiting: float
    """Over the other plans."""
    within_3_percent: float
    """Share of the other plans."""


def main(argv: Sequence[str]) -> int:
    """Run the benchmark; returns the exit code."""
    parser = argparse.ArgumentParser(prog="swarmscan bench energy", description=__doc__)
    parser.add_argument("runs", nargs="*", type=Path, metavar="RUN", help="run folders")
    parser.add_argument("--mission", help="whose airframe is shown (default: the DJI Mini 4 Pro)")
    parser.add_argument("--json", action="store_true", help="one JSON document instead of tables")
    options = parser.parse_args(argv)
    airframe = load_mission(find_mission(options.mission)).airframe if options.mission else AirframeSpec()
    model = fit(airframe)
    points, watts = beside_published(model, airframe), model.cruise_w(SPEEDS_M_S)
    rows = [row for run in options.runs for row in consumption(run.name, read_run(RunFolder(run)))]
    curve = [{"speed_m_s": v, "power_w": w} for v, w in zip(SPEEDS_M_S.tolist(), watts.tolist(), strict=True)]
    tables = [_published_table(points), _curve_table(watts), *([_runs_table(rows)] if rows else [])]
    print_result({"airframe": msgspec.to_builtins(airframe), "model": model, "curve": curve, "published": points,
                  "runs": rows}, Group(*tables), options.json)
    return 0


def beside_published(model: PowerModel, airframe: AirframeSpec) -> list[Published]:
    """Hovering, the longest and the farthest flight. That the last two are the model's best speeds is no part of the
    fit."""
    speeds, watts = published(airframe)
    fine = model.cruise_w(FINE_M_S)
    best = (0.0, FINE_M_S[fine.argmin()], FINE_M_S[(fine / FINE_M_S).argmin()])
    rows = zip(("hover", "longest", "farthest"), speeds, watts, model.cruise_w(speeds), best, strict=True)
    return [Published(name, *(float(value) for value in values)) for name, *values in rows]


def consumption(name: str, data: RunData) -> list[Consumption]:
    """One row per phase that has plans with a prediction."""
    plans = predicted_plans(data)
    phases = [phase for phase in ("explore", "survey") if any(p["phase"] == phase for p in plans)]
    return [_summed(name, phase, [p for p in plans if p["phase"] == phase], data) for phase in phases]


def _summed(name: str, phase: str, plans: list[dict[str, Any]], data: RunData) -> Consumption:
    used = np.array([used_percent(p) for p in plans])
    predicted = np.array([p["predicted_percent"] for p in plans])
    metres, waited = (np.array(c) for c in zip(*(_flown(p, data) for p in plans), strict=True))
    by_length = data.mission.battery.percent_per_m * metres
    free = ~waited
    return Consumption(name, phase, len(plans), float(used.sum()), float(predicted.sum()), _error(predicted, used),
                       _error(by_length, used), int(waited.sum()), _error(predicted[free], used[free]),
                       float(np.mean(np.abs(predicted[free] / used[free] - 1.0) <= TOLERANCE)) if free.any() else 0.0)


def _flown(plan: dict[str, Any], data: RunData) -> tuple[float, bool]:
    """Metres that were flown between a plan's start and end, and whether the vehicle waited meanwhile."""
    track = next(t for t in data.tracks if t.vehicle_id == plan["vehicle_id"])
    during = (track.t_s >= plan["start_s"]) & (track.t_s <= plan["end_s"])
    metres = float(np.linalg.norm(np.diff(track.position_enu_m[during], axis=0), axis=1).sum())
    return metres, bool(len(track.mode) and np.any(track.mode[during] == "wait"))


def _error(told: Array, used: Array) -> float:
    return float(told.sum() / used.sum() - 1.0) if used.sum() > 0.0 else 0.0


def _published_table(points: Sequence[Published]) -> Table:
    table = Table("flight", title="Published flights and the fitted model")
    for heading in ("speed m/s", "published W", "model W", "model's best speed m/s"):
        table.add_column(heading, justify="right")
    for p in points:
        table.add_row(p.flight, f"{p.speed_m_s:.2f}", f"{p.published_w:.2f}", f"{p.model_w:.2f}",
                      f"{p.model_best_m_s:.2f}")
    return table


def _curve_table(watts: Array) -> Table:
    table = Table("m/s", "W", title="Level flight in still air")
    for speed, power in zip(SPEEDS_M_S, watts, strict=True):
        table.add_row(f"{speed:.0f}", f"{power:.1f}")
    return table


def _runs_table(rows: Sequence[Consumption]) -> Table:
    table = Table("run", "phase", title="Predicted when plans were sent, and used (percent of a battery)",
                  caption="error: of the prediction, of Algorithm 1, of plans without waiting, and their share in 3 %")
    for heading in ("plans", "used", "pred.", "error", "Alg. 1", "waited", "others", "in 3 %"):
        table.add_column(heading, justify="right")
    for r in rows:
        table.add_row(r.run, r.phase, str(r.plans), f"{r.used_percent:.2f}", f"{r.predicted_percent:.2f}",
                      f"{r.error:+.1%}", f"{r.algorithm_1_error:+.1%}", str(r.waited),
                      f"{r.error_without_waiting:+.1%}", f"{r.within_3_percent:.0%}")
    return table
