"""The thesis's figures 4.10 and 5.7 to 5.15 for a run of ours (plotly)."""

from __future__ import annotations

from typing import Any

import numpy as np
import plotly.graph_objects as go
from scipy.cluster.hierarchy import dendrogram

from ground_station.report.charts import BAD, INK, blank, colour, in_space, scatter_in_space
from ground_station.report.thesis import ReportedPlan
from ground_station.report.thesis_run import ThesisRun
from missions.frames import Array
from planning.allocate.thesis_experiment import Experiment
from planning.allocate.ward import ward_linkage
from planning.paths.thesis import NO_VIEW

THESIS_COLOUR, SURFACE = "#9aa5b1", "#b8c0cc"
SHOWN_SURFACE = 12_000
COST_NAMES = {"distance": "distance", "distance_elevation": "distance + elevation"}


def points_per_uav(plan: Experiment, reported: ReportedPlan | None) -> go.Figure:
    """Figure 5.7: views in each vehicle's cluster."""
    figure = blank("", "Views")
    names = [f"UAV {k}" for k in plan.tours]
    figure.add_bar(x=names, y=[int((t.own.view != NO_VIEW).sum()) for t in plan.tours.values()], name="this run",
                   marker={"color": [colour(k) for k in plan.tours]}, texttemplate="%{y}")
    if reported is not None and reported.points_per_uav:
        figure.add_bar(x=names, y=reported.points_per_uav, name="thesis", marker={"color": THESIS_COLOUR},
                       texttemplate="%{y}")
    figure.update_layout(barmode="group", showlegend=bool(reported and reported.points_per_uav))
    return figure


def clusters(run: ThesisRun, plan: Experiment) -> go.Figure:
    """Figure 5.8: the views in 3-D, coloured by cluster."""
    figure = _over_the_structure(run)
    for k, tour in plan.tours.items():
        mine = run.positions_enu_m[tour.own.view[tour.own.view != NO_VIEW]]
        scatter_in_space(figure, mine, f"cluster of UAV {k} ({len(mine)})", mode="markers",
                         marker={"size": 3.5, "color": colour(k)})
    return figure


