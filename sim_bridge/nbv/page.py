"""Coverage curves of all runs as one self-contained HTML page."""

from __future__ import annotations

from collections.abc import Callable
from html import escape
from itertools import cycle
from pathlib import Path

import numpy as np
import plotly.graph_objects as go
from plotly.offline import get_plotlyjs

from missions.errors import UserError
from missions.frames import Array
from sim_bridge.nbv.campaign import Row

COLORS = ((0, 114, 178), (213, 94, 0), (0, 158, 115), (204, 121, 167), (230, 159, 0), (86, 180, 233), (0, 0, 0),
          (122, 81, 149))
SAMPLES = 200
STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; color: #1f2933; max-width: 1180px; margin: 0 auto; padding: 24px; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; }
th, td { padding: 3px 14px 3px 0; text-align: right; }
th:first-child, td:first-child { text-align: left; } th { color: #616e7c; font-weight: 600; }
.plots { display: grid; grid-template-columns: repeat(3, 1fr); gap: 8px; }
@media (max-width: 860px) { .plots { grid-template-columns: 1fr; } }"""

Groups = dict[tuple[str, int], dict[str, list[Row]]]
Along = Callable[[Row], list[float]]

AXES: tuple[tuple[str, Along], ...] = (
    ("key poses", lambda row: [float(k) for k in range(len(row.curve_seconds))]),
    ("metres flown", lambda row: row.curve_metres),
    ("seconds of flight", lambda row: row.curve_seconds),
)


def grouped(rows: list[Row]) -> Groups:
    """(scene, vehicles) -> method -> rows, in the order of the rows."""
    groups: Groups = {}
    for row in rows:
        groups.setdefault((row.scene, row.vehicles), {}).setdefault(row.method, []).append(row)
    return groups


def write_page(path: Path, rows: list[Row]) -> None:
    """Curves and numbers by scene and fleet size. Raises UserError where the page cannot be written."""
    sections = "".join(_section(scene, vehicles, methods) for (scene, vehicles), methods in grouped(rows).items())
    text = (f"<!doctype html><html lang=en><head><meta charset=utf-8><title>Next best views</title>"
            f"<style>{STYLE}</style><script>{get_plotlyjs()}</script></head><body><h1>Next best views</h1>"
            f"<p>Share of the object's exposed surface that the visited views truly see. Lines are means over the "
            f"starts, bands one standard deviation, dashes the ceiling: what all collision-free views see together.</p>"
            f"{sections}</body></html>")
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as e:
        raise UserError(f"--html {path}: the page cannot be written ({e.strerror}); name a file in a folder that "
                        "exists.") from e


def _section(scene: str, vehicles: int, methods: dict[str, list[Row]]) -> str:
    plots = "".join(_plot(title, along, methods) for title, along in AXES)
    title = f"{scene}, {vehicles} vehicle{'s' if vehicles > 1 else ''}"
    return f"<h2>{escape(title)}</h2>{_numbers(methods)}<div class=plots>{plots}</div>"


def _numbers(methods: dict[str, list[Row]]) -> str:
    lines = []
    for method, rows in methods.items():
        auc, final = ([getattr(row, name) for row in rows] for name in ("auc", "final"))
        cells = (method, len(rows), f"{np.mean(auc):.3f} ± {np.std(auc):.3f}",
                 f"{np.mean(final):.3f} ± {np.std(final):.3f}", f"{rows[0].ceiling:.3f}",
                 sum(row.collisions for row in rows), f"{np.mean([row.metres for row in rows]):.0f}",
                 f"{np.mean([row.seconds_per_decision for row in rows]):.3f}")
        lines.append("<tr>" + "".join(f"<td>{escape(str(cell))}</td>" for cell in cells) + "</tr>")
    head = "".join(f"<th>{name}</th>" for name in ("method", "runs", "AUC", "final", "ceiling", "collisions", "metres",
                                                   "s per decision"))
    return f"<table><tr>{head}</tr>{''.join(lines)}</table>"


def _plot(title: str, along: Along, methods: dict[str, list[Row]]) -> str:
    figure = go.Figure()
    for (method, rows), color in zip(methods.items(), cycle(COLORS), strict=False):
        at, mean, deviation = _mean_curve(rows, along)
        band = np.concatenate([mean + deviation, (mean - deviation)[::-1]])
        figure.add_scatter(x=np.concatenate([at, at[::-1]]), y=band, fill="toself", fillcolor=f"rgba{(*color, 0.15)}",
                           line_width=0, hoverinfo="skip", showlegend=False, legendgroup=method)
        figure.add_scatter(x=at, y=mean, name=method, line_color=f"rgb{color}", legendgroup=method)
    ceiling = next(iter(methods.values()))[0].ceiling
    figure.add_hline(y=ceiling, line_dash="dash", line_color="#616e7c")
    figure.update_layout(height=360, margin={"l": 40, "r": 8, "t": 8, "b": 40}, template="plotly_white",
                         xaxis_title=title, yaxis_range=[0, 1], legend={"orientation": "h", "y": -0.2})
    return f"<div>{figure.to_html(full_html=False, include_plotlyjs=False)}</div>"


def _mean_curve(rows: list[Row], along: Along) -> tuple[Array, Array, Array]:
    """Where (n,), mean and deviation (n,) of the coverage over the runs; each run keeps its last value."""
    ways = [along(row) for row in rows]
    at = np.linspace(0.0, max(way[-1] for way in ways), SAMPLES)
    curves = np.array([np.interp(at, way, row.curve[:len(way)]) for way, row in zip(ways, rows, strict=True)])
    return at, curves.mean(axis=0), curves.std(axis=0)
