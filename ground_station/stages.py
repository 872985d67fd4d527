"""What follows a flight: `swarmscan reconstruct`, `evaluate` and `report`, each on a run folder, each repeatable."""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from ground_station import cloud_evaluation, photograph_stage
from ground_station.control_file import copy_control, read_control
from ground_station.reconstruction import Tell, reconstruct_run
from ground_station.report.measure import Measured, measure
from ground_station.report.metrics import assemble
from ground_station.report.page import draw, write_page
from ground_station.report.run_data import RunData, read_run
from missions.errors import UserError
from missions.process import run_process
from missions.run_folder import RunFolder


def evaluate_run(run: RunFolder) -> dict[str, Any]:
    """Measure the cloud against the truth and write metrics.json, which is returned; null where unknown."""
    return _write_metrics(*_measured(run))


def report_run(run: RunFolder, ready: Callable[[], object] = lambda: None) -> dict[str, Any]:
    """Measure, and write report.html from whatever the run folder holds; metrics.json also where that fails.

    ready: returns when everything but the cloud, which is there before, is in the run folder.
    """
    data, measured = _measured(run)
    _write_metrics(data, measured)
    started = time.monotonic()
    drawn = draw(data, measured)
    waits = time.monotonic()
    ready()
    started += time.monotonic() - waits
    write_page(data, measured, _write_metrics(data, measured), drawn)
    result = _finish(run, "report", started, {"report": str(run.report)})
    _write_metrics(data, measured)
    return result


def _measured(run: RunFolder) -> tuple[RunData, Measured | None]:
    started = time.monotonic()
    data = read_run(run)
    measured = measure(data)
    _finish(run, "evaluate", started, {})
    return data, measured


def _finish(run: RunFolder, name: str, started: float, result: dict[str, Any]) -> dict[str, Any]:
    wall_s = round(time.monotonic() - started, 2)
    run.write_process_record(name, wall_s=wall_s)
    return {**result, "wall_s": wall_s}


def _write_metrics(data: RunData, measured: Measured | None) -> dict[str, Any]:
    document = assemble(data, measured)
    data.run.metrics.write_text(json.dumps(document, indent=1), encoding="utf-8")
    return document


def main_reconstruct(argv: list[str]) -> int:
    """`swarmscan reconstruct RUN`, or `swarmscan reconstruct PICTURES` on a folder of photographs."""
    options = _options("reconstruct", argv)
    if photograph_stage.asked_for(options):
        return photograph_stage.main(options, _progress)
    if options.control is not None:
        run = _run_folder(options)
        copy_control(read_control(options.control, options.control_crs), read_run(run).mission.site.anchor,
                     run.control_points)
    with _progress() as tell:
        result = reconstruct_run(_run_folder(options), options.keep_depth, tell,
                                 _announce if options.announce else lambda: None)
    _print(options, result, f"{result['points']} points from {result['pictures']} pictures in "
                            f"{result['wall_s']:.0f} s: {result['cloud']}")
    return 0


def _announce() -> None:
    sys.stdout.write("the cloud is there\n")
    sys.stdout.flush()


def main_evaluate(argv: list[str]) -> int:
    """`swarmscan evaluate RUN`, or `swarmscan evaluate CLOUD --reference MESH`."""
    options = _options("evaluate", argv)
    asked = None if Path(options.target).is_dir() else cloud_evaluation.request(options)
    with _progress() as tell:
        tell("measure", 0, 1)
        document = evaluate_run(_run_folder(options)) if asked is None else cloud_evaluation.evaluate_cloud(asked)
        tell("measure", 1, 1)
    _print(options, document, "\n".join([*_findings(document), *document["notes"]]))
    return 0


