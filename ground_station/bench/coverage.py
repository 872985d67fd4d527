"""`swarmscan bench coverage`: coverage as methods estimate it without truth, beside true coverage, and what stopping
where it no longer pays gives up and saves.

Files are what `swarmscan bench nbv --json` printed; of their runs those of one vehicle whose method estimates count.
True coverage is taken relative to the ceiling, since the estimate is of what can be seen at all, and as it is.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np
from rich.table import Table
from scipy.optimize import minimize_scalar

from missions.console import print_result
from missions.errors import UserError
from missions.frames import Array
from planning.nbv.coverage import MISSING_WEIGHT

TOLERANCE = 0.05


class Run(msgspec.Struct, frozen=True):
    """What is needed of a run."""

    scene: str
    method: str
    start: int
    vehicles: int
    ceiling: float
    stopped_at: int | None
    curve: list[float]
    curve_metres: list[float]
    estimates: list[float]

    @property
    def true_shares(self) -> Array:
        """(n,) coverage over the ceiling when each estimate was made."""
        return np.array(self.curve[: len(self.estimates)]) / self.ceiling


class _Document(msgspec.Struct, frozen=True):
    rows: list[Run]


@dataclass(frozen=True)
class Judged:
    """One run at its last estimate. Errors are estimates minus shares; what stopping gives up and saves is null where
    the method never asked to stop."""

    scene: str
    method: str
    start: int
    estimate: float
    of_ceiling: float
    of_all: float
    error: float
    error_of_all: float
    mean_error: float
    """Mean absolute error over all estimates of the run."""
    stopped_at: int | None
    given_up: float | None
    """Share of the ceiling that was covered after the method would have stopped."""
    saved: float | None
    """Share of all metres that were flown after that."""


def main(argv: Sequence[str]) -> int:
    """Run the benchmark; returns the exit code."""
    parser = argparse.ArgumentParser(prog="swarmscan bench coverage", description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("files", nargs="+", type=Path, metavar="FILE")
    parser.add_argument("--fit", action="store_true", help="find planning.nbv.coverage.MISSING_WEIGHT")
    parser.add_argument("--json", action="store_true", help="print one JSON document")
    options = parser.parse_args(argv)
    runs = [run for path in options.files for run in read_runs(path)]
    if not runs:
        raise UserError(f"{options.files[0]}: no run of one vehicle with estimates is in it; let 'swarmscan bench nbv "
                        "--methods swarmscan --json' write it.")
    rows = [judged(run) for run in runs]
    errors = np.abs([row.error for row in rows])
    document = {"runs": rows, "mean_absolute_error": float(errors.mean()), "worst": float(errors.max()),
                "within_tolerance": int((errors <= TOLERANCE).sum()),
                "missing_weight": fitted_weight(runs) if options.fit else MISSING_WEIGHT}
    print_result(document, _table(document, rows), options.json)
    return 0


def read_runs(path: Path) -> list[Run]:
    """The runs in a file that can be judged. Raises UserError."""
    try:
        document = msgspec.json.decode(path.read_bytes(), type=_Document)
    except (OSError, msgspec.DecodeError) as e:
        raise UserError(f"{path}: not what 'swarmscan bench nbv --json' prints ({e}); give such a file.") from e
    return [run for run in document.rows if run.vehicles == 1 and any(run.estimates)]


def judged(run: Run) -> Judged:
    """A run's last estimate, and where it would have stopped."""
    truth, last = run.true_shares, len(run.estimates) - 1
    estimate, of_ceiling, of_all = run.estimates[last], float(truth[last]), run.curve[last]
    stop = None if run.stopped_at is None else run.stopped_at - 1
    return Judged(
        run.scene, run.method, run.start, estimate, of_ceiling, of_all, estimate - of_ceiling, estimate - of_all,
        float(np.abs(np.array(run.estimates) - truth).mean()), run.stopped_at,
        None if stop is None else (run.curve[-1] - run.curve[stop]) / run.ceiling,
        None if stop is None else 1.0 - run.curve_metres[stop] / max(run.curve_metres[-1], 1e-9))


def fitted_weight(runs: list[Run]) -> float:
    """The weight of missing surface with which the estimates of the second halves of the runs are nearest to the truth
    (least squares)."""
    halves = [slice(len(run.estimates) // 2, None) for run in runs]
    estimates = np.concatenate([np.array(run.estimates)[half] for run, half in zip(runs, halves, strict=True)])
    truth = np.concatenate([run.true_shares[half] for run, half in zip(runs, halves, strict=True)])
    missing = (1.0 / np.maximum(estimates, 1e-6) - 1.0) / MISSING_WEIGHT
    found = minimize_scalar(lambda weight: float(((1.0 / (1.0 + weight * missing) - truth) ** 2).sum()), (0.1, 1.0))
    return float(found.x)


def _table(document: dict[str, object], rows: list[Judged]) -> Table:
    table = Table(title="Coverage estimated without truth, at the last decision",
                  caption=f"error of the estimate: mean {document['mean_absolute_error']:.3f}, worst "
                          f"{document['worst']:.3f}, {document['within_tolerance']} of {len(rows)} within "
                          f"{TOLERANCE:g}; weight of missing surface {document['missing_weight']:.3f}")
    for heading in ("scene", "method", "start", "estimate", "of ceiling", "of all", "error", "error of all",
                    "mean error", "stops at", "gives up", "saves"):
        table.add_column(heading, justify="left" if heading in ("scene", "method") else "right")
    for r in rows:
        stop = ("–",) * 3 if r.stopped_at is None else (str(r.stopped_at), f"{r.given_up:.3f}", f"{r.saved:.2f}")
        table.add_row(r.scene, r.method, str(r.start), f"{r.estimate:.3f}", f"{r.of_ceiling:.3f}", f"{r.of_all:.3f}",
                      f"{r.error:+.3f}", f"{r.error_of_all:+.3f}", f"{r.mean_error:.3f}", *stop)
    return table
