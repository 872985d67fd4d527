"""`python -m sim_bridge MISSION.toml --run RUN_DIR`: the true world of one mission, as a process."""

from __future__ import annotations

import argparse
import logging
import sys
import time
from contextlib import closing

import msgspec
import numpy as np

from missions.bus import DEFAULT_ENDPOINT, Bus
from missions.clock import BRIDGE, GROUND, vehicle_name
from missions.errors import UserError
from missions.lattice import view_positions
from missions.messages import SiteBrief
from missions.mission import Mission, without_scene
from missions.mission_file import find_mission, load_mission
from missions.pads import camera_bounds, takeoff_columns, takeoff_points
from missions.process import process_parser, run_process, when_interrupted
from missions.run_folder import RunFolder, write_views
from sim_bridge.clock_server import ClockServer
from sim_bridge.coverage import Coverage
from sim_bridge.render.renderer import make_renderer
from sim_bridge.scenes.export import export_mesh
from sim_bridge.scenes.load import load_scene
from sim_bridge.scenes.scene import Scene
from sim_bridge.truth import BEFORE_FLIGHT_NS, Truth
from sim_bridge.verdict import COVERAGE_POINTS, reference_surface, write_reference, write_verdict
from sim_bridge.world import World

log = logging.getLogger(__name__)

COLUMN_SAMPLE_M = 0.5
ABOVE_GROUND_M = 0.75
"""Columns are judged from here up; the ground itself, and grass, are no obstacle to a take-off."""


def main(argv: list[str] | None = None) -> int:
    """Run the world until the mission is over. 2 for what the user can mend, 1 for what went wrong on the way."""
    a = _arguments(argv)
    return run_process(lambda: serve(load_mission(find_mission(a.mission)), RunFolder(a.run), a.listen, a.fleet,
                                     a.join_timeout_s))


def serve(mission: Mission, folder: RunFolder, listen: str, fleet: str, join_timeout_s: float) -> None:
    """Open the world, fly the mission, leave the verdict in the run folder. Raises UserError or LinkError."""
    begin = time.perf_counter()
    with Bus(BRIDGE, fleet, listen=listen) as bus:  # the others may connect while the scene loads
        scene = load_scene(mission.scene, mission.site)
        site = site_brief(mission, scene)
        truth = Truth(*scene.mesh(), mission.obstacles)
        check_columns(mission, site, truth)
        coverage = _coverage(mission, scene, site, truth)
        write_reference(folder, scene, site)
        if mission.knowledge == "mesh" and not mission.prior_path:
            export_mesh(scene, folder.prior)
        with closing(make_renderer(scene, mission.render, mission.camera, mission.seed)) as renderer:
            clock = ClockServer(bus, mission.clock, without_scene(mission).mission_hash, site)
            world = World(bus, clock, mission, truth, renderer, coverage)
            log.info("world %s ready in %.1f s: %d triangles, %s", scene.name, time.perf_counter() - begin,
                     scene.triangles(), renderer.backend_name)
            # Signals end the flight, but never the writing of what is true.
            with when_interrupted(lambda *_: clock.interrupt()):
                clock.admit({GROUND, *(vehicle_name(k) for k in range(1, mission.fleet.vehicles + 1))}, join_timeout_s)
                world.run()
                write_verdict(folder, {**world.referee.summary(), "coverage": coverage.summary(),
                                       "pictures": len(world.true_pictures), "renderer": renderer.backend_name,
                                       "notes": scene.notes, "site": msgspec.to_builtins(site)})
                write_views(folder.truth_views, [folder.view_row(m) for m in world.true_pictures])
    folder.write_process_record(BRIDGE, messages_sent=bus.sent, frames=len(world.true_pictures), ticks=world.ticks,
                                render_s=round(world.render_s, 3), wall_s=round(time.perf_counter() - begin, 3))


def site_brief(mission: Mission, scene: Scene) -> SiteBrief:
    """What the operator knows: the mission's word where it has one, else the scene's bounds."""
    given = mission.site
    return SiteBrief(object_min_enu_m=given.object_min_enu_m or scene.object_min_enu_m,
                     object_max_enu_m=given.object_max_enu_m or scene.object_max_enu_m,
                     ground_up_m=scene.ground_up_m if given.ground_up_m is None else given.ground_up_m)


def check_columns(mission: Mission, site: SiteBrief, truth: Truth) -> None:
    """The operator's word that vehicles take off through free space, held against the truth. Raises UserError."""
    for k, (lower, upper) in enumerate(takeoff_columns(mission, site)):
        bottom = np.array([lower[0], lower[1], site.ground_up_m + ABOVE_GROUND_M])
        axes = [np.arange(a, b + 1e-6, COLUMN_SAMPLE_M) for a, b in zip(bottom, upper, strict=True)]
        points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        room = truth.distance(points, np.full(len(points), BEFORE_FLIGHT_NS))
        if room.min() < 0.5 * COLUMN_SAMPLE_M:
            east, north, up = points[room.argmin()]
            x, y, _ = takeoff_points(mission, site)[k]
            raise UserError(f"mission: the take-off column of vehicle {k + 1}, over ({x:.1f}, {y:.1f}) m, is not free: "
                            f"the scene has something at ({east:.1f}, {north:.1f}, {up:.1f}) m; give "
                            "fleet.takeoff_enu_m points on open ground.")


def _coverage(mission: Mission, scene: Scene, site: SiteBrief, truth: Truth) -> Coverage:
    """Reference points, and what of them can be seen from where the mission's views may stand."""
    points = reference_surface(scene, site, COVERAGE_POINTS).points_enu_m
    coverage = Coverage(truth, points, mission.explore.sensing_range_m)
    positions = view_positions(*camera_bounds(mission, site), mission.explore)
    clearance = truth.distance(positions, np.full(len(positions), BEFORE_FLIGHT_NS))
    coverage.reach(positions[clearance >= mission.fleet.clearance_m], mission.explore, mission.camera.explore_camera())
    return coverage


def _arguments(argv: list[str] | None) -> argparse.Namespace:
    parser = process_parser("sim-bridge", __doc__ or "")
    parser.add_argument("--listen", default=DEFAULT_ENDPOINT, help="where the bus listens (default %(default)s)")
    parser.add_argument("--join-timeout-s", type=float, default=300.0,
                        help="how long to wait for the other processes (default %(default)s)")
    return parser.parse_args(argv)


if __name__ == "__main__":
    sys.exit(main())
