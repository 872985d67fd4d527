"""`swarmscan`: one command, a table of subcommands and one of benchmarks.

Each entry names its module as a string, so that the command turns into that process without the others being imported.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Sequence
from dataclasses import dataclass

from missions.process import run_process


@dataclass(frozen=True)
class Command:
    """A subcommand: where its `main(argv) -> int` lives, and what it is for."""

    name: str
    target: str
    purpose: str

    @property
    def words(self) -> list[str]:
        """The name as it is typed."""
        return self.name.split()


COMMANDS = (
    Command("fly", "ground_station.launcher:main", "fly a mission on this machine: all processes, model, report"),
    Command("simulate", "ground_station.simulate:main", "a world and vehicles for MAVProxy, QGroundControl, MAVSDK"),
    Command("resume", "ground_station.resume:main", "take up a mission whose ground station was killed"),
    Command("replay", "ground_station.replay:main", "a run once more from its journal; are its decisions the same?"),
    Command("missions export", "ground_station.missions_export:main", "what a run flew, as .plan, waypoints or KML"),
    Command("missions upload", "missions.transfer_commands:upload", "send a plan file to a vehicle and read it back"),
    Command("missions download", "missions.transfer_commands:download", "what a vehicle holds, as a plan file"),
    Command("missions", "missions.commands:main", "list and explain the mission files"),
    Command("scenes", "sim_bridge.scenes.commands:main", "list, check and export true scenes"),
    Command("live", "ground_station.live.__main__:main", "the live page of a mission under way"),
    Command("ground-station", "ground_station.__main__:main", "the ground station process alone"),
    Command("vehicle", "vehicle.__main__:main", "one vehicle process alone"),
    Command("sim-bridge", "sim_bridge.__main__:main", "the simulated world alone"),
    Command("reconstruct", "ground_station.stages:main_reconstruct", "pictures of a run to cloud and mesh"),
    Command("evaluate", "ground_station.stages:main_evaluate", "measure a run, or any cloud, against the truth"),
    Command("report", "ground_station.stages:main_report", "write the report page of a run"),
    Command("export", "ground_station.model_export:main", "cloud and cameras as LAS, COLMAP, Metashape, ODM"),
    Command("allocate", "ground_station.allocate.command:main", "share views from a file out among vehicles"),
    Command("macarons", "ground_station.macarons_command:main", "missions and views from and for MACARONS and Blender"),
    Command("train", "ground_station.train:main", "train MACARONS' networks, with progress, log and checkpoints"),
    Command("thesis", "ground_station.thesis_command:main", "the thesis's planning experiment on given views"),
    Command("bench", "ground_station.cli:bench", "measure one part: allocate, paths, energy, deconflict, ..."),
    Command("doctor", "ground_station.doctor:main", "what works on this machine, and what to do about the rest"),
)

BENCHMARKS = (
    Command("render", "sim_bridge.render.benchmark:main", "seconds per picture, beside the thesis's Table 5.2"),
    Command("photographs", "ground_station.bench.photographs:main", "cameras of photographs beside where they stood"),
    Command("photograph-set", "sim_bridge.render.photograph_set:main", "pictures as a person would bring them home"),
    Command("nbv", "sim_bridge.nbv.bench:main", "methods that choose views, beside oracles that know the truth"),
    Command("coverage", "ground_station.bench.coverage:main", "coverage estimated without truth, beside the truth"),
    Command("allocate", "ground_station.allocate.bench:main", "makespans of the methods, on files and as views grow"),
    Command("reassign", "ground_station.allocate.reassign_bench:main", "what happens in flight, warm and cold"),
    Command("paths", "ground_station.bench.paths:main", "planners in narrow passages and around given structures"),
    Command("replan", "vehicle.replan_bench:main", "what a replan costs on board, around given structures"),
    Command("energy", "ground_station.bench.energy:main", "the power model; predicted against consumed in runs"),
    Command("trajectories", "ground_station.bench.trajectories:main", "views passed or stopped at; legs and flights"),
    Command("depth", "ground_station.bench.depth:main", "depth of exploration pictures beside true depth"),
    Command("wires", "ground_station.bench.wires:main", "what pictures say of wires, beside the truth"),
    Command("lidar", "ground_station.bench.lidar:main", "exploration's pictures beside a simulated LiDAR"),
    Command("imagination", "ground_station.bench.imagination:main", "imagined occupancy beside true occupancy"),
    Command("recovery", "ground_station.bench.recovery:main", "how soon a killed ground station is replaced"),
    Command("protocol", "ground_station.bench.protocol:main", "uploads over bad links; many vehicles behind a door"),
    Command("reconstruct-growth", "ground_station.bench.reconstruct_growth:main", "what more pictures cost"),
    Command("live", "ground_station.bench.live:main", "the live page: frames per second, memory after a long mission"),
    Command("deconflict", "vehicle.campaign:main", "random missions of simulated fleets in narrow, generated scenes"),
)


def usage(program: str, commands: Sequence[Command]) -> str:
    """The help text."""
    width = max(len(c.name) for c in commands)
    lines = [f"  {c.name:<{width}}  {c.purpose}" for c in commands]
    return "\n".join([f"usage: {program} COMMAND ...  ({program} COMMAND --help for more)", "", *lines, ""])


def main(argv: list[str] | None = None) -> int:
    """Run a subcommand; 2 for what the user can mend, 1 for what went wrong on the way."""
    return _dispatch("swarmscan", COMMANDS, sys.argv[1:] if argv is None else argv)


def bench(argv: list[str]) -> int:
    """Run a benchmark, likewise."""
    return _dispatch("swarmscan bench", BENCHMARKS, argv)


def _dispatch(program: str, commands: Sequence[Command], arguments: list[str]) -> int:
    if not arguments or arguments[0] in ("-h", "--help"):
        (sys.stdout if arguments else sys.stderr).write(usage(program, commands))
        return 0 if arguments else 2
    command = next((c for c in commands if arguments[:len(c.words)] == c.words), None)
    if command is None:
        names = ", ".join(c.name for c in commands)
        sys.stderr.write(f"{program}: unknown command {arguments[0]}; use one of: {names}.\n")
        return 2
    module, function = command.target.split(":")
    rest = arguments[len(command.words):]
    return run_process(lambda: int(getattr(importlib.import_module(module), function)(rest)))


if __name__ == "__main__":
    sys.exit(main())
