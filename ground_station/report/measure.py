"""The reconstruction against the truth, and the error distributions that the page shows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

from ground_station.report.run_data import RunData
from missions.frames import Array
from perception.evaluate import accuracy
from perception.evaluate.completeness import THRESHOLDS_M, completeness, distances_to_cloud
from perception.reconstruct.cloud import Cloud, on_grid, read_cloud

RESAMPLE_M = 0.03
"""C2M is taken on one point per 3 cm voxel: one point per pixel would weigh near, well-seen surface most."""


@dataclass(frozen=True)
class Measured:
    """Distances (m) of true samples to the cloud, and of cloud points to the true mesh."""

    samples_enu_m: Array
    c2c_m: Array
    points_enu_m: NDArray[np.float32]
    c2m_m: Array


def measure(data: RunData) -> Measured | None:
    """None, with a note, when the cloud or the truth is missing."""
    run = data.run
    samples, mesh = run.truth_samples, run.truth_mesh
    absent = [p.relative_to(run.root).as_posix() for p in (run.cloud, samples, mesh) if not p.is_file()]
    if absent:
        data.notes.append(f"{', '.join(absent)} missing: the reconstruction was not measured.")
        return None
    cloud = read_cloud(run.cloud)
    with np.load(samples) as stored:
        points = stored["points"].astype(np.float64)
    kept = _kept(cloud, data)
    surface = trimesh.load_mesh(mesh, process=False)
    distances = accuracy.signed_distances(kept.points_enu_m, surface.vertices, surface.faces)
    return Measured(points, distances_to_cloud(points, cloud.points_enu_m), kept.points_enu_m, distances)


def _kept(cloud: Cloud, data: RunData) -> Cloud:
    uniform = on_grid(cloud, max(RESAMPLE_M, data.mission.reconstruct.cloud_spacing_m))
    return uniform.select(data.region().contains(uniform.points_enu_m)) if len(uniform) else uniform


def c2c_numbers(measured: Measured | None) -> dict[str, Any]:
    """The `c2c` part of metrics.json."""
    if measured is None:
        return {"completeness": {f"{t:.2f}": None for t in THRESHOLDS_M}}
    return {"completeness": completeness(measured.c2c_m), "samples": len(measured.c2c_m)}


def c2m_numbers(measured: Measured | None) -> dict[str, Any]:
    """The `c2m` part of metrics.json: the thesis's equations over all points, then without bins, then trimmed."""
    distances = np.zeros(0) if measured is None else measured.c2m_m
    overall = accuracy.binned(*accuracy.histogram(distances))
    plain, trim = accuracy.exact(distances), accuracy.exact(accuracy.trimmed(distances))
    return {
        "mean_m": overall.mean_m, "rms_m": overall.rms_m, "within_2cm": overall.within_2cm, "points": overall.points,
        "bin_m": accuracy.BIN_M, "resampled_m": RESAMPLE_M,
        "median_m": float(np.median(np.abs(distances))) if len(distances) else None,
        "exact": {"mean_m": plain.mean_m, "rms_m": plain.rms_m, "within_2cm": plain.within_2cm},
        "trimmed_5cm": {"mean_m": trim.mean_m, "rms_m": trim.rms_m, "within_2cm": trim.within_2cm,
                        "share_kept": trim.points / plain.points if plain.points else None},
    }
