"""A cloud from anywhere against a reference mesh: `swarmscan evaluate CLOUD --reference MESH`."""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import open3d as o3d
from numpy.typing import NDArray
from PIL import Image

from ground_station.report import renderings
from missions.errors import UserError
from perception.evaluate.alignment import UNMOVED, Alignment, by_icp, by_markers, read_markers
from perception.evaluate.comparison import (
    RESAMPLE_M,
    Comparison,
    c2c_numbers,
    c2m_numbers,
    compare,
    confidence_numbers,
    part_numbers,
)
from perception.evaluate.ground import without_ground
from perception.evaluate.reference import SAMPLES, Reference, read_reference
from perception.reconstruct.cloud import Cloud, on_grid

ICP_SPACING_M = 0.05
FARTHEST_M = 10_000.0
"""Distances are reckoned in single precision, which tells places farther from the origin to a millimetre only."""
ABOVE_GROUND_M = 0.10
"""With the ground left out, what lies less than this above it goes too."""


@dataclass(frozen=True)
class Request:
    """What to compare, and how."""

    cloud: Path
    reference: Path
    align: str = "none"
    markers: Path | None = None
    scale: bool = False
    ground_up_m: float | None = None
    """Height of the ground, when it is to be left out."""
    min_confidence: int = 0
    spacing_m: float = RESAMPLE_M
    samples: int = SAMPLES
    pictures: Path | None = None
    """Folder for pictures of the cloud and the map of what is missing."""


def add_options(parser: argparse.ArgumentParser) -> None:
    """What is asked of a cloud and not of a run."""
    cloud = parser.add_argument_group("a cloud against a mesh")
    cloud.add_argument("--reference", metavar="MESH", type=Path, help="PLY, OBJ, STL, OFF or GLB, in metres")
    cloud.add_argument("--align", choices=("none", "icp", "markers"), default="none",
                       help="how the cloud is brought into the reference's frame (default: it is in it)")
    cloud.add_argument("--markers", metavar="CSV", type=Path, help="the same markers in the cloud and in the reference")
    cloud.add_argument("--scale", action="store_true", help="markers also give the cloud's scale")
    cloud.add_argument("--without-ground", metavar="UP_M", type=float, dest="ground_up_m",
                       help="leave out what lies lower than 0.1 m above this height, and up to 0.25 m what is nearer "
                       "to the ground than to the reference")
    cloud.add_argument("--min-confidence", metavar="N", type=int, default=0, help="points of less are left out")
    cloud.add_argument("--spacing", metavar="M", type=float, default=RESAMPLE_M, dest="spacing_m",
                       help="grid of the uniform sampling (default 0.03)")
    cloud.add_argument("--pictures", metavar="FOLDER", type=Path,
                       help="write the cloud in colour, by confidence and by error, and what is missing, from three "
                       "sides, and the surface coloured by what is missing as missing.ply")
    cloud.add_argument("--samples", metavar="N", type=int, default=SAMPLES, help="on the reference (default 100000)")


def request(options: argparse.Namespace) -> Request:
    """The options as a request. Raises UserError where they do not go together."""
    if not Path(options.target).is_file():
        raise UserError(f"{options.target}: no such run folder and no such cloud; give the folder that 'swarmscan fly' "
                        "made, or a cloud as PLY, PCD, XYZ or PTS.")
    if options.reference is None:
        raise UserError(f"{options.target}: a cloud is measured against a mesh; give --reference MESH, or the run "
                        "folder that 'swarmscan fly' made.")
    if (options.align == "markers") != (options.markers is not None):
        raise UserError("--align markers and --markers CSV belong together; give both or neither.")
    if options.scale and options.align != "markers":
        raise UserError("--scale: only markers tell the scale; add --align markers --markers CSV.")
    if options.spacing_m <= 0.0 or options.samples < 1:
        raise UserError("--spacing and --samples: give numbers above 0.")
    return Request(Path(options.target), options.reference, options.align, options.markers, options.scale,
                   options.ground_up_m, options.min_confidence, options.spacing_m, options.samples, options.pictures)


def evaluate_cloud(asked: Request) -> dict[str, Any]:
    """The document. Raises UserError for files that cannot be read and clouds with nothing left to measure."""
    reference = read_reference(asked.reference, asked.samples)
    _check_near(asked.reference, reference.vertices_enu_m)
    cloud, alignment = _aligned(read_any_cloud(asked.cloud), reference, asked)
    if asked.ground_up_m is not None:
        least = asked.ground_up_m + ABOVE_GROUND_M
        cloud = without_ground(cloud.select(cloud.points_enu_m[:, 2] >= least), reference, asked.ground_up_m)
        reference = reference.above(least)
    cloud = cloud.select(cloud.confidence >= asked.min_confidence)
    if not len(cloud):
        raise UserError(f"{asked.cloud}: no point is left to measure; lower --min-confidence or mend --without-ground.")
    found = compare(cloud, reference, asked.spacing_m)
    if asked.pictures is not None:
        write_pictures(asked.pictures, found)
    return document(asked, found, alignment)


