"""report.html: one self-contained page that explains a flight in a minute."""

from __future__ import annotations

from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
from plotly.offline import get_plotlyjs

from ground_station.report import charts, renderings, tables, time_charts
from ground_station.report.exploration import exploration_part
from ground_station.report.measure import Measured
from ground_station.report.pictures import thumbnail
from ground_station.report.run_data import RunData
from ground_station.report.sections import chart, chart_section, figure, pair, row, section
from ground_station.report.style import CSS, SCRIPT
from ground_station.report.survey import survey_part
from ground_station.report.thesis import NOTHING, REPORTED, Reported
from ground_station.report.thesis_page import thesis_part
from ground_station.report.tiles import ATTENTION, NEUTRAL, Tile, clock, key_numbers, percent
from perception.products.atlas import Textured
from perception.products.model_files import has_model, read_model
from perception.reconstruct.cloud import Cloud, read_cloud

SAMPLE_PICTURES = 6


@dataclass(frozen=True)
class Drawn:
    """What of the page needs neither model nor metrics, as HTML: it can be drawn while these are being made."""

    cloud: Cloud | None
    explored: str
    confidence: str
    errors: str
    missing: str
    quality: str


def draw(data: RunData, measured: Measured | None) -> Drawn:
    """All of it; empty where there is nothing to show."""
    cloud = read_cloud(data.run.cloud) if data.run.cloud.is_file() else None
    explored = exploration_part(data, data.referee.get("coverage") or {}) + survey_part(data) + thesis_part(data)
    if cloud is None:
        return Drawn(None, explored, "", "", "", "")
    spacing = data.mission.reconstruct.cloud_spacing_m
    confidence = row(renderings.by_confidence(*renderings.thinned(cloud, spacing),
                                              data.mission.reconstruct.min_confidence))
    if measured is None:
        return Drawn(cloud, explored, confidence, "", "", "")
    return Drawn(cloud, explored, confidence, row(renderings.by_error(measured.comparison)),
                 row(renderings.missing(measured.comparison, measured.reachable)),
                 row(renderings.by_quality(measured.comparison.reference, measured.inspection)))


def write_page(data: RunData, measured: Measured | None, metrics: dict[str, Any], drawn: Drawn) -> None:
    """Write report.html from whatever is known; sections with nothing to show are left out."""
    data.run.report.write_text(page(data, measured, metrics, drawn), encoding="utf-8")


def page(data: RunData, measured: Measured | None, metrics: dict[str, Any], drawn: Drawn) -> str:
    """The whole page as HTML."""
    thesis = REPORTED.get("" if data.mission.scene.path else data.mission.scene.name, NOTHING)
    cloud = drawn.cloud
    model = read_model(data.run.model) if cloud and has_model(data.run.model) else None
    body = "".join([_head(data, metrics), _model(data, cloud, model), _flight(data, metrics, cloud), drawn.explored,
                    _alignment(metrics), _measurements(measured, metrics, thesis),
                    _regions(data, model, measured, metrics, drawn),
                    _pictures(data), _machine(metrics), _notes(metrics)])
    return (f"<!doctype html><html lang=en><head><meta charset=utf-8><title>{escape(data.mission.title)}: flight report"
            f"</title><meta name=viewport content='width=device-width'><style>{CSS}</style>"
            f"<script>{get_plotlyjs()}</script></head><body><main>{body}</main><script>{SCRIPT}</script></body></html>")


def _head(data: RunData, metrics: dict[str, Any]) -> str:
    tiles = "".join(_tile(t) for t in key_numbers(data, metrics))
    scene = data.mission.scene
    origin = (f"scene {escape(Path(scene.path).name or scene.name)} · run {escape(data.run.root.name)} · "
              f"mission {escape(str(metrics['mission_hash']))} · "
              f"seed {metrics['seed']} · {data.mission.fleet.vehicles} vehicles")
    return (f"<header><h1>{escape(data.mission.title)}</h1><div class=soft>{origin}</div>"
            f"<p class=summary>{escape(summary(data, metrics))}</p></header><div class=tiles>{tiles}</div>")


