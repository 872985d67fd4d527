"""`swarmscan bench photographs RUN TRUTH`: how far the cameras of reconstructed photographs stand from the truth.

TRUTH is what `swarmscan bench photograph-set` wrote beside the pictures. The model is laid onto it by the similarity
that fits best, because nothing else is known of one without GPS.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap

from ground_station.csv_table import read_table
from ground_station.photograph_record import RECORD
from ground_station.report.run_data import read_run
from missions.console import print_rows
from missions.errors import UserError
from missions.frames import Array
from missions.run_folder import RunFolder

LIMIT_M = 0.5
"""Positions that fit the similarity; others are told by the largest error."""


def main(argv: Sequence[str]) -> int:
    """Run the benchmark; returns the exit code."""
    parser = argparse.ArgumentParser(prog="swarmscan bench photographs", description=__doc__)
    parser.add_argument("run", type=Path, help="what 'swarmscan reconstruct PICTURES' made")
    parser.add_argument("truth", type=Path, help="CSV with picture, east_m, north_m, up_m")
    parser.add_argument("--json", action="store_true", help="one JSON document instead of a table")
    options = parser.parse_args(argv)
    print_rows([_row(RunFolder(options.run), options.truth)], options.json)
    return 0


def _row(run: RunFolder, truth: Path) -> dict[str, object]:
    path = run.root / RECORD
    if not path.is_file():
        raise UserError(f"{path}: missing; run 'swarmscan reconstruct PICTURES --out {run.root}' first.")
    record: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    found, true = _positions(run, truth)
    fit: Any = pycolmap.estimate_sim3d_robust(found, true, pycolmap.RANSACOptions(max_error=LIMIT_M, random_seed=1))
    if fit is None:
        raise UserError(f"{truth}: no similarity lays the model onto these positions; give those of its own pictures.")
    matrix = fit["tgt_from_src"].matrix()
    error_m = np.linalg.norm(found @ matrix[:, :3].T + matrix[:, 3] - true, axis=1)
    camera, main = record["cameras"][0], record["components"][0]
    return {"pictures": record["photographs"], "in_the_model": len(found), "mean_m": round(float(error_m.mean()), 4),
            "median_m": round(float(np.median(error_m)), 4), "max_m": round(float(error_m.max()), 3),
            "focal_px": round(camera["fx_px"], 1), "cx_px": round(camera["cx_px"], 1),
            "cy_px": round(camera["cy_px"], 1), "k1": round(camera["distortion"][0], 4),
            "reprojection_px": main["reprojection_px"]}


def _positions(run: RunFolder, truth: Path) -> tuple[Array, Array]:
    """(n, 3) of the pictures in the model, and where they were taken."""
    rows, _ = read_table(truth)
    true = {Path(row["picture"]).stem: [float(row[c]) for c in ("east_m", "north_m", "up_m")] for row in rows}
    views = [(p.path.stem.split("-", 3)[3], p.position_enu_m) for p in read_run(run).survey_pictures()]
    known = [(position, true[stem]) for stem, position in views if stem in true]
    if len(known) < len(views):
        raise UserError(f"{truth}: names {len(known)} of the {len(views)} pictures of {run.root}; give its own file.")
    found, placed = zip(*known, strict=True)
    return np.array(found), np.array(placed)