def _findings(document: dict[str, Any]) -> Iterator[str]:
    """What was measured, a line each."""
    for t, v in document["c2c"]["completeness"].items():
        yield f"C2C completeness at {t} m: {_share(v)}"
    reach, c2m = document.get("reachable"), document["c2m"]
    if reach is not None:
        yield (f"  three pictures from within reach could show {_share(reach['share'])} of the surface; "
               f"{_share(reach['completeness'])} of that is complete at 0.25 m")
    for name, v in ((f"on a {100 * c2m['resampled_m']:g} cm grid", c2m), ("as it is", c2m["as_it_is"])):
        yield (f"C2M {name}: mean {_metres(v['mean_m'])}, median {_metres(v['median_m'])}, RMS {_metres(v['rms_m'])}, "
               f"within 2 cm {_share(v['within_2cm'])}")
    for part in document["parts"] if len(document["parts"]) > 1 else []:
        yield (f"  {part['part']} ({_share(part['share'])} of the surface): completeness "
               f"{_share(part['completeness'])}, C2M mean {_metres(part['mean_m'])}, RMS {_metres(part['rms_m'])}")


def main_report(argv: list[str]) -> int:
    """`swarmscan report RUN`."""
    options = _options("report", argv)
    with _progress() as tell:
        tell("report", 0, 1)
        result = report_run(_run_folder(options), sys.stdin.read if options.wait else lambda: None)
        tell("report", 1, 1)
    _print(options, result, result["report"])
    return 0


MAINS = {"reconstruct": main_reconstruct, "evaluate": main_evaluate, "report": main_report}


def main(argv: list[str] | None = None) -> int:
    """One stage in a process of its own: `python -m ground_station.stages STAGE RUN ...`. 2 means bad input."""
    arguments = sys.argv[1:] if argv is None else argv
    return run_process(lambda: _stage(arguments))


def _stage(arguments: list[str]) -> int:
    if not arguments or arguments[0] not in MAINS:
        raise UserError(f"stage {arguments[0] if arguments else '(none)'}: use one of: {', '.join(MAINS)}.")
    return MAINS[arguments[0]](arguments[1:])


def _options(name: str, argv: list[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog=f"swarmscan {name}", description=(MAINS[name].__doc__ or "").strip("`"))
    others = {"evaluate": ", or a cloud (PLY, PCD, XYZ, PTS)", "reconstruct": ", or a folder of photographs"}
    parser.add_argument("target", metavar="RUN", help=f"the run folder that 'swarmscan fly' made{others.get(name, '')}")
    parser.add_argument("--json", action="store_true", help="print one JSON document on stdout")
    if name == "reconstruct":
        parser.add_argument("--keep-depth", "--keep", action="store_true", help="keep the depth maps in RUN/depth")
        parser.add_argument("--control", type=Path, metavar="CSV", help="ground control and check points")
        parser.add_argument("--control-crs", type=int, metavar="EPSG", help="projected CRS of the points' x, y, z")
        parser.add_argument("--announce", action="store_true", help="say on stdout when the cloud is there")
        photograph_stage.add_options(parser)
    if name == "report":
        parser.add_argument("--wait", action="store_true", help="measure, then wait for the end of stdin")
    if name == "evaluate":
        cloud_evaluation.add_options(parser)
    return parser.parse_args(argv)


def _run_folder(options: argparse.Namespace) -> RunFolder:
    root = Path(options.target)
    if not root.is_dir():
        raise UserError(f"{root}: no such run folder; give the folder that 'swarmscan fly' made.")
    return RunFolder(root.resolve())


@contextmanager
def _progress() -> Iterator[Tell]:
    """A bar per step with the time left, on stderr."""
    columns = (TextColumn("{task.description:<12}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(),
               TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True)) as bars:
        tasks: dict[str, Any] = {}

        def tell(stage: str, done: int, total: int) -> None:
            if stage not in tasks:
                tasks[stage] = bars.add_task(stage, total=total)
            bars.update(tasks[stage], completed=done)

        yield tell


def _print(options: argparse.Namespace, document: dict[str, Any], text: str) -> None:
    sys.stdout.write((json.dumps(document, indent=1) if options.json else text) + "\n")


def _share(value: float | None) -> str:
    return "unknown" if value is None else f"{value:.1%}"


def _metres(value: float | None) -> str:
    return "unknown" if value is None else f"{1000 * value:.1f} mm"


if __name__ == "__main__":
    sys.exit(main())