def summary(data: RunData, metrics: dict[str, Any]) -> str:
    """The flight in three sentences."""
    explore = sum(v.phase == "explore" for v in data.views)
    survey = sum(v.phase == "survey" for v in data.views)
    vehicles, fleet = data.mission.fleet.vehicles, metrics["fleet"]
    text = f"{vehicles} vehicle{'s' if vehicles > 1 else ''} took {explore} exploration and {survey} survey pictures"
    if fleet["makespan_s"] is not None:
        text += f" in {clock(fleet['makespan_s'])} of simulated flight"
    swaps = metrics["service"]["swaps"]
    if swaps:
        text += f", {swaps} battery swap{'' if swaps == 1 else 's'} included"
    if metrics["collisions"] is not None:
        text += f", with {metrics['collisions'] or 'no'} collision{'' if metrics['collisions'] == 1 else 's'}"
    text += "."
    if fleet["views_reassigned"]:
        one = fleet["views_reassigned"] == 1
        text += f" {fleet['views_reassigned']} view{' was' if one else 's were'} handed over to another vehicle."
    complete, within = metrics["c2c"]["completeness"]["0.25"], metrics["c2m"]["within_2cm"]
    if complete is not None:
        text += (f" The cloud made from them covers {percent(complete)} of the true surface within 25 cm, "
                 f"and {percent(within)} of its points lie within 2 cm of it.")
    return text


def _tile(tile: Tile) -> str:
    mark = {NEUTRAL: "", ATTENTION: " <span class=mark>▲</span>"}.get(tile.state, " <span class=mark>✓</span>")
    return (f"<div class='tile {tile.state}'><div class=name>{escape(tile.name)}{mark}</div>"
            f"<div class=value>{escape(tile.value)}</div><div class=against>{escape(tile.against)}</div></div>")


def _model(data: RunData, cloud: Cloud | None, model: Textured | None) -> str:
    if cloud is None:
        return ""
    spacing = data.mission.reconstruct.cloud_spacing_m
    told = f"{len(cloud):,} points, one per {100 * spacing:g} cm voxel."
    if model is None:
        return section("The reconstruction", "", figure(told, renderings.hero(*renderings.thinned(cloud, spacing))))
    made = f"{len(model.surface):,} triangles with a texture made of the survey's pictures (model/); made of {told}"
    return section("The reconstruction", "", figure(made, renderings.hero_of_model(model)))


def _flight(data: RunData, metrics: dict[str, Any], cloud: Cloud | None) -> str:
    told = (data.flight.get("exploration") or {}).get("views") or []
    estimates = {v["view_id"]: v["coverage"] for v in told}
    coverage = charts.coverage_curve(data.referee.get("coverage") or {}, estimates)
    battery = time_charts.battery_curves(data)
    space = charts.tours(data, cloud)
    who = [tables.vehicles(data, metrics), tables.outcomes(data), tables.allocations(data)]
    return "".join([
        pair(chart_section("Exploration coverage", "How much of the true surface the exploration pictures have seen, "
                           "and how much of what can be seen the ground station believed covered.", coverage),
              chart_section("Battery", "A dot per picture; a cross where a vehicle handed its views over.", battery)),
        chart_section("Tours", "Paths and picture positions over the reconstructed cloud. Drag to turn, scroll to "
                      "zoom, click a name to hide or show it.", space),
        _over_time(data, metrics),
        section("Vehicles and views", "", "<h3></h3>".join(t for t in who if t)) if data.tracks or data.views else ""])


def _over_time(data: RunData, metrics: dict[str, Any]) -> str:
    predicted = time_charts.energy(data)
    return chart_section("Vehicles over time", "What every vehicle was doing.", time_charts.gantt(data)) + pair(
        chart_section("Distances between vehicles", "Between the nearest two of which at least one flies.",
                      time_charts.separation(data)),
        chart_section("Energy predicted and used", "Summed over the plans that were flown to their end.", predicted,
                      tables.energy(metrics)))


def _alignment(metrics: dict[str, Any]) -> str:
    if metrics["alignment"] is None:
        return ""
    return section("Alignment", "Measured poses after bundle adjustment. A picture that was not aligned kept its "
                   "measured pose. Errors are means over all pictures, against the true poses.",
                   tables.alignment(metrics["alignment"]))


def _measurements(measured: Measured | None, metrics: dict[str, Any], thesis: Reported) -> str:
    if measured is None:
        return ""
    left = section("Completeness (C2C)", "Distance from each sample of the true exposed surface to the nearest "
                   "reconstructed point. Green counts as reconstructed.",
                   chart(charts.c2c_histogram(measured.comparison)) + tables.completeness(metrics, thesis))
    spacing = 100 * metrics["c2m"]["resampled_m"]
    right = section("Accuracy (C2M)", f"Signed distance from each point of the cloud, resampled to {spacing:g} cm, to "
                    "the true mesh. Green is within ±2 cm.",
                    chart(charts.c2m_histogram(measured.comparison)) + tables.accuracy(metrics, thesis))
    return pair(left, right) + pair(
        section("By part", "Share of the surface, how much of it the cloud reaches within 0.25 m, and the error of the "
                "points nearest to it.", tables.parts(metrics)),
        section("Confidence and error", "Error of the points by the number of depth maps that agree on them; kept: the "
                "share with as many or more.", tables.confidence(metrics)))


