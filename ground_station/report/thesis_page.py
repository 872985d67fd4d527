"""The page's part on the thesis's experiment: its figures for this run, its own numbers beside ours."""

from __future__ import annotations

from ground_station.report import thesis_charts as figures
from ground_station.report.run_data import RunData
from ground_station.report.sections import chart, chart_section, pair, section
from ground_station.report.tables import table
from ground_station.report.thesis import ReportedPlan
from ground_station.report.thesis_run import ThesisRun, plan_run, reported_plan, write_waypoints
from missions.errors import UserError
from planning.allocate.thesis_experiment import Experiment
from planning.paths.thesis import NO_VIEW

NOT_GIVEN = "–"


def thesis_part(data: RunData) -> str:
    """HTML; empty for missions that do not fly the thesis's method. Writes the plan's waypoints into the run folder."""
    if data.mission.survey.method != "thesis":
        return ""
    try:
        run = plan_run(data)
    except UserError as e:
        data.notes.append(str(e))
        return ""
    reported = reported_plan(data.mission)
    flown = data.mission.survey.cost
    write_waypoints(run.plans[flown], data.run.thesis_waypoints)
    return _clustering(run, run.plans[flown], reported) + _batteries(data, run, reported) + section(
        f"Planned tours, {figures.COST_NAMES[flown]}" + _figure(reported.tours_figure if reported else None),
        "As planned with the true structure known; dotted where a vehicle took views over, diamonds where waypoints "
        "without a picture lead around the structure.", chart(figures.tours(run, run.plans[flown])))


def _clustering(run: ThesisRun, plan: Experiment, reported: ReportedPlan | None) -> str:
    head, *rows = comparison_rows(run, reported)
    return "".join([
        section("The thesis's experiment beside this run", "Section 5.3, forecast by Algorithm 1 over the "
                "views of this run. Vehicles count from 1 here and from 0 in the thesis.", table(head, rows)),
        pair(chart_section("Views per vehicle (Figure 5.7)", "The size of each Ward cluster.",
                           figures.points_per_uav(plan, reported)),
             chart_section("Path lengths (Figure 5.9)", "Views in the order they were taken, and as networkx tours.",
                           figures.distances(run))),
        section("Clusters (Figure 5.8)", "", chart(figures.clusters(run, plan))),
        chart_section("Dendrogram (Figure 4.10)", "Ward's merges of all views; the cut leaves a cluster per vehicle.",
                      figures.merges(run, plan))])


def _batteries(data: RunData, run: ThesisRun, reported: ReportedPlan | None) -> str:
    parts = []
    for cost, plan in run.plans.items():
        flown = _levels(data, plan) if cost == data.mission.survey.cost else {}
        number = reported.figures.get(cost) if reported else None
        parts.append(chart_section(
            f"Battery, {figures.COST_NAMES[cost]}" + _figure(number),
            "Algorithm 1 over the waypoints of each tour, full at the first one; a cross where the threshold is met."
            + (" Thin lines: as flown, at each picture, the way from the pad included." if any(flown.values()) else ""),
            figures.battery(plan, flown)))
    return pair(*parts)


def comparison_rows(run: ThesisRun, reported: ReportedPlan | None) -> list[list[str]]:
    """The head, then a row per quantity: a column per cost, the thesis's numbers beside ours."""
    head = ["", *(f"{figures.COST_NAMES[cost]}{which}" for cost in run.plans for which in ("", ", thesis"))]
    names = ["views", "views per vehicle", "waypoints around the structure", "consumption (% per metre)",
             "tour lengths (m)", "stops at waypoint", "level there (%)", "points handed over", "of them, views",
             "views that nobody can afford", "legs without a way round"]
    columns = []
    for cost, plan in run.plans.items():
        columns += [_ours(plan), _theirs(reported, cost, len(names))]
    return [head, *([name, *(column[i] for column in columns)] for i, name in enumerate(names))]


def _ours(plan: Experiment) -> list[str]:
    tours = list(plan.tours.values())
    stopped = [t for t in tours if t.stop is not None]
    return [
        str(len(plan.owners.view_id)), " / ".join(str(int((t.own.view != NO_VIEW).sum())) for t in tours),
        str(sum(int((t.own.view == NO_VIEW).sum()) for t in tours)), f"{plan.discharge.percent_per_m:.4f}",
        " / ".join(f"{t.optimised_m:.0f}" for t in tours),
        " / ".join(f"{t.stop}" for t in stopped) or "none stops",
        " / ".join(f"{t.forecast.level_percent[t.stop]:.2f}" for t in stopped) or NOT_GIVEN,
        " / ".join(str(len(t.own.view) - t.stop) for t in stopped if t.stop is not None) or "0",
        " / ".join(str(len(t.left)) for t in stopped) or "0", str(len(plan.left_over)),
        str(sum(len(t.own.refused) + len(t.added.refused) for t in tours))]


def _theirs(reported: ReportedPlan | None, cost: str, rows: int) -> list[str]:
    if reported is None or cost not in reported.figures:
        return [NOT_GIVEN] * rows
    stop = reported.stops.get(cost)
    stopping = ["none stops", NOT_GIVEN, "0"]
    if stop is not None:
        stopping = [str(stop.index), f"{stop.level_percent:.2f}", str(stop.left)]
    return [str(reported.points), " / ".join(map(str, reported.points_per_uav)) or NOT_GIVEN, NOT_GIVEN,
            f"{reported.percent_per_m:.2f}, scaled scene", NOT_GIVEN, *stopping, NOT_GIVEN, NOT_GIVEN, NOT_GIVEN]


def _levels(data: RunData, plan: Experiment) -> dict[int, list[float]]:
    """Level at each survey picture, by vehicle."""
    survey = {v.view_id for v in data.views if v.phase == "survey"}
    told = data.flight.get("battery_at_view") or []
    return {k: [v["battery_percent"] for v in told if v["vehicle_id"] == k and v["view_id"] in survey]
            for k in plan.tours}


def _figure(number: str | None) -> str:
    return f" (Figure {number})" if number else ""
