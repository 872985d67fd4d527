"""The page's interactive charts (plotly), each None when the run has nothing to show in it."""

from __future__ import annotations

from typing import Any

import numpy as np
import plotly.graph_objects as go

from ground_station.report.run_data import RunData
from perception.evaluate import accuracy
from perception.evaluate.comparison import Comparison
from perception.reconstruct.cloud import Cloud

VEHICLE_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#7F7F7F", "#882255")
INK, GRID, GOOD, BAD = "#1f2933", "#e4e7eb", "#2f855a", "#c53030"
SHOWN_POINTS = 30_000
START_CAMERA = {"eye": {"x": -0.55, "y": -1.05, "z": 0.5}, "center": {"x": 0.0, "y": 0.0, "z": -0.1}}
DECADES = {"tickvals": [0.0001, 0.001, 0.01, 0.1, 1.0], "ticktext": ["0.01%", "0.1%", "1%", "10%", "100%"]}
FONT = "system-ui, -apple-system, 'Segoe UI', Roboto, 'Helvetica Neue', Arial, sans-serif"


def colour(vehicle_id: int) -> str:
    """The vehicle's colour, the same in every chart."""
    return VEHICLE_COLOURS[(vehicle_id - 1) % len(VEHICLE_COLOURS)]


def blank(x: str, y: str) -> go.Figure:
    """A chart with nothing in it yet, its axes named."""
    figure = go.Figure()
    figure.update_layout(height=330, margin={"l": 58, "r": 16, "t": 16, "b": 48}, paper_bgcolor="white",
                         plot_bgcolor="white", font={"family": FONT, "size": 13, "color": INK},
                         legend={"orientation": "h", "y": 1.12}, hovermode="closest")
    figure.update_xaxes(title={"text": x, "font": {"size": 13}}, gridcolor=GRID, zerolinecolor=GRID)
    figure.update_yaxes(title={"text": y, "font": {"size": 13}}, gridcolor=GRID, zerolinecolor=GRID)
    return figure


def in_space() -> go.Figure:
    """A chart in 3-D with nothing in it yet; metres East, North and Up to one scale."""
    figure = go.Figure()
    axes = {name: {"title": {"text": text}, "gridcolor": GRID, "backgroundcolor": "white", "zerolinecolor": GRID}
            for name, text in (("xaxis", "East (m)"), ("yaxis", "North (m)"), ("zaxis", "Up (m)"))}
    figure.update_layout(height=620, margin={"l": 0, "r": 0, "t": 0, "b": 0}, font={"family": FONT, "color": INK},
                         legend={"orientation": "h", "y": 1.0, "itemsizing": "constant"},
                         scene={"aspectmode": "data", "camera": START_CAMERA, **axes})
    return figure


def coverage_curve(coverage: dict[str, Any], estimates: dict[int, float]) -> go.Figure | None:
    """True coverage after each exploration picture, with what any reachable views could have covered, and what the
    ground station believed, by view id."""
    values, ceiling = coverage.get("per_view") or [], coverage.get("ceiling")
    if not values:
        return None
    figure = blank("Exploration pictures", "Share of the surface seen")
    figure.add_scatter(x=list(range(1, len(values) + 1)), y=values, mode="lines", name="seen so far",
                       fill="tozeroy",
                       fillcolor="rgba(0,114,178,.08)", line={"color": VEHICLE_COLOURS[0], "width": 2.5})
    at = {view_id: n for n, view_id in enumerate(coverage.get("view_ids") or [], 1)}
    known = sorted((at[view_id], share) for view_id, share in estimates.items() if view_id in at)
    if known:
        figure.add_scatter(x=[n for n, _ in known], y=[share for _, share in known], mode="lines",
                           name="estimated without truth", line={"color": VEHICLE_COLOURS[1], "width": 1.5})
    if ceiling is not None:
        figure.add_hline(y=ceiling, line={"color": INK, "width": 1}, annotation_text=f"reachable {ceiling:.1%}",
                         annotation_position="bottom right")
        figure.add_hline(y=0.8 * ceiling, line={"color": GOOD, "width": 1, "dash": "dash"},
                         annotation_text="target: 80 % of it", annotation_position="bottom right")
    figure.update_layout(showlegend=bool(known), yaxis={"range": [0, 1.02], "tickformat": ".0%"})
    return figure


