"""`python -m sim_bridge MISSION.toml --run RUN_DIR`: the true world of one mission, as a process."""

from __future__ import annotations

import argparse
import logging
import sys
import time
from collections.abc import Sequence
from contextlib import closing

import msgspec
import numpy as np

from missions.bus import DEFAULT_ENDPOINT, Bus
from missions.clock import BRIDGE, GROUND, SECOND_NS, vehicle_name
from missions.disk import Disk
from missions.errors import UserError
from missions.lattice import view_positions
from missions.messages import PictureMeta, SiteBrief
from missions.mission import Mission, without_scene
from missions.mission_file import find_mission, load_mission
from missions.pads import camera_bounds, takeoff_columns, takeoff_points
from missions.process import process_parser, run_process, when_interrupted
from missions.run_folder import RunFolder, write_views
from missions.tlog import Tlog
from sim_bridge.clock_server import PRESENCE_S, ClockServer
from sim_bridge.coverage import Coverage
from sim_bridge.doors import Doors
from sim_bridge.kept_world import read_world, world_bytes
from sim_bridge.render.light import Light, make_light
from sim_bridge.render.renderer import make_renderer
from sim_bridge.scenes.export import export_mesh
from sim_bridge.scenes.load import load_scene
from sim_bridge.scenes.scene import Scene
from sim_bridge.truth import BEFORE_FLIGHT_NS, Truth
from sim_bridge.verdict import COVERAGE_POINTS, reference_surface, write_reference, write_verdict
from sim_bridge.world import World
from sim_bridge.world_journal import WorldJournal

log = logging.getLogger(__name__)

EXPLORE = "explore"
COLUMN_SAMPLE_M = 0.5
ABOVE_GROUND_M = 0.75
"""Columns are judged from here up; the ground itself, and grass, are no obstacle to a take-off."""


def main(argv: list[str] | None = None) -> int:
    """Run the world until the mission is over. 2 for what the user can mend, 1 for what went wrong on the way."""
    a = _arguments(argv)
    return run_process(lambda: serve(load_mission(find_mission(a.mission)), RunFolder(a.run), a.listen, a.fleet,
                                     a.join_timeout_s, not a.no_ground))


def serve(mission: Mission, folder: RunFolder, listen: str, fleet: str, join_timeout_s: float,
          ground: bool = True) -> None:
    """Open the world, fly the mission, leave the verdict in the run folder. Raises UserError or LinkError.

    ground: whether a ground station of ours takes part; without one the world goes on until it is interrupted.
    """
    begin = time.perf_counter()
    if folder.referee.is_file():
        raise UserError(f"--run {folder.root}: the mission in this folder is over; give a fresh one.")
    known = without_scene(mission).mission_hash
    with (Bus(BRIDGE, fleet, listen=listen) as bus,  # the others may connect while the scene loads
          closing(WorldJournal(folder.world_journal, known, bus.boot)) as journal):
        scene, light, site, truth = open_world(mission, folder, journal.begun)
        with (closing(make_renderer(scene, mission.render, mission.camera, mission.seed, light)) as renderer,
              closing(_doors(mission, folder)) as doors):
            clock = ClockServer(bus, mission.clock, known, site)
            bus.boot = journal.boot
            world = World(bus, clock, mission, truth, renderer, doors if doors.doors else None, ground)
            log.info("world %s ready in %.1f s: %d triangles, %s", scene.name, time.perf_counter() - begin,
                     scene.triangles(), renderer.backend_name)
            # Signals end the flight, but never the writing of what is true.
            with when_interrupted(lambda *_: clock.interrupt()):
                everybody = {vehicle_name(k) for k in range(1, mission.fleet.vehicles + 1)}
                begin_clock(clock, world, journal, everybody | {GROUND} if ground else everybody, join_timeout_s)
                world.run(journal)
                coverage = judge_coverage(mission, scene, site, truth, world.true_pictures)
                write_verdict(folder, {**world.referee.summary(), "coverage": coverage.summary(),
                                       "pictures": len(world.true_pictures), "renderer": renderer.backend_name,
                                       "notes": scene.notes, "site": msgspec.to_builtins(site)})
                write_views(folder.truth_views, [folder.view_row(m) for m in world.true_pictures])
                folder.world_kept.unlink(missing_ok=True)
    folder.write_process_record(BRIDGE, messages_sent=bus.sent, frames=len(world.true_pictures), ticks=world.ticks,
                                render_s=round(world.render_s, 3), wall_s=round(time.perf_counter() - begin, 3))


def open_world(mission: Mission, folder: RunFolder, begun: bool) -> tuple[Scene, Light, SiteBrief, Truth]:
    """The true scene, its light, what the operator knows of it, and its geometry. begun: an earlier bridge has checked
    all that, and has left in the run folder what is made of it. Raises UserError."""
    kept = read_world(folder.world_kept) if begun else None
    scene, light = kept or (load_scene(mission.scene, mission.site), make_light(mission.render, mission.seed))
    site = site_brief(mission, scene)
    truth = Truth(*scene.mesh(), mission.obstacles)
    if not begun:
        check_columns(mission, site, truth)
        write_reference(folder, scene, site)
        if mission.knowledge == "mesh" and not mission.prior_path:
            export_mesh(scene, folder.prior)
        Disk(folder.truth).write(folder.world_kept, world_bytes(scene, light))
    return scene, light, site, truth


def begin_clock(clock: ClockServer, world: World, journal: WorldJournal, names: set[str],
                join_timeout_s: float) -> None:
    """With everybody at time zero; or, in the place of a bridge that has died, where it was. Raises LinkError."""
    past = journal.take_past()
    if not past:
        clock.admit(names, join_timeout_s)
        return
    world.live_through(past)
    clock.readmit(names, [step.clock for step in past], PRESENCE_S)
    log.warning("takes the place of a bridge that died at %.1f s", clock.t_ns / SECOND_NS)


def _doors(mission: Mission, folder: RunFolder) -> Doors:
    spec = mission.mavlink
    tlog = Tlog(folder.door_tlog, mission.clock.epoch_utc) if spec.open or spec.open_each else None
    return Doors(spec, mission.fleet.vehicles, tlog)


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


def judge_coverage(mission: Mission, scene: Scene, site: SiteBrief, truth: Truth,
                   pictures: Sequence[PictureMeta]) -> Coverage:
    """What of the object exploration's pictures have seen, and what of it could be seen from where the mission's views
    may stand. pictures: with their true poses."""
    points = reference_surface(scene, site, COVERAGE_POINTS).points_enu_m
    coverage = Coverage(truth, points, mission.explore.sensing_range_m)
    for picture in pictures:
        if picture.phase == EXPLORE:
            coverage.add(picture)
    positions = view_positions(*camera_bounds(mission, site), mission.explore)
    clearance = truth.distance(positions, np.full(len(positions), BEFORE_FLIGHT_NS))
    coverage.reach(positions[clearance >= mission.fleet.clearance_m], mission.explore, mission.camera.explore_camera())
    return coverage


def _arguments(argv: list[str] | None) -> argparse.Namespace:
    parser = process_parser("sim-bridge", __doc__ or "")
    parser.add_argument("--listen", default=DEFAULT_ENDPOINT, help="where the bus listens (default %(default)s)")
    parser.add_argument("--join-timeout-s", type=float, default=300.0,
                        help="how long to wait for the other processes (default %(default)s)")
    parser.add_argument("--no-ground", action="store_true",
                        help="vehicles alone take part, until the process is interrupted")
    return parser.parse_args(argv)


if __name__ == "__main__":
    sys.exit(main())
