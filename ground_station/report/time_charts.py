"""The page's charts of the fleet over time (plotly), each None when the run has nothing to show in it."""

from __future__ import annotations

from typing import Any

import numpy as np
import plotly.graph_objects as go

from ground_station.report.activity import ACTIVITIES, Span, spans
from ground_station.report.charts import BAD, INK, blank, colour
from ground_station.report.energy import predicted_plans, used_percent
from ground_station.report.run_data import RunData
from ground_station.report.separation import nearest_pairs

ACTIVITY_COLOURS = dict(zip(ACTIVITIES, (
    "#e4e7eb", "#b8c0cc", "#c3a6e0", "#56B4E9", "#0072B2", "#E69F00", "#f3d08a", "#009E73", "#8fd3bd", "#c53030"),
    strict=True))
SHOWN_SAMPLES = 1500


def gantt(data: RunData) -> go.Figure | None:
    """One row per vehicle, coloured by what it was doing; the phases' borders are lines."""
    phases = data.flight.get("phases") or {}
    rows = [(f"UAV {t.vehicle_id}", span) for t in data.tracks for span in spans(t, phases)]
    if not rows:
        return None
    figure = blank("Simulated time (min)", "")
    for activity in ACTIVITIES:
        shown = [(name, span) for name, span in rows if span.activity == activity]
        if shown:
            figure.add_bar(orientation="h", name=activity, y=[name for name, _ in shown],
                           x=[(span.end_s - span.start_s) / 60 for _, span in shown],
                           base=[span.start_s / 60 for _, span in shown], hovertext=[_told(span) for _, span in shown],
                           hoverinfo="y+text", width=0.62,
                           marker={"color": ACTIVITY_COLOURS[activity], "line": {"width": 0}})
    for name, phase in phases.items():
        figure.add_vline(x=phase["start_s"] / 60, line={"color": INK, "width": 1, "dash": "dot"},
                         annotation_text=name, annotation_position="top right", annotation_yshift=18)
    vehicles = len(data.tracks)
    figure.update_layout(barmode="overlay", height=150 + 38 * vehicles, margin={"t": 40},
                         legend={"y": -0.42 if vehicles < 4 else -0.2, "traceorder": "normal"})
    figure.update_yaxes(autorange="reversed")
    return figure


def _told(span: Span) -> str:
    return f"{span.activity}, {span.start_s:.1f} to {span.end_s:.1f} s"


def separation(data: RunData) -> go.Figure | None:
    """Least distance between any two vehicles at every moment, with the one that is kept as a line."""
    near = nearest_pairs(data.tracks)
    if not len(near.t_s):
        return None
    figure = blank("Simulated time (min)", "Nearest two vehicles (m)")
    # of each stretch of time the smallest, so that no approach falls between two drawn points
    stretches = np.array_split(np.arange(len(near.t_s)), min(SHOWN_SAMPLES, len(near.t_s)))
    drawn = [int(stretch[np.argmin(near.distance_m[stretch])]) for stretch in stretches]
    figure.add_scatter(x=near.t_s[drawn] / 60, y=near.distance_m[drawn], mode="lines", name="nearest two",
                       line={"color": INK, "width": 1.5}, text=[f"UAV {a} and UAV {b}" for a, b in near.pair[drawn]])
    i = int(np.argmin(near.distance_m))
    figure.add_annotation(x=near.t_s[i] / 60, y=near.distance_m[i], ax=0, ay=-60, bgcolor="white", arrowcolor=INK,
                          text=f"least {near.distance_m[i]:.2f} m at {near.t_s[i]:.0f} s")
    kept = data.mission.fleet.separation_m
    figure.add_hline(y=kept, line={"color": BAD, "width": 1, "dash": "dash"}, annotation_text=f"kept: {kept:g} m",
                     annotation_position="bottom right")
    figure.update_layout(showlegend=False)
    figure.update_yaxes(rangemode="tozero")
    return figure


def energy(data: RunData) -> go.Figure | None:
    """Per vehicle, summed over the plans that it flew: what they took (solid) and what was predicted when each was made
    (dashed)."""
    plans = predicted_plans(data)
    if not plans:
        return None
    figure = blank("Simulated time (min)", "Battery taken by plans (%)")
    for k in sorted({p["vehicle_id"] for p in plans}):
        mine = [p for p in plans if p["vehicle_id"] == k]
        t_min = [mine[0]["start_s"] / 60, *(p["end_s"] / 60 for p in mine)]
        for name, values, dash in ((f"UAV {k} used", [used_percent(p) for p in mine], "solid"),
                                   (f"UAV {k} predicted", [p["predicted_percent"] for p in mine], "dash")):
            figure.add_scatter(x=t_min, y=np.concatenate([[0.0], np.cumsum(values)]), mode="lines", name=name,
                               line={"color": colour(k), "width": 2, "dash": dash})
    return figure


def battery_curves(data: RunData) -> go.Figure | None:
    """Battery over time per vehicle, a dot per picture, a cross where views were handed over."""
    if not data.tracks:
        return None
    figure = blank("Simulated time (min)", "Battery (%)")
    at_view = data.flight.get("battery_at_view") or []
    for track in data.tracks:
        k = track.vehicle_id
        step = slice(None, None, max(1, len(track.t_s) // SHOWN_SAMPLES))
        figure.add_scatter(x=track.t_s[step] / 60, y=track.battery_percent[step], mode="lines", name=f"UAV {k}",
                           line={"color": colour(k), "width": 2}, legendgroup=str(k))
        dots = [v for v in at_view if v.get("vehicle_id") == k]
        figure.add_scatter(x=[v["t_s"] / 60 for v in dots], y=[v["battery_percent"] for v in dots], mode="markers",
                           marker={"color": colour(k), "size": 4}, legendgroup=str(k), showlegend=False,
                           text=[f"view {v['view_id']}" for v in dots], name=f"UAV {k} pictures")
    _mark_hand_overs(figure, data)
    threshold = data.mission.battery.threshold_percent
    figure.add_hline(y=threshold, line={"color": BAD, "width": 1, "dash": "dash"},
                     annotation_text=f"hand-over at {threshold:g} %", annotation_position="bottom left")
    figure.update_yaxes(range=[0, 104])
    return figure


def _mark_hand_overs(figure: go.Figure, data: RunData) -> None:
    """One cross per vehicle and moment, on its curve, telling how many views went where."""
    moments: dict[tuple[int, float], list[dict[str, Any]]] = {}
    for change in data.flight.get("reassignments") or []:
        moments.setdefault((change["from"], change["t_s"]), []).append(change)
    tracks = {t.vehicle_id: t for t in data.tracks if len(t.t_s)}
    marks = [(t, float(np.interp(t, tracks[k].t_s, tracks[k].battery_percent)), k, changes)
             for (k, t), changes in moments.items() if k in tracks]
    if marks:
        figure.add_scatter(x=[m[0] / 60 for m in marks], y=[m[1] for m in marks], mode="markers",
                           name="views handed over", marker={"symbol": "x", "size": 10, "color": BAD},
                           text=[f"{len(c)} views from UAV {k} to UAV {', '.join(sorted({str(v['to']) for v in c}))}"
                                 for _, _, k, c in marks])