def _regions(data: RunData, model: Textured | None, measured: Measured | None, metrics: dict[str, Any],
             drawn: Drawn) -> str:
    if drawn.cloud is None:
        return ""
    least = data.mission.reconstruct.min_confidence
    stops = ", ".join(f"rgb{c}" for c in renderings.CONFIDENCE_STOPS)
    scale = (f"{least}<span class=scale style='background:linear-gradient(90deg,{stops})'></span>"
             "10 or more depth maps agree")
    spacing = data.mission.reconstruct.cloud_spacing_m
    coloured = (renderings.in_colour(*renderings.thinned(drawn.cloud, spacing)) if model is None else
                renderings.model_in_colour(model))
    parts = [f"<h3>{'In colour' if model is None else 'Textured model'}</h3>", row(coloured),
             f"<h3>Confidence</h3><small>{scale}</small>", drawn.confidence]
    if measured is not None:
        parts += [f"<h3>Errors</h3><small>{_error_scale()}</small>", drawn.errors,
                  f"<h3>Missing</h3><small>{_missing_keys(measured, metrics)}</small>", drawn.missing,
                  f"<h3>Inspection quality</h3><small>{_inspection(metrics)}</small>", drawn.quality]
    return section("Where it is good, and what is missing", "Click a picture to enlarge it.", "".join(parts))


def _error_scale() -> str:
    stops = ", ".join(f"rgb{c}" for c in renderings.ERROR_STOPS)
    return (f"Points of the cloud by their distance to the true surface: 0<span class=scale "
            f"style='background:linear-gradient(90deg,{stops})'></span>{100 * renderings.WORST_M:g} cm or more; green "
            "is within 2 cm.")


def _missing_keys(measured: Measured, metrics: dict[str, Any]) -> str:
    colours = [(renderings.PRESENT_COLOUR, "reconstructed"), (renderings.PARTIAL_COLOUR, "25-50 cm away"),
               (renderings.MISSING_COLOUR, "more than 50 cm away")]
    told, reach = "True surface by distance to the cloud:", metrics["reachable"]
    if measured.reachable is not None:
        colours.append((renderings.BEYOND_COLOUR, "missing, and three pictures from within reach could not show it"))
        told = (f"{percent(reach['share'])} of the true surface could be in three pictures from within reach; "
                f"{percent(reach['completeness'])} of that is reconstructed. {told}")
    return told + " ".join(f"<span style='white-space:nowrap'><span class=key style='background:rgb{colour}'></span>"
                           f"{name}</span>" for colour, name in colours)


def _inspection(metrics: dict[str, Any]) -> str:
    found, stops = metrics["inspection"], ", ".join(f"rgb{c}" for c in renderings.CONFIDENCE_STOPS)
    return ("The true surface by its best picture (seen x blur x resolution): 0<span class=scale "
            f"style='background:linear-gradient(90deg,{stops})'></span>1. "
            f"{percent(found['at_gsd'])} of it is photographed at the resolution asked for, "
            f"{percent(found['seen_by_3'])} in three pictures or more.")


def _pictures(data: RunData) -> str:
    rows = [v for v in data.views if v.phase == "survey" and (data.run.root / v.path).is_file()]
    if not rows:
        return ""
    chosen = [rows[int(i)] for i in np.linspace(0, len(rows) - 1, min(SAMPLE_PICTURES, len(rows)))]
    figures = "".join(figure(f"View {v.view_id}, UAV {v.vehicle_id}, {v.t_capture_s:.0f} s",
                             thumbnail(data, v.path), "JPEG") for v in chosen)
    return section("Survey pictures", f"{len(chosen)} of {len(rows)}.", f"<div class=three>{figures}</div>")


def _machine(metrics: dict[str, Any]) -> str:
    if not metrics["timing_s"] and not metrics["peak_memory_mib"]:
        return ""
    told = "The cloud is measured (evaluate) while mesh and model are made of it (reconstruct); both count."
    return section("Time and memory on this machine", told, tables.resources(metrics))


def _notes(metrics: dict[str, Any]) -> str:
    items = "".join(f"<li>{escape(str(n))}</li>" for n in metrics["notes"])
    return section("Notes", "", f"<ul>{items}</ul>") if items else ""
