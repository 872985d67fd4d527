"""What follows a flight: `swarmscan reconstruct`, `evaluate` and `report`, each on a run folder, each repeatable."""

from __future__ import annotations

import argparse
import json
import logging
import shutil
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from ground_station import cloud_evaluation
from ground_station.report.measure import measure
from ground_station.report.metrics import assemble
from ground_station.report.page import write_page
from ground_station.report.run_data import RunData, read_run
from missions.errors import UserError
from missions.process import run_process
from missions.run_folder import RunFolder
from perception.reconstruct.alignment import align
from perception.reconstruct.bundle import Accuracy
from perception.reconstruct.cloud import write_cloud
from perception.reconstruct.mesh import poisson_mesh, write_mesh
from perception.reconstruct.pictures import SurveyPicture
from perception.reconstruct.pipeline import Settings, reconstruct

log = logging.getLogger(__name__)

Tell = Callable[[str, int, int], None]


def reconstruct_run(run: RunFolder, keep_depth: bool = False,
                    tell: Tell = lambda stage, done, total: None) -> dict[str, Any]:
    """Survey pictures to aligned poses, cloud.ply and mesh.ply. Depth maps stay in depth/ until it is done, and after
    it on request.

    Returns counts and seconds. Raises UserError when there are too few pictures or one cannot be read.
    """
    started = time.monotonic()
    data = read_run(run)
    depth_folder = run.root / "depth"
    pictures = _aligned(data, tell)
    cloud = reconstruct(pictures, data.region(), settings(data), depth_folder, tell)
    log.info("%d pictures gave %d points in %.1f s", len(pictures), len(cloud), time.monotonic() - started)
    if not len(cloud):
        raise UserError(f"{run.views_csv}: fewer than {data.mission.reconstruct.min_confidence} depth maps agree on "
                        "any point; lower reconstruct.min_confidence in mission.toml or fly more views.")
    write_cloud(cloud, run.cloud)
    result: dict[str, Any] = {"pictures": len(pictures), "points": len(cloud), "cloud": str(run.cloud)}
    if data.mission.reconstruct.mesh:
        tell("mesh", 0, 1)
        mesh = poisson_mesh(cloud)
        write_mesh(mesh, run.mesh)
        tell("mesh", 1, 1)
        result |= {"triangles": len(mesh.triangles), "mesh": str(run.mesh)}
    if not keep_depth:
        shutil.rmtree(depth_folder, ignore_errors=True)
    return _finish(run, "reconstruct", started, result)


def _aligned(data: RunData, tell: Tell) -> list[SurveyPicture]:
    """The survey's pictures, with aligned poses where the mission asks for them and poses are not exact."""
    pictures, mission = data.survey_pictures(), data.mission
    accuracy = Accuracy.of(mission.camera)
    if accuracy.exact or not mission.reconstruct.align:
        shutil.rmtree(data.run.alignment, ignore_errors=True)
        return pictures
    alignment = align(pictures, accuracy, mission.survey.distance_m, data.run.alignment, settings(data).threads, tell)
    log.info("%d of %d pictures aligned, reprojection error %s px", alignment.numbers["registered"], len(pictures),
             alignment.numbers["reprojection_px"])
    return alignment.pictures


def evaluate_run(run: RunFolder) -> dict[str, Any]:
    """Measure the cloud against the truth and write metrics.json, which is returned; null where unknown."""
    started = time.monotonic()
    data = read_run(run)
    measured = measure(data)
    _finish(run, "evaluate", started, {})
    return _write_metrics(data, assemble(data, measured))


def report_run(run: RunFolder) -> dict[str, Any]:
    """Write report.html from whatever the run folder holds, and add the stage's own time to metrics.json."""
    started = time.monotonic()
    data = read_run(run)
    measured = measure(data)
    write_page(data, measured, assemble(data, measured))
    result = _finish(run, "report", started, {"report": str(run.report)})
    _write_metrics(data, assemble(data, measured))
    return result


def settings(data: RunData) -> Settings:
    """Reconstruction settings of the run's mission."""
    spec = data.mission.reconstruct
    return Settings(depth_width_px=min(spec.depth_width_px, data.mission.camera.survey_px[0]),
                    pairs_per_picture=spec.pairs_per_picture, min_confidence=spec.min_confidence,
                    spacing_m=spec.cloud_spacing_m, distance_m=data.mission.survey.distance_m)


def _finish(run: RunFolder, name: str, started: float, result: dict[str, Any]) -> dict[str, Any]:
    wall_s = round(time.monotonic() - started, 2)
    run.write_process_record(name, wall_s=wall_s)
    return {**result, "wall_s": wall_s}


def _write_metrics(data: RunData, document: dict[str, Any]) -> dict[str, Any]:
    data.run.metrics.write_text(json.dumps(document, indent=1), encoding="utf-8")
    return document


def main_reconstruct(argv: list[str]) -> int:
    """`swarmscan reconstruct RUN`."""
    options = _options("reconstruct", argv)
    with _progress() as tell:
        result = reconstruct_run(_run_folder(options), options.keep_depth, tell)
    _print(options, result, f"{result['points']} points from {result['pictures']} pictures in "
                            f"{result['wall_s']:.0f} s: {result['cloud']}")
    return 0


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
    c2m = document["c2m"]
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
        result = report_run(_run_folder(options))
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
    cloud = " or a cloud (PLY, PCD, XYZ, PTS)" if name == "evaluate" else ""
    parser.add_argument("target", metavar="RUN", help=f"the run folder that 'swarmscan fly' made{cloud}")
    parser.add_argument("--json", action="store_true", help="print one JSON document on stdout")
    if name == "reconstruct":
        parser.add_argument("--keep-depth", "--keep", action="store_true", help="keep the depth maps in RUN/depth")
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
