"""`swarmscan bench deconflict`: seeded random missions of simulated fleets in narrow, generated scenes.

The vehicles are the real ones (executor, pilot, avoidance, teammates) on simulated bodies in one process; the wires,
the pictures and the range sensor are left out, and every vehicle knows the map. A mission ends well when every view has
been flown and all have landed; it counts as a deadlock when nobody moves for long.
"""

from __future__ import annotations

import argparse
import multiprocessing
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import track as progress
from rich.table import Table

from missions.clock import vehicle_name
from missions.console import print_result
from missions.frames import Array
from missions.mavlink import Route, Waypoint
from missions.messages import AnnouncedTrajectory
from missions.pads import geofence
from planning.paths import VoxelField
from planning.trajectories import Curve
from vehicle.campaign_referee import Verdict, judge, track
from vehicle.campaign_world import World, make_world, reach_from
from vehicle.modes import RETURN, STANDBY
from vehicle.sensor_memory import SensorMemory
from vehicle.simulator import NS
from vehicle.vehicle import Vehicle

TICK_NS, LATENCY_NS = 100_000_000, 10_000_000
STUCK_NS = 900 * NS
"""Nobody has moved for so long, well beyond the waits after which vehicles give the air to one: a deadlock."""
MAX_NS = 7200 * NS
PASS_M = 0.25
ATTEMPTS = 3
"""A view that so many plans have given back is not flown."""


class KnownSpace(SensorMemory):
    """A vehicle's memory when the map is known before and never changes."""

    def __init__(self, field: VoxelField, lower_enu_m: Array, upper_enu_m: Array, voxel_m: float,
                 reach_m: float) -> None:
        super().__init__(lower_enu_m, upper_enu_m, voxel_m, reach_m, [])
        self._field = field

    def field(self, a_enu_m: Array, b_enu_m: Array, margin_m: float) -> VoxelField:
        """The whole field, made once."""
        return self._field


@dataclass(frozen=True)
class Result:
    """How one mission went."""

    seed: int
    kind: str
    vehicles: int
    views: int
    flown: int
    deadlock: bool
    verdict: Verdict
    mission_s: float
    flight_s: float
    """Over all vehicles."""
    waited_s: float
    replans: int
    cpu_s: float
    given_back: list[str]

    @property
    def good(self) -> bool:
        """Every view flown, everybody home, nobody ever too near."""
        return self.flown == self.views and not self.deadlock and not self.verdict.separation_violations \
            and not self.verdict.clearance_violations


