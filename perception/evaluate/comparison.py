"""A cloud beside its reference: distances both ways, and every figure that is told of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from missions.frames import Array
from perception.evaluate import accuracy
from perception.evaluate.completeness import THRESHOLDS_M, completeness, distances_to_cloud
from perception.evaluate.reference import Reference
from perception.reconstruct.cloud import Cloud, on_grid

RESAMPLE_M = 0.03
"""C2M is also taken on one point per 3 cm voxel: one point per pixel would weigh near, well-seen surface most."""
MISSING_M = 0.25
"""Surface farther than this from the cloud counts as not reconstructed."""


@dataclass(frozen=True)
class Comparison:
    """Distances (m) of the reference's samples to the cloud, and of the cloud's points, as it is and sampled
    uniformly, to the reference's mesh, signed."""

    reference: Reference
    c2c_m: Array
    cloud: Cloud
    c2m_m: Array
    uniform: Cloud
    uniform_c2m_m: Array
    uniform_triangle: NDArray[np.int64]
    """(k,) the mesh's triangle that is nearest to each point of `uniform`."""
    spacing_m: float


def compare(cloud: Cloud, reference: Reference, spacing_m: float = RESAMPLE_M) -> Comparison:
    """Cost: n log n in samples and points, and one search in the triangles' tree for each point."""
    uniform = on_grid(cloud, spacing_m)
    mesh = reference.vertices_enu_m, reference.triangles
    sampled, triangle = accuracy.distances_to_mesh(uniform.points_enu_m, *mesh)
    if len(uniform) == len(cloud):
        cloud, as_it_is = uniform, sampled
    else:
        as_it_is, _ = accuracy.distances_to_mesh(cloud.points_enu_m, *mesh)
    return Comparison(reference, distances_to_cloud(reference.samples_enu_m, cloud.points_enu_m), cloud, as_it_is,
                      uniform, sampled, triangle, spacing_m)


def c2c_numbers(c: Comparison | None) -> dict[str, Any]:
    """Completeness by distance, the share that was not reconstructed, and how many samples tell so."""
    if c is None:
        return {"completeness": {f"{t:.2f}": None for t in THRESHOLDS_M}}
    found = completeness(c.c2c_m)
    whole = found[f"{MISSING_M:.2f}"]
    return {"completeness": found, "missing": None if whole is None else 1.0 - whole, "samples": len(c.c2c_m)}


def c2m_numbers(c: Comparison | None) -> dict[str, Any]:
    """Errors of the uniform sampling by the thesis's equations, then without bins, then trimmed; of the cloud as it is
    without bins and by the equations; F-score by distance."""
    distances = np.zeros(0) if c is None else c.uniform_c2m_m
    as_it_is = np.zeros(0) if c is None else c.c2m_m
    overall = accuracy.binned(*accuracy.histogram(distances))
    trim = accuracy.exact(accuracy.trimmed(distances))
    return {
        "mean_m": overall.mean_m, "rms_m": overall.rms_m, "within_2cm": overall.within_2cm, "points": overall.points,
        "bin_m": accuracy.BIN_M, "resampled_m": RESAMPLE_M if c is None else c.spacing_m,
        "median_m": _median(distances), "exact": _figures(distances),
        "as_it_is": _figures(as_it_is) | {"binned": _binned(as_it_is)},
        "trimmed_5cm": {"mean_m": trim.mean_m, "rms_m": trim.rms_m, "within_2cm": trim.within_2cm,
                        "share_kept": trim.points / len(distances) if len(distances) else None},
        "f_score": {f"{t:.2f}": None if c is None else f_score(c, t) for t in THRESHOLDS_M},
    }


def f_score(c: Comparison, threshold_m: float) -> float | None:
    """Harmonic mean of the share of the uniform cloud within a distance of the mesh and of the samples within it of the
    cloud (Knapitsch et al., SIGGRAPH 2017). None when there is nothing to compare."""
    if not len(c.uniform_c2m_m) or not len(c.c2c_m):
        return None
    precision = float(np.mean(np.abs(c.uniform_c2m_m) <= threshold_m))
    recall = float(np.mean(c.c2c_m <= threshold_m))
    return 2.0 * precision * recall / max(precision + recall, 1e-12)


def reach_numbers(c: Comparison, reachable: NDArray[np.bool_]) -> dict[str, float | None]:
    """Share of the samples that are within reach of enough pictures (n,); completeness at 0.25 m of these; completeness
    of all over that share."""
    share = float(reachable.mean()) if len(reachable) else None
    whole = completeness(c.c2c_m, (MISSING_M,))[f"{MISSING_M:.2f}"]
    return {"share": share, "completeness": completeness(c.c2c_m[reachable], (MISSING_M,))[f"{MISSING_M:.2f}"],
            "relative": whole / share if share and whole is not None else None}


def part_numbers(c: Comparison) -> list[dict[str, Any]]:
    """For each part of the object, largest first: share of the surface, completeness at 0.25 m, error of the points of
    the uniform sampling that are nearest to it."""
    reference = c.reference
    point_part = reference.triangle_part[c.uniform_triangle]
    rows = []
    for number, name in enumerate(reference.parts):
        samples = reference.sample_part == number
        errors = c.uniform_c2m_m[point_part == number]
        rows.append({"part": name, "share": float(samples.mean()) if len(samples) else None,
                     "completeness": float(np.mean(c.c2c_m[samples] <= MISSING_M)) if samples.any() else None,
                     "points": len(errors), **_figures(errors)})
    return sorted(rows, key=lambda row: -(row["share"] or 0.0))


def confidence_numbers(c: Comparison) -> list[dict[str, Any]]:
    """Error of the cloud as it is by confidence (agreeing depth maps), with what a filter at that number keeps."""
    rows = []
    for level in np.unique(c.cloud.confidence).tolist():
        kept = c.cloud.confidence >= level
        rows.append({"confidence": level, "kept": float(kept.mean()),
                     **_figures(c.c2m_m[c.cloud.confidence == level])})
    return rows


def _binned(distances_m: Array) -> dict[str, float | None]:
    found = accuracy.binned(*accuracy.histogram(distances_m))
    return {"mean_m": found.mean_m, "rms_m": found.rms_m, "within_2cm": found.within_2cm}


def _figures(distances_m: Array) -> dict[str, float | None]:
    plain = accuracy.exact(distances_m)
    return {"mean_m": plain.mean_m, "rms_m": plain.rms_m, "median_m": _median(distances_m),
            "within_2cm": plain.within_2cm}


def _median(distances_m: Array) -> float | None:
    return float(np.median(np.abs(distances_m))) if len(distances_m) else None
