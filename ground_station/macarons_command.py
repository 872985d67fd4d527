"""`swarmscan macarons`: what MACARONS users have becomes ours, and back.

import SETTINGS.json writes a mission; with --results also the views of the runs in a result file. import CAMERAS.csv
takes Blender's cameras. export takes views (a run folder or a file) and writes all of MACARONS' and Blender's files.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
from pathlib import Path

import numpy as np

from ground_station.views_file import read_views, write_views
from missions.blender_poses import read_blender, write_blender
from missions.errors import UserError
from missions.frames import Array
from missions.macarons_results import MacaronsRun, Results, read_results, write_results
from missions.macarons_settings import (
    RANGE_SCALED,
    SCALE,
    CameraSection,
    MacaronsSettings,
    SceneSection,
    Units,
    diagonal_fov_deg,
    read_settings,
    write_settings,
)
from missions.mission import CameraSpec, ExploreSpec, Mission, SiteSpec
from missions.mission_file import load_mission, write_mission
from missions.run_folder import RunFolder
from missions.simulation import SceneSpec

LEAST_M = 0.1


def main(argv: list[str] | None = None) -> int:
    """The command; says what it wrote."""
    options = _parser().parse_args(argv)
    if options.units_per_metre <= 0:
        raise UserError("--units-per-metre must be positive; give how many units of the mesh make a metre.")
    options.out.mkdir(parents=True, exist_ok=True)
    written = options.run(options)
    if options.json:
        sys.stdout.write(json.dumps({"written": [str(p) for p in written]}, indent=1) + "\n")
    else:
        sys.stdout.write("".join(f"{p}\n" for p in written))
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="swarmscan macarons", description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    shared = argparse.ArgumentParser(add_help=False)
    shared.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder for what is written")
    shared.add_argument("--units-per-metre", type=float, default=1.0, metavar="N", help="units of MACARONS' mesh")
    shared.add_argument("--json", action="store_true", help="print the written paths as JSON")
    take = commands.add_parser("import", parents=[shared], help="MACARONS' settings and results, or Blender's cameras")
    take.add_argument("source", type=Path, help="settings.json, or a CSV file of Blender cameras")
    take.add_argument("--results", type=Path, help="a result file with X_cam_history and V_cam_history")
    take.add_argument("--scene", default="", help="the mesh file or folder, for the mission")
    take.add_argument("--every-picture", action="store_true", help="also the pictures on the way to the key poses")
    take.add_argument("--no-truncation", action="store_true",
                      help="the camera's box as it is written (MAGICIAN), not truncated to integers (MACARONS)")
    take.set_defaults(run=_import)
    give = commands.add_parser("export", parents=[shared], help="views as MACARONS' and Blender's files")
    give.add_argument("source", type=Path, help="a run folder, or a CSV file of views")
    give.add_argument("--name", default="scene", help="the scene's name in the result file")
    give.set_defaults(run=_export)
    return parser


def _import(options: argparse.Namespace) -> list[Path]:
    units, out = Units(options.units_per_metre), options.out
    if options.source.suffix.lower() == ".csv":
        return [write_views(read_blender(options.source), out / "views.csv")]
    settings = read_settings(options.source)
    truncated = not options.no_truncation
    mission = out / "mission.toml"
    write_mission(mission_of(settings, units, options.scene, truncated), mission)
    written = [mission]
    if settings.camera.start_positions:
        starts = np.array([settings.pose_scaled(index, truncated) for index in settings.camera.start_positions])
        written.append(write_views(units.poses(starts), out / "starts.csv"))
    for name, runs in (read_results(options.results) if options.results else {}).items():
        for start, run in runs.items():
            path = out / f"{re.sub('[^A-Za-z0-9_.-]+', '_', name)}_{start}_views.csv"
            written.append(write_views(units.poses(run.rows(options.every_picture)), path))
    return written


def mission_of(settings: MacaronsSettings, units: Units, scene_path: str, truncated: bool) -> Mission:
    """A mission with the box, the camera, the range and the lattice of MACARONS' settings.

    Our camera box is the object's grown by one margin, so it is the smallest such box that holds MACARONS'; our
    lattice has one step, the geometric mean of MACARONS' three.
    """
    low, high = units.box_enu_m(np.array(settings.scene.x_min), np.array(settings.scene.x_max))
    camera_units = [side / SCALE for side in settings.camera_box(truncated)]
    camera_low, camera_high = units.box_enu_m(camera_units[0], camera_units[1])
    beyond = np.concatenate([(low - camera_low)[:2], camera_high - high])
    c = settings.camera
    cell = (camera_high - camera_low) / np.array([c.pose_l, c.pose_h, c.pose_w])
    return Mission(
        title=f"MACARONS scene {Path(scene_path).stem}".strip(),
        scene=SceneSpec(path=str(Path(scene_path).resolve()) if scene_path else "", up="y",
                        units_per_metre=units.units_per_metre),
        site=SiteSpec(object_min_enu_m=_triple(low), object_max_enu_m=_triple(high), ground_up_m=float(low[2]),
                      camera_margin_m=max(LEAST_M, float(beyond.max())),
                      camera_floor_m=max(LEAST_M, float(camera_low[2] - low[2]))),
        camera=CameraSpec(diagonal_fov_deg=diagonal_fov_deg()),
        explore=ExploreSpec(lattice_step_m=float(np.prod(cell) ** (1.0 / 3.0)), azimuths=c.pose_n_azim,
                            elevations_deg=settings.elevations_deg(),
                            sensing_range_m=RANGE_SCALED / units.scaled_per_metre))


def _export(options: argparse.Namespace) -> list[Path]:
    units, source, out = Units(options.units_per_metre), options.source, options.out
    run = RunFolder(source) if source.is_dir() else None
    poses = [v.pose for v in read_views(run.views_csv if run else source)]
    coverage: list[float] = []
    results: Results = {options.name: {"0": MacaronsRun.of_key_poses(units.rows_scaled(poses), coverage)}}
    written = [out / "results.json", out / "blender_cameras.csv"]
    write_results(results, written[0])
    write_blender(poses, written[1])
    if run is not None:
        mission = load_mission(run.mission)
        if mission.site.object_min_enu_m is not None:
            written.append(out / "settings.json")
            write_settings(settings_of(mission, units), written[-1])
    return written


def settings_of(mission: Mission, units: Units) -> MacaronsSettings:
    """MACARONS' settings of a mission that states the object's box. About 100 cells, as its automatic settings have."""
    site, explore = mission.site, mission.explore
    if site.object_min_enu_m is None or site.object_max_enu_m is None:
        raise UserError("site.object_min_enu_m and site.object_max_enu_m: MACARONS needs the object's box; give both.")
    low, high = np.array(site.object_min_enu_m), np.array(site.object_max_enu_m)
    camera_low, camera_high = low - site.camera_margin_m, high + site.camera_margin_m
    camera_low[2] = (low[2] if site.ground_up_m is None else site.ground_up_m) + site.camera_floor_m
    box, camera = units.box_units(low, high), units.box_units(camera_low, camera_high)
    cells = _cells(box[1] - box[0], float(np.prod(box[1] - box[0]) / 100.0) ** (1.0 / 3.0))
    places = _cells(camera[1] - camera[0], explore.lattice_step_m * units.units_per_metre)
    return MacaronsSettings(
        scene=SceneSection(grid_l=cells[0], grid_w=cells[1], grid_h=cells[2], x_min=_triple(box[0]),
                           x_max=_triple(box[1])),
        camera=CameraSection(pose_l=places[0], pose_w=places[1], pose_h=places[2],
                             pose_n_theta=len(explore.elevations_deg), pose_n_azim=explore.azimuths,
                             x_min=_triple(camera[0]), x_max=_triple(camera[1])))


def _cells(size: Array, step: float) -> list[int]:
    return [max(1, round(float(s) / step)) for s in size]


def _triple(point: Array) -> tuple[float, float, float]:
    x, y, z = (float(c) for c in point)
    return x, y, z
