"""The page of `swarmscan bench lidar`: the thesis's Figs. 5.2 to 5.4 for a run of ours."""

from __future__ import annotations

import math
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import plotly.graph_objects as go
from plotly.offline import get_plotlyjs

from ground_station.report.charts import VEHICLE_COLOURS, blank
from ground_station.report.renderings import SIDES, WIDTH_PX
from ground_station.report.run_data import RunData
from ground_station.report.sections import chart_section, row, section
from ground_station.report.splat import ramp, splat
from ground_station.report.style import CSS, SCRIPT
from missions.frames import Array

if TYPE_CHECKING:
    from ground_station.bench.lidar import Sensed

BINS_M = np.arange(0.0, 1.025, 0.025)
SHOWN_POINTS, POINT_M = 400_000, 0.08
HEIGHTS = ((68, 1, 84), (59, 82, 139), (33, 145, 140), (94, 201, 98), (253, 231, 37))


def write_page(path: Path, data: RunData, samples_enu_m: Array, sensors: list[Sensed]) -> None:
    """One self-contained page."""
    lower, upper = samples_enu_m.min(axis=0) - 1.0, samples_enu_m.max(axis=0) + 1.0
    clouds = "".join(section(s.name.capitalize(), f"{s.curve[-1]:.1%} of the surface within 0.2 m; colour is height.",
                             _cloud(s, lower, upper)) for s in sensors)
    body = (f"<h1>{escape(data.mission.title)}: pictures and LiDAR from the same places</h1>"
            + chart_section("Coverage", "Share of the true exposed surface with a point within 0.2 m, pose by pose.",
                            _curves(sensors)) + clouds
            + chart_section("Distances", "From the true surface to the nearest point.", _distances(sensors)))
    path.write_text(f"<!doctype html><html lang=en><head><meta charset=utf-8><title>Pictures and LiDAR</title><style>"
                    f"{CSS}</style><script>{get_plotlyjs()}</script></head><body><main>{body}</main>"
                    f"<script>{SCRIPT}</script></body></html>", encoding="utf-8")


def _curves(sensors: list[Sensed]) -> go.Figure:
    figure = blank("Poses", "Share of the surface")
    for s, colour in zip(sensors, VEHICLE_COLOURS, strict=False):
        figure.add_scatter(x=list(range(1, len(s.curve) + 1)), y=s.curve.tolist(), name=s.name, mode="lines",
                           line={"color": colour, "width": 2.5})
    figure.update_layout(yaxis={"range": [0, 1.02], "tickformat": ".0%"})
    return figure


def _cloud(sensor: Sensed, lower: Array, upper: Array) -> str:
    points = np.concatenate(sensor.clouds)
    points = points[((points >= lower) & (points <= upper)).all(axis=1)]
    chosen = points[np.random.default_rng(0).permutation(len(points))[:SHOWN_POINTS]]
    colours = ramp(chosen[:, 2].astype(np.float64), float(lower[2]), float(upper[2]), HEIGHTS)
    return row([(s.name, splat(chosen, colours, math.radians(s.yaw_deg), math.radians(s.elevation_deg), WIDTH_PX,
                               POINT_M)) for s in SIDES])


def _distances(sensors: list[Sensed]) -> go.Figure:
    figure = blank("Distance to the nearest point (m)", "Share of the surface")
    for s, colour in zip(sensors, VEHICLE_COLOURS, strict=False):
        counts, _ = np.histogram(np.minimum(s.distance_m, BINS_M[-1] - 1e-6), BINS_M)
        figure.add_bar(x=BINS_M[:-1] + 0.0125, y=counts / max(1, counts.sum()), name=s.name,
                       marker={"color": colour})
    figure.update_layout(yaxis={"tickformat": ".0%"}, barmode="group")
    return figure
