"""The page of `swarmscan bench depth`: numbers, curves, and the pictures on which depth fails worst."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ground_station.bench.depth_scores import SHARES, Mask, Pixels, Row, full_size, reliability, sparsification
from ground_station.report.splat import data_uri, ramp
from ground_station.report.style import CSS, SCRIPT
from missions.frames import Array
from perception.depth.depth_map import DepthMap

WORST = 3
"""Pictures shown per scene."""
NEAR_M, FAR_M = 2.0, 25.0
WORST_ERROR = 0.3
TURBO = ((48, 18, 59), (70, 107, 227), (40, 187, 236), (49, 242, 153), (162, 252, 60), (237, 208, 58), (251, 128, 34),
         (210, 49, 5), (122, 4, 3))
HEAT = ((20, 20, 60), (60, 120, 200), (250, 230, 120), (230, 60, 30))
COLUMNS = ("scene", "pictures", "answered", "abs_rel", "delta_1_25", "abs_rel_all", "delta_1_25_all", "median_all",
           "abs_rel_object", "answered_object", "thin", "answered_thin", "abs_rel_thin", "called_open", "ghosts",
           "ause",
           "ause_random", "oracle", "ause_answered", "oracle_answered", "calibration",
           "cpu_seconds")


@dataclass(frozen=True)
class Shown:
    """One picture with what is true and what was found."""

    scene: str
    number: int
    rgb: NDArray[np.uint8]
    true_m: NDArray[np.float32]
    ours: DepthMap
    counted: Mask

    def error(self) -> NDArray[np.float32]:
        """(h, w) relative error, 0 where nothing counts."""
        ours = full_size(self.ours.depth_m, self.true_m.shape)
        true = np.where(self.counted, self.true_m, ours)
        return np.asarray(np.abs(ours - true) / true, np.float32)

    def badness(self) -> float:
        """Share of the picture that is answered and badly wrong."""
        return float(((self.error() > WORST_ERROR) & full_size(self.ours.valid, self.true_m.shape)).mean())


def write_page(path: Path, rows: Sequence[Row], pixels: Pixels, scenes: Sequence[Sequence[Shown]]) -> None:
    """One self-contained page."""
    worst = [s for pictures in scenes for s in sorted(pictures, key=Shown.badness, reverse=True)[:WORST]]
    body = "".join([_numbers(rows), _curves(pixels), *(_pictures(s) for s in worst)])
    path.write_text(f"<!doctype html><html lang=en><head><meta charset=utf-8><title>Depth beside truth</title>"
                    f"<style>{CSS}.five{{display:grid;grid-template-columns:repeat(5,1fr);gap:6px}}</style></head><body>"
                    f"<main><h1>Depth beside truth</h1>{body}</main><script>{SCRIPT}</script></body></html>",
                    encoding="utf-8")


def _numbers(rows: Sequence[Row]) -> str:
    head = "".join(f"<th class=n>{escape(c)}</th>" for c in COLUMNS)
    lines = ["".join(f"<td class=n>{_cell(getattr(row, c))}</td>" for c in COLUMNS) for row in rows]
    cells = "".join(f"<tr>{line}</tr>" for line in lines)
    return ("<section style='overflow-x:auto'><h2>Numbers</h2><p class=soft>Counted are pixels whose true surface lies "
            "in the sensing range; answered are those that the method trusts; _all judges its best guess everywhere."
            f"</p><table><tr>{head}</tr>{cells}</table></section>")


def _cell(value: str | float) -> str:
    return f"{value:.4f}" if isinstance(value, float) else escape(str(value))


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


def _pictures(s: Shown) -> str:
    shape = s.true_m.shape
    valid = full_size(s.ours.valid, shape)
    panels = {"picture": s.rgb, "true depth": _depth_colors(s.true_m, np.isfinite(s.true_m)),
              "ours (grey: no answer)": _depth_colors(full_size(s.ours.depth_m, shape), valid),
              "relative error, all counted": _colors(s.error(), 0.0, WORST_ERROR, HEAT, s.counted),
              "confidence (dark: sure)": _colors(full_size(s.ours.confidence, shape), 0.0, 1.0, HEAT[::-1],
                                                 s.true_m > 0.0)}
    figures = "".join(f"<figure><img src='{data_uri(image, 'JPEG')}'><figcaption>{name}</figcaption></figure>"
                      for name, image in panels.items())
    return (f"<section><h2>{escape(s.scene)}, picture {s.number}</h2><p class=soft>{100 * s.badness():.1f} % of the "
            f"picture is answered and more than 30 % wrong.</p><div class=five>{figures}</div></section>")


def _depth_colors(depth_m: NDArray[np.float32], there: Mask) -> NDArray[np.uint8]:
    near = 1.0 / np.maximum(np.where(np.isfinite(depth_m), depth_m, 1e6), 1e-3)
    return _colors(np.sqrt(near), np.sqrt(1.0 / FAR_M) * 0.6, np.sqrt(1.0 / NEAR_M), TURBO, there)


def _colors(values: NDArray[np.float32], low: float, high: float, stops: tuple[tuple[int, int, int], ...],
            there: Mask) -> NDArray[np.uint8]:
    colors = ramp(values.reshape(-1).astype(np.float64), low, high, stops).reshape(*values.shape, 3)
    return np.where(there[..., None], colors, np.uint8(110))