def merges(run: ThesisRun, plan: Experiment) -> go.Figure | None:
    """Figure 4.10: Ward's dendrogram, coloured as the clusters, with the cut that leaves one cluster per vehicle."""
    count, vehicles = len(run.positions_enu_m), len(plan.tours)
    if count < 2:
        return None
    linkage = ward_linkage(run.positions_enu_m)
    tree = dendrogram(linkage, no_plot=True, color_threshold=0.0)
    cut = 0.5 * (linkage[-vehicles, 2] + linkage[1 - vehicles, 2]) if 1 < vehicles < count else linkage[-1, 2]
    owner = dict(zip(plan.owners.view_id.tolist(), plan.owners.origin_vehicle.tolist(), strict=True))
    leaves = [owner[view] for view in tree["leaves"]]
    strokes: dict[str, tuple[list[float | None], list[float | None]]] = {}
    for across, up in zip(tree["icoord"], tree["dcoord"], strict=True):
        below = leaves[min(count - 1, int(across[0] // 10.0))]
        x, y = strokes.setdefault(INK if up[1] > cut else colour(below), ([], []))
        x += [*across, None]
        y += [*up, None]
    figure = blank("Views", "Distance between merged clusters (Ward)")
    for stroke, (x, y) in strokes.items():
        figure.add_scatter(x=x, y=y, mode="lines", line={"color": stroke, "width": 1}, hoverinfo="skip")
    figure.add_hline(y=cut, line={"color": BAD, "width": 1, "dash": "dash"},
                     annotation_text=f"cut into {vehicles} clusters", annotation_position="top right")
    figure.update_layout(showlegend=False, xaxis={"showticklabels": False, "showgrid": False})
    return figure


def distances(run: ThesisRun) -> go.Figure:
    """Figure 5.9: lengths of the clusters' views in their original order and as tours, per vehicle."""
    figure = blank("", "Path length (m)")
    first = next(iter(run.plans.values()))
    names = [f"UAV {k}" for k in first.tours]
    bars: list[tuple[str, list[float], Any]] = [
        ("original order", [t.original_m for t in first.tours.values()], THESIS_COLOUR)]
    bars += [(f"tour by {COST_NAMES[cost]}", [t.optimised_m for t in plan.tours.values()], tint)
             for (cost, plan), tint in zip(run.plans.items(), (INK, "#56B4E9"), strict=False)]
    for name, lengths, tint in bars:
        figure.add_bar(x=names, y=lengths, name=name, marker={"color": tint}, texttemplate="%{y:.0f}")
    figure.update_layout(barmode="group", legend={"y": -0.15, "yanchor": "top"})
    return figure


def battery(plan: Experiment, flown: dict[int, list[float]]) -> go.Figure:
    """Figures 5.10, 5.12 and 5.14: Algorithm 1 over waypoints, where it meets the threshold, and what was taken over.

    flown: level at each survey picture of a vehicle, in order; shown beside the forecast where there is any.
    """
    figure = blank("Waypoint", "Battery (%)")
    for k, tour in plan.tours.items():
        level, own = plan.forecast(k).level_percent, len(tour.own.view)
        until = own if tour.stop is None else tour.stop + 1
        line = {"color": colour(k), "width": 2}
        figure.add_scatter(x=list(range(until)), y=level[:until], mode="lines", name=f"UAV {k} forecast", line=line)
        if tour.stop is not None:
            figure.add_scatter(x=[tour.stop], y=[level[tour.stop]], mode="markers+text", showlegend=False,
                               marker={"symbol": "x", "size": 11, "color": BAD}, textposition="bottom left",
                               text=[f"{tour.stop}: {level[tour.stop]:.2f} %, {len(tour.left)} left"])
        if len(level) > own:
            figure.add_scatter(x=list(range(own - 1, len(level))), y=level[own - 1 :], mode="lines",
                               name=f"UAV {k}, taken over", line={**line, "dash": "dot"})
        if flown.get(k):
            figure.add_scatter(x=list(range(len(flown[k]))), y=flown[k], mode="lines", name=f"UAV {k} flown",
                               line={"color": colour(k), "width": 1}, opacity=0.5)
    threshold = plan.discharge.threshold_percent
    figure.add_hline(y=threshold, line={"color": BAD, "width": 1, "dash": "dash"},
                     annotation_text=f"threshold {threshold:g} %", annotation_position="top left")
    figure.update_layout(height=390, legend={"y": -0.2, "yanchor": "top"})
    figure.update_yaxes(range=[0, 104])
    return figure


def tours(run: ThesisRun, plan: Experiment) -> go.Figure:
    """Figures 5.11, 5.13 and 5.15: the planned tours in 3-D with the structure; taken-over parts are dotted."""
    figure = _over_the_structure(run)
    for k, tour in plan.tours.items():
        path, view = tour.flown.points_enu_m, tour.flown.view
        own = len(tour.own.view) if tour.stop is None else tour.stop
        _line(figure, path[:own], f"UAV {k}", k, "solid")
        if len(path) > own:
            _line(figure, path[max(0, own - 1) :], f"UAV {k}, taken over", k, "dot")
        around = path[view == NO_VIEW]
        if len(around):
            scatter_in_space(figure, around, f"UAV {k}, around the structure ({len(around)})", mode="markers",
                             marker={"size": 4, "symbol": "diamond", "color": INK})
    return figure


def _line(figure: go.Figure, path: Array, name: str, vehicle_id: int, dash: str) -> None:
    scatter_in_space(figure, path, name, mode="lines+markers", marker={"size": 1.8, "color": colour(vehicle_id)},
                     line={"color": colour(vehicle_id), "width": 3, "dash": dash})


def _over_the_structure(run: ThesisRun) -> go.Figure:
    figure = in_space()
    shown = np.random.default_rng(0).permutation(len(run.surface_enu_m))[:SHOWN_SURFACE]
    if len(shown):
        scatter_in_space(figure, run.surface_enu_m[shown], "structure", mode="markers", hoverinfo="skip",
                         marker={"size": 1.2, "color": SURFACE})
    return figure