class Campaign:
    """One mission: vehicles, the mail between them, and a dispatcher in the ground station's place."""

    def __init__(self, world: World, deal: dict[int, list[int]] | None = None) -> None:
        """deal: which views each vehicle is sent, in this order; random when left out."""
        self.world, self.t_ns = world, 0
        mission, site = world.mission, world.site
        self.vehicles = {k: Vehicle(mission, site, k, Path(), memory=KnownSpace(
            world.field, *geofence(mission, site), world.grid.voxel_m, mission.fleet.range_sensor_m))
            for k in range(1, mission.fleet.vehicles + 1)}
        self.mail: list[AnnouncedTrajectory] = []
        self.curves: dict[int, list[tuple[int, Curve]]] = {k: [] for k in self.vehicles}
        self.times: list[int] = []
        self.flying: list[list[bool]] = []
        self.waited_ns = self.moved_ns = 0
        self.attempts = dict.fromkeys(range(len(world.views_enu_m)), 0)
        self.pending: list[int] = []
        self.given_back: list[str] = []
        self.random = np.random.default_rng(world.mission.seed + 1)
        self.dead: frozenset[int] = frozenset()
        self._plans = 0
        home = bool(self.random.random() < 0.5)
        for k, views in (deal or self._random_deal()).items():
            if views:
                self._send(k, views, home)

    @property
    def flown(self) -> set[int]:
        """Views whose shutter opened."""
        return {view for v in self.vehicles.values() for _, view in v.camera.exposed}

    @property
    def alive(self) -> dict[int, Vehicle]:
        """Those that still fly and listen."""
        return {k: v for k, v in self.vehicles.items() if k not in self.dead}

    def kill(self, k: int) -> None:
        """Vehicle k stops where it rests, and everybody learns of it."""
        self.dead |= {k}
        for v in self.alive.values():
            v.teammates.note_participants(frozenset(map(vehicle_name, self.alive)))

    def fly(self, until: Callable[[], bool] = lambda: False) -> Result:
        """Until everybody has landed, or nothing moves any more, or as asked."""
        start = time.process_time()
        while not self._over() and not until() and self.t_ns - self.moved_ns < STUCK_NS and self.t_ns < MAX_NS:
            self._tick()
        tracks = np.stack([track(self.curves[k], np.array(self.times)) for k in self.vehicles])
        fleet = self.world.mission.fleet
        verdict = judge(tracks, np.array(self.flying).T, np.array(self.times), self.world.grid, fleet.separation_m,
                        fleet.clearance_m, fleet.acceleration_m_s2)
        dt = np.diff(np.array(self.times), prepend=0) / NS
        return Result(
            seed=self.world.mission.seed, kind=self.world.kind, vehicles=len(self.vehicles),
            views=len(self.attempts), flown=len(self.flown), deadlock=not self._over(), verdict=verdict,
            mission_s=self.t_ns / NS, flight_s=float((np.array(self.flying).T * dt).sum()),
            waited_s=self.waited_ns / NS, replans=sum(v.avoidance.replans for v in self.vehicles.values()),
            cpu_s=time.process_time() - start, given_back=self.given_back)

    def _tick(self) -> None:
        mail, self.mail = self.mail, []
        for message in mail:
            for k, v in self.alive.items():
                if k != message.vehicle_id:
                    v.teammates.hear(message)
        wake = self.t_ns + TICK_NS
        for k, v in self.alive.items():
            v.executor.step(self.t_ns)
            wake = min(wake, v.executor.wake_ns or wake)
            announcement = v.pilot.helm.announcement(self.t_ns)
            if announcement is not None:
                self.mail.append(announcement)
            if not self.curves[k] or self.curves[k][-1][1] is not v.body.flight.curve:
                self.curves[k].append((self.t_ns, v.body.flight.curve))
            if v.body.end_ns > self.t_ns:
                self.moved_ns = self.t_ns
        self.times.append(self.t_ns)
        self.flying.append([v.executor.flying for v in self.vehicles.values()])
        self._dispatch()
        then = min((self.t_ns // TICK_NS + 1) * TICK_NS, max(self.t_ns + LATENCY_NS, wake))
        self.waited_ns += (then - self.t_ns) * sum(v.pilot.waiting for v in self.alive.values())
        self.t_ns = then

    def _over(self) -> bool:
        return self.t_ns > TICK_NS and not self.pending and \
            all(v.executor.mode == STANDBY for v in self.alive.values())

    def _random_deal(self) -> dict[int, list[int]]:
        """Every vehicle gets random views in random order."""
        order = [int(n) for n in self.random.permutation(len(self.attempts))]
        return {k: order[k - 1::len(self.vehicles)] for k in self.vehicles}

    def _send(self, k: int, views: list[int], home: bool) -> None:
        """A plan along ways that are clear when nobody else flies."""
        vehicle = self.vehicles[k]
        here = vehicle.pilot.position(self.t_ns) if vehicle.executor.flying else vehicle.executor.hover
        waypoints = []
        for n in views:
            self.attempts[n] += 1
            goal = self.world.views_enu_m[n]
            for corner in reach_from(self.world, here).path_to(goal)[1:-1]:
                waypoints.append(Waypoint(position_enu_m=tuple(corner.tolist()), yaw_enu_rad=0.0, stop=False,
                                          pass_m=PASS_M))
            stop = bool(self.random.random() < 0.5)
            waypoints.append(Waypoint(
                position_enu_m=tuple(goal.tolist()), yaw_enu_rad=float(self.random.uniform(-3.0, 3.0)), view_id=n,
                stop=stop, settle_s=0.3 if stop else 0.0, pass_m=PASS_M,
                speed_m_s=0.0 if stop else float(self.random.uniform(0.3, 3.0))))
            here = goal
        self._plans += 1
        route = Route(plan_id=self._plans, phase="survey", waypoints=waypoints, home_after=home)
        vehicle.executor.take(route, [[n] for n in range(len(waypoints))])
        vehicle.executor.start()

    def _dispatch(self) -> None:
        """Views given back go to whoever is idle; when nothing is left, everybody goes home."""
        for k, v in self.alive.items():
            for report in v.executor.outbox.reports:
                self.given_back.append(f"{k}: view {report.view_id} {report.outcome} ({report.detail})")
                if self.attempts[report.view_id] < ATTEMPTS:
                    self.pending.append(report.view_id)
            v.executor.outbox.clear()
        free = [k for k, v in self.alive.items() if v.executor.idle or v.executor.mode in (STANDBY, RETURN)]
        if self.pending and free:
            self._send(free[int(self.random.integers(len(free)))], self.pending, False)
            self.pending = []
        elif len(free) == len(self.alive):
            for v in self.alive.values():
                v.executor.go_home(self.t_ns)


def run_mission(seed: int, least: int, most: int, kind: str | None = None) -> Result:
    """The mission of a seed."""
    return Campaign(make_world(seed, least, most, kind)).fly()


def main(argv: Sequence[str]) -> int:
    """Run the campaign; the exit code is 1 when any mission failed."""
    parser = argparse.ArgumentParser(prog="swarmscan bench deconflict", description=__doc__)
    parser.add_argument("--missions", type=int, default=100)
    parser.add_argument("--vehicles", type=int, nargs=2, default=[2, 16], metavar=("LEAST", "MOST"))
    parser.add_argument("--seed", type=int, default=0, help="of the first mission; the others count on from it")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--json", action="store_true", help="one JSON document instead of a table")
    options = parser.parse_args(argv)
    start = time.perf_counter()
    results = list(progress(_results(options), total=options.missions, console=Console(stderr=True),
                            description="missions"))
    summary = _summary(results, time.perf_counter() - start)
    failed = [r for r in results if not r.good]
    print_result({"summary": summary, "failed": failed}, _table(summary), options.json)
    return 1 if failed else 0


def _results(options: argparse.Namespace) -> Iterator[Result]:
    seeds = range(options.seed, options.seed + options.missions)
    least, most = options.vehicles
    with ProcessPoolExecutor(options.jobs, mp_context=multiprocessing.get_context("spawn")) as pool:
        yield from pool.map(run_mission, seeds, [least] * len(seeds), [most] * len(seeds), chunksize=4)


def _summary(results: list[Result], wall_s: float) -> dict[str, float]:
    flight_s = sum(r.flight_s for r in results)
    return {
        "missions": len(results), "vehicles": sum(r.vehicles for r in results),
        "views": sum(r.views for r in results), "views_not_flown": sum(r.views - r.flown for r in results),
        "missions_failed": sum(not r.good for r in results), "deadlocks": sum(r.deadlock for r in results),
        "separation_violations": sum(r.verdict.separation_violations for r in results),
        "clearance_violations": sum(r.verdict.clearance_violations for r in results),
        "least_separation_m": min(r.verdict.least_separation_m for r in results),
        "least_clearance_m": min(r.verdict.least_clearance_m for r in results),
        "given_back": sum(len(r.given_back) for r in results),
        "flight_h": flight_s / 3600.0, "waiting_share": sum(r.waited_s for r in results) / max(flight_s, 1e-9),
        "replans": sum(r.replans for r in results), "cpu_s": sum(r.cpu_s for r in results), "wall_s": wall_s,
        "missions_per_s": len(results) / wall_s,
    }


def _table(summary: dict[str, float]) -> Table:
    table = Table("", "value", title="Simulated fleets in narrow scenes")
    for name, value in summary.items():
        table.add_row(name.replace("_", " "), f"{value:.3f}" if isinstance(value, float) else str(value))
    return table
