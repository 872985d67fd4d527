"""The page of `swarmscan bench depth`: how good depth is, what its errors come from, and the pictures it fails on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from html import escape
from operator import add
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ground_station.bench.depth_causes import BEFORE, BEHIND, GHOST, OPEN, PLACES, SILENT, VERDICTS, Causes, Marks
from ground_station.bench.depth_scores import SHARES, Mask, Pixels, Row, full_size, reliability, sparsification
from ground_station.report.splat import data_uri, ramp
from ground_station.report.style import CSS, SCRIPT
from missions.frames import Array
from perception.depth.depth_map import DepthMap

WORST = 3
"""Pictures shown per scene."""
LEAST_PART = 0.02
"""Causes that make less of the error than this share are not listed."""
NEAR_M, FAR_M = 2.0, 25.0
TURBO = ((48, 18, 59), (70, 107, 227), (40, 187, 236), (49, 242, 153), (162, 252, 60), (237, 208, 58), (251, 128, 34),
         (210, 49, 5), (122, 4, 3))
HEAT = ((20, 20, 60), (60, 120, 200), (250, 230, 120), (230, 60, 30))
WRONG = (BEHIND, OPEN, BEFORE, GHOST)
COLUMNS = {"scene": "scene", "pictures": "pictures", "answered": "answered", "abs_rel": "abs rel",
           "delta_1_25": "δ<1.25", "complete": "found", "complete_thin": "thin found", "abs_rel_all": "abs rel, all",
           "delta_1_25_all": "δ<1.25, all", "median_all": "median, all", "called_open": "called open",
           "ghosts": "ghosts", "ause": "AUSE", "oracle": "oracle", "calibration": "ECE", "cpu_seconds": "CPU s"}
WATER = {"water": "water", "answered_water": "water answered", "abs_rel_water": "water abs rel",
         "false_water": "water false"}
"""Columns where there is any."""
EXPLAINED = (
    "Counted are pixels whose true surface lies within the sensing range. Answered: the share of them that the method "
    "trusts; abs rel and δ judge those, columns with “all” its best guess on every one. Found: answered to 10 %; thin: "
    "on members narrower than 5 pixels. Called open: counted pixels that the map may carve through. Ghosts: share of "
    "the answers in range with nothing there. AUSE: area under the sparsification error, beside the oracle’s curve; "
    "ECE: error of the confidence as the chance of an error below 5 %. Water: share of the counted pixels; false: "
    "share of all pixels of water that are claimed as surface elsewhere in range.")


@dataclass(frozen=True)
class Shown:
    """One picture with what is true, what was found, and what became of every pixel."""

    scene: str
    number: int
    rgb: NDArray[np.uint8]
    true_m: NDArray[np.float32]
    ours: DepthMap
    verdict: Marks
    causes: Causes

    def badness(self) -> float:
        """Share of the picture that is wrong by more than a factor of 1.25."""
        return float(np.isin(self.verdict, WRONG).mean())


def write_page(path: Path, rows: Sequence[Row], pixels: Pixels, scenes: Sequence[Sequence[Shown]]) -> None:
    """One self-contained page."""
    worst = [s for pictures in scenes for s in sorted(pictures, key=Shown.badness, reverse=True)[:WORST]]
    body = "".join([_numbers(rows), _causes(scenes), _curves(pixels), _legend(), *(_pictures(s) for s in worst)])
    path.write_text(f"<!doctype html><html lang=en><head><meta charset=utf-8><title>Depth beside truth</title>"
                    f"<style>{CSS}main{{max-width:1400px}}.five{{display:grid;grid-template-columns:repeat(5,1fr);"
                    "gap:6px}.legend span{display:inline-block;margin-right:14px}.dense,.dense th{font-size:11px}"
                    ".dense th{white-space:normal}</style></head><body><main>"
                    f"<h1>Depth beside truth</h1>{body}</main><script>{SCRIPT}</script></body></html>",
                    encoding="utf-8")


def _numbers(rows: Sequence[Row]) -> str:
    columns = COLUMNS | (WATER if any(row.water for row in rows) else {})
    head = "".join(f"<th class=n>{escape(c)}</th>" for c in columns.values())
    lines = ["".join(f"<td class=n>{_cell(getattr(row, c))}</td>" for c in columns) for row in rows]
    cells = "".join(f"<tr>{line}</tr>" for line in lines)
    return (f"<section style='overflow-x:auto'><h2>How good</h2><p class=soft style='max-width:none'>{EXPLAINED}</p>"
            f"<table class=dense><tr>{head}</tr>{cells}</table></section>")


def _cell(value: str | float) -> str:
    return f"{value:.3f}" if isinstance(value, float) else escape(str(value).removeprefix("family:"))


def _causes(scenes: Sequence[Sequence[Shown]]) -> str:
    """What makes the mean error of the answered pixels, largest cause first."""
    named = {p[0].scene: reduce(add, (s.causes for s in p)) for p in scenes if p}
    whole = reduce(add, named.values())
    answered, total = max(int(whole.pixels.sum()), 1), max(float(whole.error.sum()), 1e-9)
    lines = []
    for at in np.argsort(-whole.error, axis=None):
        verdict, place = divmod(int(at), len(PLACES))
        part = whole.error[verdict, place] / total
        if part < LEAST_PART:
            break
        worst = max(named, key=lambda name: float(named[name].error[verdict, place]))
        share = named[worst].error[verdict, place] / max(float(whole.error[verdict, place]), 1e-9)
        lines.append(f"<tr><td>{_key(verdict)}{escape(VERDICTS[verdict][0])}</td><td>{escape(PLACES[place])}</td>"
                     f"<td class=n>{100 * whole.pixels[verdict, place] / answered:.2f} %</td><td class=n>"
                     f"{whole.error[verdict, place] / answered:.4f}</td><td><span class=bar style='width:"
                     f"{160 * part:.0f}px'></span> {100 * part:.0f} %</td><td>{100 * share:.0f} % of it in "
                     f"{escape(worst.removeprefix('family:'))}</td></tr>")
    head = ("<tr><th>what is wrong</th><th>where</th><th class=n>of the answers</th><th class=n>adds to abs rel</th>"
            "<th>part of all error</th><th>mostly in</th></tr>")
    return (f"<section><h2>What the errors come from</h2><p class=soft>Answered pixels in range, all scenes together; "
            f"abs rel {total / answered:.4f}.</p><table>{head}{''.join(lines)}</table></section>")


def _curves(pixels: Pixels) -> str:
    ours, best = sparsification(pixels.error, -pixels.confidence), sparsification(pixels.error, pixels.error)
    said, right, share = reliability(pixels)
    some = share > 0
    left = _plot([(SHARES, ours, "#0072B2", "confidence"), (SHARES, best, "#D55E00", "oracle")], float(ours.max()))
    reliable = _plot([(said[some], right[some], "#0072B2", "right, by confidence"),
                      (np.array([0.0, 1.0]), np.array([0.0, 1.0]), "#9aa5b1", "calibrated")], 1.0)
    return ("<div class=two><section><h2>Sparsification</h2><p class=soft>Mean relative error of what is left, against "
            f"the share left out.</p>{left}</section><section><h2>Calibration</h2><p class=soft>Share of pixels within "
            f"5 % of the truth, against confidence.</p>{reliable}</section></div>")


def _plot(lines: Sequence[tuple[Array, Array, str, str]], top: float) -> str:
    parts = []
    for i, (x, y, color, name) in enumerate(lines):
        points = " ".join(f"{40 + 400 * a:.1f},{210 - 190 * b / max(top, 1e-9):.1f}" for a, b in zip(x, y, strict=True))
        parts.append(f"<polyline points='{points}' fill=none stroke='{color}' stroke-width=2 />"
                     f"<text x=430 y={20 + 16 * i} text-anchor=end fill='{color}' font-size=12>{escape(name)}</text>")
    axes = ("<path d='M40 15V210H445' fill=none stroke='#9aa5b1'/><text x=36 y=22 text-anchor=end font-size=11>"
            f"{top:.2f}</text><text x=36 y=213 text-anchor=end font-size=11>0</text><text x=440 y=226 text-anchor=end "
            "font-size=11>1</text>")
    return f"<svg viewBox='0 0 460 232' width='100%'>{axes}{''.join(parts)}</svg>"


def _legend() -> str:
    keys = "".join(f"<span>{_key(i)}{escape(name)}</span>" for i, (name, _) in enumerate(VERDICTS))
    return ("<section><h2>Where it fails</h2><p class=soft>The worst pictures of each scene. Depth from red (2 m) to "
            f"violet (25 m and more). Verdicts:</p><p class=legend style='max-width:none'>{keys}</p></section>")


def _key(verdict: int) -> str:
    return f"<span class=key style='background:rgb{VERDICTS[verdict][1]};margin-left:0'></span>"


def _pictures(s: Shown) -> str:
    shape = s.true_m.shape
    valid = full_size(s.ours.valid, shape)
    colors = np.array([color for _, color in VERDICTS], np.uint8)
    panels = {"picture": s.rgb, "true depth": _depth_colors(s.true_m, np.isfinite(s.true_m)),
              "ours (grey: no answer)": _depth_colors(full_size(s.ours.depth_m, shape), valid),
              "verdict": colors[s.verdict],
              "confidence (dark: sure)": _colors(full_size(s.ours.confidence, shape), 0.0, 1.0, HEAT[::-1],
                                                 s.true_m > 0.0)}
    figures = "".join(f"<figure><img src='{data_uri(image, 'JPEG')}'><figcaption>{name}</figcaption></figure>"
                      for name, image in panels.items())
    return (f"<section><h2>{escape(s.scene)}, picture {s.number}</h2><p class=soft style='max-width:none'>{_words(s)}"
            f"</p><div class=five>{figures}</div></section>")


def _words(s: Shown) -> str:
    """What is wrong with a picture, in a sentence."""
    share = np.bincount(s.verdict.ravel(), minlength=len(VERDICTS)) / s.verdict.size
    said = [f"{100 * share[v]:.1f} % {VERDICTS[v][0]}" for v in sorted(WRONG, key=lambda v: -share[v])
            if share[v] >= 0.001]
    return escape(f"Of the picture: {'; '.join(said) or 'next to nothing wrong'}; {100 * share[SILENT]:.1f} % in range "
                  "without an answer.")


def _depth_colors(depth_m: NDArray[np.float32], there: Mask) -> NDArray[np.uint8]:
    near = 1.0 / np.maximum(np.where(np.isfinite(depth_m), depth_m, 1e6), 1e-3)
    return _colors(np.sqrt(near), np.sqrt(1.0 / FAR_M) * 0.6, np.sqrt(1.0 / NEAR_M), TURBO, there)


def _colors(values: NDArray[np.float32], low: float, high: float, stops: tuple[tuple[int, int, int], ...],
            there: Mask) -> NDArray[np.uint8]:
    colors = ramp(values.reshape(-1).astype(np.float64), low, high, stops).reshape(*values.shape, 3)
    return np.where(there[..., None], colors, np.uint8(110))
