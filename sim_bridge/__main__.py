"""`python -m sim_bridge MISSION.toml --run RUN_DIR`: the true world of one mission, as a process."""

from __future__ import annotations

import argparse
import logging
import sys
import time
from contextlib import closing
from functools import partial

from missions.bus import DEFAULT_ENDPOINT, Bus
from missions.clock import BRIDGE, GROUND, SECOND_NS, vehicle_name
from missions.errors import UserError
from missions.messages import SiteBrief
from missions.mission import Mission, without_scene
from missions.mission_file import find_mission, load_mission
from missions.process import process_parser, run_process, when_interrupted
from missions.run_folder import RunFolder
from missions.tlog import Tlog
from sim_bridge.clock_server import PRESENCE_S, ClockServer
from sim_bridge.doors import Doors
from sim_bridge.kept_world import read_world
from sim_bridge.render.light import Light
from sim_bridge.render.renderer import LateRenderer, make_renderer
from sim_bridge.scenes.scene import Scene
from sim_bridge.truth import Truth
from sim_bridge.world import World
from sim_bridge.world_journal import WorldJournal

log = logging.getLogger(__name__)


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
        make = partial(make_renderer, scene, mission.render, mission.camera, mission.seed, light)
        with (closing(LateRenderer(make) if journal.begun else make()) as renderer,
              closing(_doors(mission, folder)) as doors):
            clock = ClockServer(bus, mission.clock, known, site)
            bus.boot = journal.boot
            world = World(bus, clock, mission, truth, renderer, doors if doors.doors else None, ground)
            log.info("world %s ready in %.1f s: %d triangles", scene.name, time.perf_counter() - begin,
                     scene.triangles())
            # Signals end the flight, but never the writing of what is true.
            with when_interrupted(lambda *_: clock.interrupt()):
                everybody = {vehicle_name(k) for k in range(1, mission.fleet.vehicles + 1)}
                begin_clock(clock, world, journal, everybody | {GROUND} if ground else everybody, join_timeout_s)
                world.run(journal)
                from sim_bridge.verdict import leave_verdict  # not before somebody asks: it imports much
                leave_verdict(mission, folder, scene, site, truth, world, renderer.backend_name)
    folder.write_process_record(BRIDGE, messages_sent=bus.sent, frames=len(world.true_pictures), ticks=world.ticks,
                                render_s=round(world.render_s, 3), wall_s=round(time.perf_counter() - begin, 3))


def open_world(mission: Mission, folder: RunFolder, begun: bool) -> tuple[Scene, Light, SiteBrief, Truth]:
    """The true scene, its light, what the operator knows of it, and its geometry. begun: an earlier bridge has checked
    all that, and has left in the run folder what is made of it. Raises UserError."""
    kept = read_world(folder.world_kept) if begun else None
    if kept is not None:
        return *kept, site_brief(mission, kept[0]), truth_of(mission, kept[0])
    from sim_bridge import opening  # what makes scenes takes long to import; who finds one kept does without
    scene, light = opening.make_world(mission)
    site, truth = site_brief(mission, scene), truth_of(mission, scene)
    if not begun:
        opening.check_and_keep(mission, folder, scene, light, site, truth)
    return scene, light, site, truth


def truth_of(mission: Mission, scene: Scene) -> Truth:
    """The scene's geometry and the mission's obstacles."""
    return Truth(*scene.mesh(), mission.obstacles)


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
