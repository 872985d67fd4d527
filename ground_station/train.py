"""`swarmscan train`: MACARONS' networks from procedural scenes, from scratch or further, with the truth or without.

Scenes become walks with pictures first (`swarmscan scenes walks`, a process of its own: only the simulated world may
open a scene). `split:train` means all families of that split. Progress goes to the terminal and, for TensorBoard, to
OUT/log; after every epoch there is a checkpoint that --resume goes on from, to the same weights as without the stop.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from pathlib import Path

import msgspec
import numpy as np
import torch
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table
from tensorboardX import SummaryWriter

from missions.console import print_result
from missions.errors import UserError
from missions.scene_names import PREFIX, SPLITS, families_of
from missions.training_walks import SUFFIX
from perception.macarons.training import NAMES, TrainingRun, TrainSettings

SPLIT = "split:"


def main(argv: list[str] | None = None) -> int:
    """The command."""
    options = _parser().parse_args(argv)
    torch.set_num_threads(options.threads)
    torch.set_flush_denormal(True)  # numbers next to nothing are slow to reckon with
    try:
        return _train_and_export(options)
    finally:
        torch.set_flush_denormal(False)


def _train_and_export(options: argparse.Namespace) -> int:
    walks = _walks(options.scenes, options.seeds, options.out / "walks")
    held_out = _walks(options.validate, 1, options.out / "validation") if options.validate else []
    run = TrainingRun(options.out, _settings(options), walks, options.begin_with)
    if options.resume:
        run.resume()
    history = _train(run, held_out, options.epochs)
    run.export(options.out / "weights")
    print_result({"history": history, "weights": str(options.out / "weights")}, _table(history), options.json)
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="swarmscan train", description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", nargs="+", required=True, metavar="SCENE",
                        help="scenes by name or path, split:NAME, or folders of walks")
    parser.add_argument("--seeds", type=int, default=2, help="scenes per family of a split (default %(default)s)")
    parser.add_argument("--validate", nargs="*", default=[f"{SPLIT}validation"], metavar="SCENE",
                        help="what errors are measured on after each epoch (default split:validation); none to skip")
    parser.add_argument("--epochs", type=int, required=True, help="passes over the walks, those before a resume too")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR")
    parser.add_argument("--resume", action="store_true", help="go on from the checkpoint in DIR")
    parser.add_argument("--begin-with", type=Path, metavar="DIR", help="weights to begin with")
    parser.add_argument("--online", action="store_true", help="learn as in flight, from pictures and poses alone")
    parser.add_argument("--parts", nargs="+", choices=NAMES, default=list(NAMES), help="networks that learn")
    parser.add_argument("--set", action="append", default=[], metavar="NAME=VALUE", help="a size or rate")
    parser.add_argument("--threads", type=int, default=2, help="of torch (default %(default)s)")
    parser.add_argument("--json", action="store_true", help="print one JSON document on stdout")
    return parser


def _settings(options: argparse.Namespace) -> TrainSettings:
    """The settings that the command line asks for; --set names a field of TrainSettings or of LearnSettings."""
    tree: dict[str, object] = {"online": options.online, "parts": tuple(options.parts)}
    learn: dict[str, object] = {}
    for pair in options.set:
        name, equals, value = pair.partition("=")
        if not equals:
            raise UserError(f"--set {pair}: no '='; write --set NAME=VALUE.")
        parsed: object = [int(v) for v in value.split("x")] if name == "picture_px" else value
        (tree if name in TrainSettings.__struct_fields__ else learn)[name] = parsed
    try:
        return msgspec.convert({**tree, "learn": learn}, TrainSettings, strict=False)
    except (msgspec.ValidationError, ValueError) as e:
        raise UserError(f"--set: {e}; see LearnSettings and TrainSettings for the names.") from e


def _walks(scenes: list[str], seeds: int, folder: Path) -> list[Path]:
    """The walks of folders and scenes by name; those that are not in `folder` yet are written now. Raises UserError."""
    found, wanted = [], []
    for scene in scenes:
        given = sorted(Path(scene).glob(f"*{SUFFIX}")) if Path(scene).is_dir() else []
        found += given
        if not given:
            wanted += _members(scene, seeds)
    missing = [name for name in wanted if not list(folder.glob(f"{_stem(name)}_*{SUFFIX}"))]
    if missing:
        command = [sys.executable, "-m", "ground_station.cli", "scenes", "walks", str(folder), "--pictures", "--walks",
                   "1", "--scenes", *missing]
        folder.mkdir(parents=True, exist_ok=True)
        done = subprocess.run(command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE,
                              text=True, check=False)
        if done.returncode:
            raise UserError(f"--scenes {' '.join(missing)}: no walks ({done.stderr.strip().splitlines()[-1:]}); check "
                            "the names.")
    return found + [path for name in wanted for path in sorted(folder.glob(f"{_stem(name)}_*{SUFFIX}"))]


def _members(scene: str, seeds: int) -> list[str]:
    if not scene.startswith(SPLIT):
        return [scene]
    for split in SPLITS:
        if scene == SPLIT + split:
            return [f"{PREFIX}{family}:{seed}" for seed in range(1, seeds + 1) for family in families_of(split)]
    raise UserError(f"--scenes {scene}: no such split; use one of {', '.join(SPLIT + s for s in SPLITS)}.")


def _stem(scene: str) -> str:
    return Path(scene).name.replace(":", "_")


def _train(run: TrainingRun, held_out: list[Path], epochs: int) -> list[dict[str, float]]:
    """Epochs until there are so many; per epoch the mean losses, the validation errors and the seconds, also kept in
    history.json."""
    kept = run.folder / "history.json"
    history: list[dict[str, float]] = json.loads(kept.read_text(encoding="utf-8"))[:run.epochs] if run.epochs else []
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(),
               TimeRemainingColumn())
    with SummaryWriter(str(run.folder / "log")) as log, Progress(*columns, console=Console(stderr=True)) as progress:
        task = progress.add_task("training", total=epochs, completed=run.epochs)
        while run.epochs < epochs:
            begin, losses = time.monotonic(), dict[str, list[float]]()
            run.epoch(lambda _, name, values, losses=losses: losses.setdefault(name, []).extend(values))  # type: ignore[misc]
            row = {name: float(np.mean(values)) for name, values in losses.items() if values}
            row |= {f"validation/{name}": v for name, v in run.validate(held_out).items()} if held_out else {}
            row |= {"epoch": float(run.epochs), "seconds": time.monotonic() - begin}
            for name, value in row.items():
                log.add_scalar(name, value, run.epochs)
            history.append(row)
            kept.write_text(json.dumps(history, indent=1) + "\n", encoding="utf-8")
            progress.update(task, completed=run.epochs, description=_told(row))
    return history


def _told(row: dict[str, float]) -> str:
    return " ".join(f"{name} {value:.3f}" for name, value in row.items() if name in (*NAMES, "photometric"))


def _table(history: list[dict[str, float]]) -> Table:
    names = list(dict.fromkeys(name for row in history for name in row))
    table = Table(*names)
    for row in history:
        table.add_row(*(f"{row[n]:.4g}" if n in row else "" for n in names))
    return table
