"""The part of `swarmscan reconstruct` that takes a folder of photographs in place of a run."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

from rich.console import Group
from rich.text import Text

from ground_station.control_file import read_control
from ground_station.photograph_record import shown
from ground_station.photographs import Wishes, prepare_run
from ground_station.reconstruction import Tell, reconstruct_run
from missions.console import print_result
from missions.errors import UserError
from missions.run_folder import RunFolder

MAPPERS = ("incremental", "global")


def add_options(parser: argparse.ArgumentParser) -> None:
    """What only photographs need."""
    group = parser.add_argument_group("for a folder of photographs")
    group.add_argument("--out", type=Path, metavar="DIR", help="where the model goes (default: PICTURES-model, beside)")
    group.add_argument("--keep-all", action="store_true", help="take blurred, badly exposed and duplicate pictures too")
    group.add_argument("--mapper", choices=MAPPERS, default=MAPPERS[0], help="how poses are found")
    group.add_argument("--poses", type=Path, metavar="CSV", help="where pictures were taken, in place of their GPS")
    group.add_argument("--poses-only", action="store_true", help="stop when the pictures are placed")
    group.add_argument("--threads", type=int, default=3, metavar="N", help="at once (default: 3)")


def asked_for(options: argparse.Namespace) -> bool:
    """Whether the target is a folder that no mission has flown."""
    target = Path(options.target)
    return target.is_dir() and not RunFolder(target).mission.is_file()


def main(options: argparse.Namespace, progress: Callable[[], AbstractContextManager[Tell]]) -> int:
    """Photographs to poses, then what every run goes through."""
    folder, started = Path(options.target).resolve(), time.monotonic()
    run = RunFolder(_out(options.out.resolve() if options.out else folder.with_name(f"{folder.name}-model"), folder))
    with progress() as tell:
        control = read_control(options.control, options.control_crs) if options.control else []
        wishes = Wishes(options.keep_all, tuple(control), options.poses, options.mapper, max(1, options.threads))
        record = prepare_run(folder, run, wishes, tell)
        result: dict[str, Any] = {} if options.poses_only else reconstruct_run(run, options.keep_depth, tell)
    wall_s = round(time.monotonic() - started, 2)
    said = f"{result['points']} points, " if result else ""
    print_result({**record, "model": result or None, "run": str(run.root), "wall_s": wall_s},
                 Group(shown(record), Text(f"{said}{wall_s:.0f} s: {run.root}")), options.json)
    return 0


def _out(root: Path, pictures: Path) -> Path:
    """Made when missing. Raises UserError when it belongs to something else."""
    if root == pictures or pictures in root.parents:
        raise UserError(f"{root}: the model cannot go into the folder of the pictures; give another one with --out.")
    if RunFolder(root).flight.is_file():
        raise UserError(f"{root}: holds a flown mission; give another folder with --out.")
    try:
        root.mkdir(parents=True, exist_ok=True)
    except OSError as e:
        raise UserError(f"{root}: cannot be written ({e.strerror or e}); give another folder with --out.") from e
    return root
