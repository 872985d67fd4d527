"""The page's part on exploration: the map, what the chosen views promised and brought, depth beside true depth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import plotly.graph_objects as go
import trimesh

from ground_station.report.charts import INK, VEHICLE_COLOURS, blank, colour, in_space, scatter_in_space
from ground_station.report.pictures import thumbnail
from ground_station.report.run_data import RunData, ViewRow
from ground_station.report.sections import chart_section, row, section
from ground_station.report.splat import Pixels, ramp
from ground_station.report.tiles import percent
from missions.frames import Array
from perception.evaluate.true_depth import depths_of_mesh

SHOWN_VOXELS = 9_000
ARROW_M = 2.5
DEPTH_STOPS = ((255, 244, 200), (244, 165, 80), (190, 50, 90), (70, 20, 110), (15, 10, 50))
NO_DEPTH = 205
WITHIN = 0.05


@dataclass(frozen=True)
class Brought:
    """One chosen view. Gains are shares, 0-1, of the surface that can be seen."""

    view: ViewRow
    predicted: float
    achieved: float
    true: float | None


def exploration_part(data: RunData, coverage: dict[str, Any]) -> str:
    """All sections; those with nothing to show are left out."""
    views = brought(data, coverage)
    return "".join([
        chart_section("The explored map", "Known surface, and the views that were chosen (an arrow each, along the "
                      "line of sight). Drag to turn, scroll to zoom.", explored_map(data, views)),
        chart_section("What each view promised and brought", _told(data, views, coverage), gains(views)),
        depth_section(data)])


def brought(data: RunData, coverage: dict[str, Any]) -> list[Brought]:
    """Chosen views in the order of arrival; what they promised and brought by the map, and by the truth where known."""
    told = data.flight.get("exploration") or {}
    whole_m2 = (told.get("seen_m2") or 0.0) + (told.get("missing_m2") or 0.0)
    rows = {v.view_id: v for v in data.views if v.phase == "explore"}
    increase, ceiling = _true_increase(coverage), coverage.get("ceiling") or 1.0
    found = []
    for v in told.get("views") or []:
        if v["view_id"] in rows and whole_m2 > 0.0:
            leg = range(v["view_id"] - v["pictures"] + 1, v["view_id"] + 1)
            true = sum(increase.get(i, 0.0) for i in leg) / ceiling if increase else None
            found.append(Brought(rows[v["view_id"]], v["predicted_m2"] / whole_m2, v["achieved_m2"] / whole_m2, true))
    return found


def _true_increase(coverage: dict[str, Any]) -> dict[int, float]:
    """By view id, what each exploration picture added to the true coverage."""
    per_view, ids = coverage.get("per_view") or [], coverage.get("view_ids") or []
    return dict(zip(ids, np.diff(per_view, prepend=0.0).tolist(), strict=False))


def _told(data: RunData, views: list[Brought], coverage: dict[str, Any]) -> str:
    """Sums, and how exploration ended."""
    told = data.flight.get("exploration") or {}
    text = (f"Shares of the surface that can be seen. {len(views)} views promised "
            f"{percent(sum(v.predicted for v in views))} and brought {percent(sum(v.achieved for v in views))}.")
    if told.get("coverage") is not None:
        text += f" At the end the ground station believed {percent(told['coverage'])} of it covered"
        final, ceiling = coverage.get("final"), coverage.get("ceiling")
        text += f"; {percent(final / ceiling)} was." if final is not None and ceiling else "."
    return text + (f" Exploration ended because {told['ended']}." if told.get("ended") else "")


def gains(views: list[Brought]) -> go.Figure | None:
    """Per chosen view: promised (line), brought by the map (bars), truly brought (dots)."""
    if not views:
        return None
    figure, x = blank("Chosen views in the order of arrival", "Share of the surface"), list(range(1, len(views) + 1))
    names = [f"view {b.view.view_id}, UAV {b.view.vehicle_id}" for b in views]
    figure.add_bar(x=x, y=[round(b.achieved, 5) for b in views], name="brought, by the map", text=names,
                   textposition="none", hovertemplate="%{text}: %{y:.2%}",
                   marker={"color": [colour(b.view.vehicle_id) for b in views], "opacity": 0.45})
    figure.add_scatter(x=x, y=[round(b.predicted, 5) for b in views], name="promised", mode="lines",
                       line={"color": INK, "width": 1.5, "shape": "hvh"}, hovertemplate="promised %{y:.2%}")
    if all(b.true is not None for b in views):
        figure.add_scatter(x=x, y=[round(b.true or 0.0, 5) for b in views], name="truly brought", mode="markers",
                           marker={"color": VEHICLE_COLOURS[2], "size": 6}, hovertemplate="truly %{y:.2%}")
    figure.update_layout(yaxis={"tickformat": ".1%"}, bargap=0.15)
    return figure


def explored_map(data: RunData, views: list[Brought]) -> go.Figure | None:
    """Known surface in 3-D with the chosen views."""
    if not data.run.map.is_file():
        return None
    with np.load(data.run.map) as stored:
        surface = stored["surface_position_enu_m"]
    figure = in_space()
    shown = surface[np.random.default_rng(0).permutation(len(surface))[:SHOWN_VOXELS]]
    if len(shown):
        up = shown[:, 2]
        shades = ramp(up, float(up.min()), float(up.max()) + 1e-6, ((70, 84, 100), (196, 204, 212)))
        scatter_in_space(figure, shown, f"known surface ({len(surface):,} voxels)", mode="markers", hoverinfo="skip",
                         marker={"size": 2.4, "color": [f"rgb({r},{g},{b})" for r, g, b in shades]})
    for k in sorted({b.view.vehicle_id for b in views}):
        mine = [b for b in views if b.view.vehicle_id == k]
        scatter_in_space(figure, _arrows(mine), f"views of UAV {k} ({len(mine)})", mode="lines", hoverinfo="skip",
                         line={"color": colour(k), "width": 3}, legendgroup=str(k))
        scatter_in_space(figure, np.array([b.view.position_enu_m for b in mine]), f"UAV {k}", mode="markers",
                         showlegend=False, legendgroup=str(k), hoverinfo="text", text=[_hover(b) for b in mine],
                         marker={"color": colour(k), "size": [3.0 + 40.0 * max(b.achieved, 0.0) ** 0.5 for b in mine],
                                 "opacity": 0.7, "line": {"width": 0}})
    return figure


def _arrows(views: list[Brought]) -> Array:
    """(3 n, 3) pairs of points with gaps between them."""
    starts = np.array([b.view.position_enu_m for b in views])
    ends = starts + ARROW_M * np.array([b.view.enu_from_camera[:, 2] for b in views])
    return np.stack([starts, ends, np.full_like(starts, np.nan)], axis=1).reshape(-1, 3)


def _hover(b: Brought) -> str:
    true = "" if b.true is None else f", truly {b.true:.2%}"
    return (f"view {b.view.view_id}, {b.view.t_capture_s:.0f} s: promised {b.predicted:.2%}, brought "
            f"{b.achieved:.2%}{true}")


def depth_section(data: RunData) -> str:
    """A few exploration pictures with their depth, and true depth where the truth is known."""
    if not data.run.explore_depth.is_file():
        return ""
    with np.load(data.run.explore_depth) as stored:
        ids, depths = stored["view_id"].tolist(), stored["depth_m"].astype(np.float64)
    rows = {v.view_id: v for v in data.views if v.phase == "explore"}
    views = [rows[i] for i in ids if i in rows]
    truths = _true_depths(data, views, depths.shape[1:])
    reach, parts = data.mission.explore.sensing_range_m, []
    for k, view in enumerate(views):
        found = depths[ids.index(view.view_id)]
        pictures = [(f"View {view.view_id}, UAV {view.vehicle_id}", thumbnail(data, view.path, found.shape[1])),
                    (f"Estimated depth{_agreement(found, truths[k], reach) if truths else ''}", _shown(found, reach))]
        parts.append(row([*pictures, ("True depth of the object", _shown(truths[k], reach))] if truths else pictures,
                         "JPEG"))
    return section("Depth of exploration pictures", f"From 0 m (light) to {reach:g} m (dark); grey where there is none "
                   "that is trusted.", "".join(parts)) if parts else ""


def _true_depths(data: RunData, views: list[ViewRow], shape: tuple[int, ...]) -> list[Array]:
    if not data.run.truth_mesh.is_file() or not views:
        return []
    mesh = trimesh.load_mesh(data.run.truth_mesh, process=False)
    camera = data.mission.camera.explore_camera().scaled(shape[1], shape[0])
    return depths_of_mesh(mesh.vertices, mesh.faces, camera, [v.position_enu_m for v in views],
                          [v.enu_from_camera for v in views])


def _agreement(found: Array, true: Array, reach_m: float) -> str:
    """How much of the object within reach has a depth, and how much of that is right."""
    near = true <= reach_m
    answered = near & np.isfinite(found)
    if not answered.any():
        return ""
    error = np.abs(found[answered] - true[answered]) / true[answered]
    return (f": {percent(float(answered.sum() / near.sum()))} of the object answered, "
            f"{percent(float((error <= WITHIN).mean()))} of that within {WITHIN:.0%}")


def _shown(depth_m: Array, reach_m: float) -> Pixels:
    """(h, w, 3) colours by depth."""
    picture = np.full((*depth_m.shape, 3), NO_DEPTH, dtype=np.uint8)
    known = np.isfinite(depth_m) & (depth_m <= reach_m)
    picture[known] = ramp(depth_m[known], 0.0, reach_m, DEPTH_STOPS)
    return picture