def tours(data: RunData, cloud: Cloud | None) -> go.Figure | None:
    """Flown paths in 3-D over the reconstructed cloud, with take-off points and where pictures were taken."""
    if not data.tracks and not data.views:
        return None
    figure = in_space()
    if cloud is not None and len(cloud):
        chosen = np.random.default_rng(0).permutation(len(cloud))[:SHOWN_POINTS]
        scatter_in_space(figure, cloud.points_enu_m[chosen], "reconstructed cloud", mode="markers", hoverinfo="skip",
                         marker={"size": 1.6, "color": [f"rgb({r},{g},{b})" for r, g, b in cloud.colours[chosen]]})
    for track in (t for t in data.tracks if len(t.t_s)):
        k = track.vehicle_id
        path = _simplified(track.position_enu_m)
        scatter_in_space(figure, path, f"UAV {k}", mode="lines", line={"color": colour(k), "width": 3},
                         legendgroup=str(k))
        scatter_in_space(figure, path[:1], f"UAV {k} take-off", mode="markers+text", text=[f"UAV {k}"],
                         marker={"size": 6, "symbol": "square", "color": colour(k)}, legendgroup=str(k),
                         showlegend=False)
    for phase, symbol, shown in (("survey", "circle", True), ("explore", "circle-open", "legendonly")):
        rows = [v for v in data.views if v.phase.startswith(phase)]
        if rows:
            scatter_in_space(figure, np.array([v.position_enu_m for v in rows]), f"{phase} pictures ({len(rows)})",
                             mode="markers", visible=shown,
                             marker={"size": 3.2, "symbol": symbol, "color": [colour(v.vehicle_id) for v in rows]},
                             text=[f"view {v.view_id}, UAV {v.vehicle_id}" for v in rows])
    return figure


def scatter_in_space(figure: go.Figure, points: Any, name: str, **style: Any) -> None:
    """Add points (n, 3) to a chart of `in_space`."""
    flat = np.round(np.asarray(points, dtype=np.float64), 2)
    figure.add_scatter3d(x=flat[:, 0].tolist(), y=flat[:, 1].tolist(), z=flat[:, 2].tolist(), name=name, **style)


def _simplified(path: Any) -> Any:
    """Every fifth sample (0.5 s) and the last: what the eye can see."""
    return path if len(path) < 3 else np.concatenate([path[:-1:5], path[-1:]])


def c2c_histogram(measured: Comparison) -> go.Figure:
    """Area of the true surface by distance to the nearest reconstructed point; farther than 1 m in the last bar."""
    edges = np.arange(0.0, 1.05, 0.05)
    counts, _ = np.histogram(np.minimum(measured.c2c_m, 0.999), edges)
    share = counts / max(1, counts.sum())
    colours = [GOOD if e < 0.2499 else "#dd9a2b" if e < 0.4999 else BAD for e in edges[:-1]]
    figure = blank("Distance from the true surface to the cloud (m)", "Share of the true surface (log)")
    figure.add_bar(x=edges[:-1] + 0.025, y=share, marker={"color": colours}, width=0.046,
                   textangle=0, cliponaxis=False,
                   text=[f"{v:.0%}" if v >= 0.005 else "" for v in share], textposition="outside")
    figure.update_layout(showlegend=False, yaxis={"type": "log", "range": [-4, 0.3], **DECADES})
    return figure


def c2m_histogram(measured: Comparison) -> go.Figure:
    """Points of the cloud by signed distance to the true mesh, in bins of 1 mm within +-10 cm."""
    counts, centres = accuracy.histogram(measured.uniform_c2m_m)
    shown = np.abs(centres) <= 0.1
    total = max(1, int(counts.sum()))
    colours = [GOOD if abs(c) <= accuracy.INLIER_M else "#b8c0cc" for c in centres[shown]]
    figure = blank("Signed distance from the true surface (mm)", "Share of the cloud per mm")
    figure.add_bar(x=1000 * centres[shown], y=counts[shown] / total, marker={"color": colours, "line": {"width": 0}})
    outside = 1.0 - float(counts[shown].sum()) / total
    figure.add_annotation(text=f"beyond ±10 cm: {outside:.2%}", xref="paper", yref="paper", x=0.99, y=0.97,
                          showarrow=False)
    figure.update_layout(showlegend=False, bargap=0, yaxis={"tickformat": ".1%"})
    return figure
