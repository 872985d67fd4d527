"""`swarmscan bench live`: how fluid the live page is, and whether it grows, in headless Chromium drawing in software.

A synthetic mission feeds the page: first at its real pace, to count frames, then faster, to see what a long mission
leaves in the browser.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import shutil
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from rich.console import Console
from rich.table import Table

from ground_station.live.page import FRAME_S, LivePage
from ground_station.live.synthetic import MAPPED_AFTER_S, STEP_S, SyntheticMission
from ground_station.live.vehicles_in_scene import drone_mesh
from missions.errors import UserError

SOFTWARE_GL = ("--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist",
               "--js-flags=--expose-gc", "--enable-precise-memory-info")
WIDTH_PX, HEIGHT_PX = 1280, 800
WATCH_DRAWING = """(() => { const draw = WebGL2RenderingContext.prototype.drawElements;
  let drawn = false; window.framesDrawn = 0;
  const frame = () => { window.framesDrawn += drawn; drawn = false; requestAnimationFrame(frame);
    if (document.querySelector("[data-vehicle]")) window.firstPanelMs ??= performance.now(); };
  requestAnimationFrame(frame);
  WebGL2RenderingContext.prototype.drawElements = function (mode, count, ...rest) {
    drawn = true;
    if (count === CORNERS && this.canvas.style && +(this.canvas.style.opacity || 1) === 1)
      requestAnimationFrame(() => { window.firstVehicleMs ??= performance.now(); });
    return draw.call(this, mode, count, ...rest); }; })()"""
"""Counts frames in which the scene was drawn (a browser also calls for frames with nothing to draw), and notes when a
mesh with as many corners as a vehicle has was first drawn where it can be seen, and when the panel first told how
vehicles are, since navigation began."""
COUNT_FRAMES = """seconds => new Promise(done => { const frames = framesDrawn, start = performance.now();
  setTimeout(() => done((framesDrawn - frames) / (performance.now() - start) * 1000), 1000 * seconds); })"""
HEAP_MIB = "() => { gc(); gc(); return performance.memory.usedJSHeapSize / 1048576; }"
SETTLE_S, STILL_S = 5.0, 1e6
HEAP_AT_MIN = (1.0, 5.0, 15.0, 30.0)
OPENED = 3
"""Times that the page is opened to see how long that takes; the first in a browser that has just been started."""


class Feeder:
    """Steps the mission and draws the page on a thread of its own, at a pace that can be changed."""

    def __init__(self, mission: SyntheticMission, page: LivePage) -> None:
        self._mission, self._page = mission, page
        self.step_s = STEP_S
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self) -> Feeder:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stopped.set()
        self._thread.join()

    def until(self, t_s: float) -> None:
        """Wait until so much flight has passed."""
        while self._mission.t_s < t_s:
            time.sleep(0.05)

    def _run(self) -> None:
        stepped = time.monotonic()
        while not self._stopped.is_set():
            if time.monotonic() >= stepped + self.step_s:
                stepped = max(stepped + self.step_s, time.monotonic() - self.step_s)
                self._mission.step()
            self._page.draw()
            self._stopped.wait(max(0.0, min(FRAME_S, stepped + self.step_s - time.monotonic())))


def main(argv: list[str]) -> int:
    """Measure, and print a table or JSON."""
    options = _parse(argv)
    chromium = options.browser or shutil.which("chromium")
    if chromium is None:
        raise UserError("--browser: no chromium on this machine; run: sudo apt-get install -y chromium")
    if importlib.util.find_spec("playwright") is None:
        raise UserError("bench live: playwright is not installed; run: pip install 'swarmscan[dev]'")
    with TemporaryDirectory() as folder:
        result = measure(options.vehicles, options.minutes, options.faster, str(chromium), Path(folder))
    if options.json:
        sys.stdout.write(json.dumps(result, indent=1) + "\n")
    else:
        _print(result)
    return 0


def measure(vehicles: int, minutes: float, faster: float, chromium: str, folder: Path) -> dict[str, Any]:
    """Frames per second with the whole structure mapped, and the JavaScript heap as flight time passes."""
    mission = SyntheticMission(vehicles, folder)
    while mission.t_s < MAPPED_AFTER_S:
        mission.step()
    begin_s = mission.t_s
    page = LivePage(mission, 0)
    heap: dict[str, float] = {}
    try:
        with Feeder(mission, page) as feeder, browser_tab(chromium, page.port) as (tab, told_s, shown_s):
            fps = tab.evaluate(COUNT_FRAMES, SETTLE_S)
            feeder.step_s = STEP_S / faster
            for minute in sorted({m for m in HEAP_AT_MIN if m < minutes} | {minutes}):
                feeder.until(begin_s + 60.0 * minute)
                feeder.step_s = STILL_S
                tab.wait_for_timeout(1000.0 * SETTLE_S)  # a slow browser has a queue, which is no leak
                heap[f"{minute:g}"] = round(tab.evaluate(HEAP_MIB), 1)
                feeder.step_s = STEP_S / faster
            feeder.step_s = STEP_S
            late_fps = tab.evaluate(COUNT_FRAMES, SETTLE_S)
    finally:
        page.close()
    return {"vehicles": vehicles, "panel_filled_after_s": told_s, "vehicle_drawn_after_s": shown_s,
            "frames_per_s": round(fps, 1),
            "frames_per_s_at_the_end": round(late_fps, 1), "heap_mib_by_minute": heap, "faster": faster,
            "window_px": [WIDTH_PX, HEIGHT_PX]}


@contextmanager
def browser_tab(chromium: str, port: int) -> Iterator[tuple[Any, list[float], list[float]]]:
    """Chromium at the page, settled; and how many seconds it took to tell of the vehicles in the panel and to draw one,
    each time it was opened."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=list(SOFTWARE_GL))
        told_s: list[float] = []
        shown_s: list[float] = []
        for n in range(OPENED):
            tab = browser.new_page(viewport={"width": WIDTH_PX, "height": HEIGHT_PX})
            tab.add_init_script(WATCH_DRAWING.replace("CORNERS", str(drone_mesh((0, 0, 0), 1.0)[1].size)))
            tab.goto(f"http://127.0.0.1:{port}")
            tab.wait_for_function("() => window.firstVehicleMs && window.firstPanelMs")
            told_s.append(round(tab.evaluate("firstPanelMs") / 1000.0, 2))
            shown_s.append(round(tab.evaluate("firstVehicleMs") / 1000.0, 2))
            if n < OPENED - 1:
                tab.close()
        tab.wait_for_timeout(1000.0 * SETTLE_S)
        yield tab, told_s, shown_s
        browser.close()


