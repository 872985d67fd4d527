"""The page's tables, as HTML."""

from __future__ import annotations

from collections import Counter
from html import escape
from typing import Any

from ground_station.report.run_data import RunData
from ground_station.report.thesis import Reported
from ground_station.report.tiles import clock, millimetres, number, percent

SHOWN_PARTS = 12


def table(head: list[str], rows: list[list[str]], numeric_from: int = 1) -> str:
    """Rows of finished cells; columns from numeric_from on are set right."""
    def line(cells: list[str], tag: str) -> str:
        return "<tr>" + "".join(f'<{tag}{" class=n" if i >= numeric_from else ""}>{c}</{tag}>'
                                for i, c in enumerate(cells)) + "</tr>"
    return f"<table><thead>{line(head, 'th')}</thead><tbody>{''.join(line(r, 'td') for r in rows)}</tbody></table>"


def completeness(metrics: dict[str, Any], thesis: Reported) -> str:
    """C2C by threshold beside the thesis."""
    rows = [[f"within {t} m", percent(v), percent(thesis.c2c_025) if t == "0.25" else ""]
            for t, v in metrics["c2c"]["completeness"].items()]
    return table(["True surface reconstructed", "this run", "thesis"], rows)


def accuracy(metrics: dict[str, Any], thesis: Reported) -> str:
    """C2M in the thesis's bins, without bins, and trimmed."""
    c2m = metrics["c2m"]
    variants = [("Eqs. 4.10-4.12, all points, 1 mm bins", c2m), ("the same without bins", c2m["exact"]),
                ("every point of the cloud as it is, in bins", c2m["as_it_is"]["binned"]),
                ("the same without bins", c2m["as_it_is"]),
                (f"trimmed at 5 cm ({percent(c2m['trimmed_5cm']['share_kept'])} kept)", c2m["trimmed_5cm"])]
    rows = [[name, millimetres(v["mean_m"]), millimetres(v["rms_m"]), percent(v["within_2cm"])] for name, v in variants]
    rows.append(["thesis", millimetres(thesis.mean_m), millimetres(thesis.rms_m), percent(thesis.within_2cm)])
    return table(["Cloud against true mesh", "mean", "RMS", "within ±2 cm"], rows)


def parts(metrics: dict[str, Any]) -> str:
    """Completeness and error by part of the object, largest first."""
    rows = [[escape(p["part"]), percent(p["share"]), percent(p["completeness"]), millimetres(p["mean_m"]),
             millimetres(p["rms_m"]), percent(p["within_2cm"])] for p in metrics["parts"][:SHOWN_PARTS]]
    return table(["Part", "surface", "≤ 0.25 m", "C2M mean", "RMS", "±2 cm"], rows)


def confidence(metrics: dict[str, Any]) -> str:
    """Error by the number of agreeing depth maps."""
    rows = [[str(c["confidence"]), percent(c["kept"]), millimetres(c["median_m"]), millimetres(c["mean_m"]),
             percent(c["within_2cm"])] for c in metrics["confidence"]]
    return table(["Depth maps", "kept", "median", "mean", "±2 cm"], rows)


def alignment(found: dict[str, Any]) -> str:
    """What bundle adjustment did to the measured poses, beside the truth, and which pictures it left."""
    rows = [["pictures aligned", f"{found['registered']} of {found['pictures']}"],
            ["groups that share points", ", ".join(map(str, found["groups"])) or "none"],
            ["reprojection error", number(found["reprojection_px"], "{:.2f} px")],
            ["moved by, mean (largest)", f"{millimetres(found['moved_mean_m'])} ({millimetres(found['moved_max_m'])})"],
            ["turned by, mean (largest)", f"{found['turned_mean_deg']:.2f}° ({found['turned_max_deg']:.2f}°)"]]
    before, after = found["error_measured"], found["error_aligned"]
    if after["position_mean_m"] is not None:
        rows += [["position error, measured → aligned",
                  f"{millimetres(before['position_mean_m'])} → {millimetres(after['position_mean_m'])}"],
                 ["attitude error, measured → aligned",
                  f"{before['attitude_mean_deg']:.3f}° → {after['attitude_mean_deg']:.3f}°"]]
    rows += [[f"view {view_id}", escape(why)] for view_id, why in found["kept"].items()]
    return table(["Camera poses", "all pictures"], rows)