def write_pictures(folder: Path, found: Comparison) -> None:
    """What the report of a run shows, as PNG files; missing.ply are the reference's samples in the same colours, with
    their distance to the cloud as `distance_m`."""
    folder.mkdir(parents=True, exist_ok=True)
    shown, spacing_m = renderings.thinned(found.cloud, found.spacing_m)
    least = int(found.cloud.confidence.min(initial=255))
    for name, sides in {"colour": renderings.in_colour(shown, spacing_m),
                        "confidence": renderings.by_confidence(shown, spacing_m, least),
                        "error": renderings.by_error(found), "missing": renderings.missing(found)}.items():
        for number, (_, picture) in enumerate(sides, start=1):
            Image.fromarray(picture).save(folder / f"{name}_{number}.png")
    surface = o3d.t.geometry.PointCloud()
    surface.point["positions"] = o3d.core.Tensor.from_numpy(found.reference.samples_enu_m.astype(np.float32))
    surface.point["colors"] = o3d.core.Tensor.from_numpy(renderings.missing_colours(found))
    surface.point["distance_m"] = o3d.core.Tensor.from_numpy(found.c2c_m.astype(np.float32)[:, None])
    o3d.t.io.write_point_cloud(folder / "missing.ply", surface)


def document(asked: Request, found: Comparison, alignment: Alignment) -> dict[str, Any]:
    """Shares are 0-1, lengths metres."""
    return {
        "cloud": str(asked.cloud), "reference": str(asked.reference), "points": len(found.cloud),
        "alignment": {"method": alignment.method, "reference_from_cloud": alignment.reference_from_cloud.tolist(),
                      "rms_m": alignment.rms_m, "pairs": alignment.pairs},
        "c2c": c2c_numbers(found), "c2m": c2m_numbers(found), "parts": part_numbers(found),
        "confidence": confidence_numbers(found),
        "notes": [] if asked.ground_up_m is None else [f"ground left out below {asked.ground_up_m:g} m"],
    }


def read_any_cloud(path: Path) -> Cloud:
    """Points of a PLY, PCD, XYZ or PTS file; what it has no colour, normal or confidence for gets none."""
    with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
        data = o3d.t.io.read_point_cloud(path)
    if "positions" not in data.point or not len(data.point["positions"]):
        raise UserError(f"{path}: holds no points that can be read; give a cloud as PLY, PCD, XYZ or PTS.")
    positions = data.point["positions"].numpy()
    finite = np.isfinite(positions).all(axis=1)
    _check_near(path, positions[finite])
    points = positions.astype(np.float32)
    n = len(points)
    colours = _attribute(data, "colors", np.zeros((n, 3))).astype(np.uint8)
    normals = _attribute(data, "normals", np.zeros((n, 3))).astype(np.float32)
    confidence = _attribute(data, "confidence", np.ones((n, 1)))[:, 0].clip(0, 255).astype(np.uint8)
    return Cloud(points, colours, normals, confidence).select(finite)


def _check_near(path: Path, points_m: NDArray[Any]) -> None:
    if np.abs(points_m).max(initial=0.0) > FARTHEST_M:
        raise UserError(f"{path}: holds places more than {FARTHEST_M / 1000:g} km from the origin, where millimetres "
                        "are lost; take the same offset off the coordinates of cloud and reference.")


def _attribute(data: o3d.t.geometry.PointCloud, name: str, otherwise: Any) -> Any:
    return data.point[name].numpy() if name in data.point else otherwise


def _aligned(cloud: Cloud, reference: Reference, asked: Request) -> tuple[Cloud, Alignment]:
    alignment = UNMOVED
    if asked.align == "icp":
        thin = on_grid(cloud, ICP_SPACING_M).points_enu_m.astype(np.float64)
        alignment = by_icp(thin, reference.samples_enu_m, reference.normals)
    elif asked.markers is not None:
        alignment = by_markers(*read_markers(asked.markers), scale=asked.scale)
    if alignment is UNMOVED:
        return cloud, alignment
    points = alignment.apply(cloud.points_enu_m.astype(np.float64)).astype(np.float32)
    turn = alignment.reference_from_cloud[:3, :3] / np.cbrt(np.linalg.det(alignment.reference_from_cloud[:3, :3]))
    return replace(cloud, points_enu_m=points, normals=(cloud.normals @ turn.T).astype(np.float32)), alignment