def _print(result: dict[str, Any]) -> None:
    table = Table(title=f"Live page, {result['vehicles']} vehicles, headless Chromium, software rendering")
    table.add_column("what")
    table.add_column("value", justify="right")
    for what, key in (("the panel is filled", "panel_filled_after_s"), ("a vehicle is drawn", "vehicle_drawn_after_s")):
        opened = ", ".join(f"{s:.2f} s" for s in result[key])
        table.add_row(f"{what} after (browser just started, again, again)", opened)
    table.add_row("frames per second", str(result["frames_per_s"]))
    table.add_row("frames per second at the end", str(result["frames_per_s_at_the_end"]))
    for minute, mib in result["heap_mib_by_minute"].items():
        table.add_row(f"JavaScript heap after {minute} min of flight", f"{mib} MiB")
    Console().print(table)


def _parse(argv: list[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="swarmscan bench live", description=__doc__)
    parser.add_argument("--vehicles", type=int, default=8)
    parser.add_argument("--minutes", type=float, default=12.0, help="of flight (default %(default)s)")
    parser.add_argument("--faster", type=float, default=5.0, help="than real, while memory is watched")
    parser.add_argument("--browser", default="", help="a Chromium (default: the one on the path)")
    parser.add_argument("--json", action="store_true", help="print one JSON document on stdout")
    return parser.parse_args(argv)