def vehicles(data: RunData, metrics: dict[str, Any]) -> str:
    """Who flew what."""
    changes = data.flight.get("reassignments") or []
    fleet = metrics["fleet"]
    ids = sorted({t.vehicle_id for t in data.tracks} | {v.vehicle_id for v in data.views})
    rows = []
    for k in ids:
        phases = Counter(v.phase for v in data.views if v.vehicle_id == k)
        rows.append([f"UAV {k}", str(phases["explore"]), str(phases["survey"]),
                     str(sum(c["from"] == k for c in changes)), str(sum(c["to"] == k for c in changes)),
                     _serviced(metrics["service"]["vehicles"].get(str(k))),
                     number((fleet["path_m"] or {}).get(str(k)), "{:,.0f} m"),
                     number((fleet["battery_end_percent"] or {}).get(str(k)), "{:.1f} %")])
    return table(["Vehicle", "exploration pictures", "survey pictures", "views handed over", "views taken over",
                  "battery swaps", "path", "battery at the end"], rows)


def _serviced(told: dict[str, Any] | None) -> str:
    if told is None:
        return ""
    return f"{told['swaps']} in {clock(told['service_s'])}" if told["swaps"] else "0"


def energy(metrics: dict[str, Any]) -> str:
    """Predicted and used by vehicle."""
    rows = [[f"UAV {k}", str(e["plans"]), f"{e['predicted_percent']:.1f} %", f"{e['used_percent']:.1f} %",
             f"{100 * e['error']:+.1f} %"] for k, e in metrics["energy"].items()]
    return table(["Vehicle", "plans", "predicted", "used", "error"], rows)


def outcomes(data: RunData) -> str:
    """How many survey views ended how, and which ones were not flown for what reason."""
    found, details = data.flight.get("outcomes") or {}, data.flight.get("outcome_details") or {}
    groups: dict[tuple[str, str], list[int]] = {}
    for view_id, outcome in found.items():
        groups.setdefault((outcome, details.get(view_id, "")), []).append(int(view_id))
    rows = [[escape(outcome), escape(detail), str(len(ids)), "" if outcome == "flown" else _listed(sorted(ids))]
            for (outcome, detail), ids in sorted(groups.items(), key=lambda item: -len(item[1]))]
    return table(["Outcome of survey views", "why", "views", "view ids"], rows, numeric_from=2) if rows else ""


def allocations(data: RunData) -> str:
    """When tours were made, why, and how long that took."""
    rows = [[f"{a['t_s']:.0f} s", escape(a["why"]), str(a["open_views"]), f"{a['wall_s']:.2f} s"]
            for a in data.flight.get("allocations") or []]
    return table(["Tours made", "because of", "open views", "computed in"], rows, numeric_from=2) if rows else ""


def _listed(ids: list[int]) -> str:
    return ", ".join(map(str, ids[:30])) + (" ..." if len(ids) > 30 else "")


def resources(metrics: dict[str, Any]) -> str:
    """Seconds by phase and memory by process, with bars."""
    return (_bars("Phase", "wall time", metrics["timing_s"], clock) + "<h3></h3>"
            + _bars("Process", "peak memory", metrics["peak_memory_mib"], lambda v: number(v, "{:,.0f} MiB")))


def _bars(what: str, measure: str, values: dict[str, float | None], form: Any) -> str:
    most = max((v for v in values.values() if v), default=1.0)
    rows = [[escape(name), f'<span class=bar style="width:{180 * (v or 0) / most:.0f}px"></span>', form(v)]
            for name, v in values.items()]
    known = [v for v in values.values() if v is not None]
    return table([what, "", measure], [*rows, ["<b>all</b>", "", f"<b>{form(sum(known))}</b>"]], numeric_from=2)
