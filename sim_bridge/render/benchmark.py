"""`swarmscan bench render`: seconds per picture, JPEG included, beside the thesis's Table 5.2."""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from rich.table import Table

from missions.camera import Camera, Pose
from missions.console import print_result
from missions.mission import CameraSpec, SiteSpec
from missions.simulation import RenderSpec, SceneSpec
from sim_bridge.render.renderer import Renderer, make_renderer
from sim_bridge.render.sensor import encode_jpeg
from sim_bridge.scenes.load import load_scene
from sim_bridge.scenes.scene import Scene

SIZES = ((456, 256), (1920, 1080), (3840, 2160))
THESIS_SECONDS = {
    ("bridge", 1920): 358.51 / 401, ("bridge", 3840): 966.88 / 401,
    ("building", 1920): 211.64 / 401, ("building", 3840): 602.04 / 401,
    ("powerline", 1920): 445.73 / 602, ("powerline", 3840): 1094.99 / 602,
}
"""Table 5.2: rendering time over the number of frames (Blender on the author's machine)."""


@dataclass(frozen=True)
class Row:
    """One scene at one size; seconds per picture from camera pose to JPEG bytes."""

    scene: str
    width_px: int
    height_px: int
    seconds_median: float
    seconds_best: float
    cpu_seconds: float
    jpeg_kib: float
    thesis_seconds: float | None


def main(argv: Sequence[str]) -> int:
    """Run the benchmark; returns the exit code."""
    parser = argparse.ArgumentParser(prog="swarmscan bench render", description=__doc__)
    parser.add_argument("--scenes", nargs="+", default=["bridge", "building", "powerline"], help="built-in structures")
    parser.add_argument("--frames", type=int, default=8, help="pictures per scene and size")
    parser.add_argument("--backend", choices=["auto", "egl", "raycast"], default="auto")
    parser.add_argument("--json", action="store_true", help="one JSON document instead of a table")
    options = parser.parse_args(argv)
    rows, backend = [], ""
    for name in options.scenes:
        scene = load_scene(SceneSpec(name=name), SiteSpec())
        renderer = make_renderer(scene, RenderSpec(backend=options.backend), CameraSpec(), seed=1)
        backend = renderer.backend_name
        rows += [measure(renderer, scene, size, max(1, options.frames)) for size in SIZES]
        renderer.close()
    print_result({"backend": backend, "rows": rows}, _table(rows, backend), options.json)
    return 0


def measure(renderer: Renderer, scene: Scene, size: tuple[int, int], frames: int) -> Row:
    """Time pictures taken on a circle around the object; the first, which sets buffers up, is not counted."""
    camera = Camera.from_diagonal_fov(*size, CameraSpec().diagonal_fov_deg)
    poses = orbit(scene, frames + 1)
    seconds, cpu, length = [], 0.0, 0
    for key, pose in enumerate(poses):
        start, cpu_start = time.perf_counter(), time.process_time()
        jpeg = encode_jpeg(renderer.render(camera, pose, [], key), CameraSpec().jpeg_quality)
        if key:
            seconds.append(time.perf_counter() - start)
            cpu += time.process_time() - cpu_start
            length += len(jpeg)
    return Row(scene.name, *size, float(np.median(seconds)), min(seconds), cpu / frames, length / frames / 1024,
               THESIS_SECONDS.get((scene.name, size[0])))


def orbit(scene: Scene, count: int) -> list[Pose]:
    """Poses on an ellipse 8 m outside the object's box at two thirds of its height, looking inwards."""
    lo, hi = np.array(scene.object_min_enu_m), np.array(scene.object_max_enu_m)
    center, half = (lo + hi) / 2, (hi - lo) / 2 * math.sqrt(2) + 8.0
    up = lo[2] + (hi[2] - lo[2]) * 2 / 3
    poses = []
    for angle in np.arange(count) * 2 * math.pi / count:
        east, north = center[0] + half[0] * math.cos(angle), center[1] + half[1] * math.sin(angle)
        yaw = math.atan2(center[1] - north, center[0] - east)
        poses.append(Pose((float(east), float(north), float(up)), yaw, math.radians(-15.0)))
    return poses


def _table(rows: Sequence[Row], backend: str) -> Table:
    table = Table(title=f"Seconds per picture, JPEG included: {backend}")
    for heading in ("scene", "size", "median s", "best s", "CPU s", "JPEG KiB", "thesis s (Table 5.2)"):
        table.add_column(heading, justify="left" if heading == "scene" else "right")
    for row in rows:
        thesis = "–" if row.thesis_seconds is None else f"{row.thesis_seconds:.2f}"
        table.add_row(row.scene, f"{row.width_px}x{row.height_px}", f"{row.seconds_median:.3f}",
                      f"{row.seconds_best:.3f}", f"{row.cpu_seconds:.2f}", f"{row.jpeg_kib:.0f}", thesis)
    return table
