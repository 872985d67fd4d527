"""`swarmscan export RUN`: what a finished run made, in the formats of other programs."""

from __future__ import annotations

import argparse
import json
import math
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from ground_station.report.run_data import RunData, read_run
from missions.console import print_result
from missions.errors import UserError
from missions.frames import Site
from missions.run_folder import RunFolder
from perception.products.geotiff import write_dsm, write_orthophoto
from perception.products.model_files import read_model
from perception.products.rasters import Raster, seen_from_above
from perception.reconstruct.aligned_poses import alignment_numbers, read_poses
from perception.reconstruct.bundle import Accuracy
from perception.reconstruct.camera_reference import write_geo, write_metashape
from perception.reconstruct.cloud import Cloud, read_cloud
from perception.reconstruct.colmap_model import MODEL_FILES, write_model
from perception.reconstruct.las import write_las
from perception.reconstruct.optics import Optics
from perception.reconstruct.pictures import SurveyPicture
from perception.reconstruct.projection import Projection, projection
from perception.reconstruct.realitycapture_xmp import write_realitycapture

ELLIPSOIDAL = "metres above the WGS 84 ellipsoid"


@dataclass(frozen=True)
class Export:
    """What is written, and where to."""

    data: RunData
    folder: Path
    epsg: int | None = None
    gsd_m: float | None = None

    @cached_property
    def site(self) -> Site:
        """The run's anchor."""
        return self.data.mission.site.anchor

    @cached_property
    def projection(self) -> Projection:
        """Where the cloud goes."""
        return projection(self.site, self.epsg)

    @property
    def accuracy(self) -> Accuracy:
        """Of the measured poses."""
        return Accuracy.of(self.data.mission.camera)

    @cached_property
    def cloud(self) -> Cloud:
        """The run's cloud. Raises UserError when there is none."""
        cloud = read_cloud(self.data.run.cloud)
        if not len(cloud):
            raise UserError(f"{self.data.run.cloud}: no points; lower reconstruct.min_confidence in mission.toml and "
                            "run 'swarmscan reconstruct' again.")
        return cloud

    @cached_property
    def raster(self) -> Raster:
        """The textured model from above, at gsd_m, else at the survey's. Raises UserError when there is no model."""
        return seen_from_above(read_model(self.data.run.model), self.projection,
                               self.gsd_m or self.data.mission.survey.gsd_m)

    @cached_property
    def aligned(self) -> bool:
        """Whether the run has poses from bundle adjustment."""
        return alignment_numbers(self.data.run.alignment) is not None

    @cached_property
    def pictures(self) -> list[SurveyPicture]:
        """The survey's pictures with aligned poses, else with measured ones. Raises UserError when there are none."""
        pictures = self.data.survey_pictures()
        if not pictures:
            raise UserError(f"{self.data.run.views_csv}: no survey pictures; fly the survey first, or export the cloud "
                            "alone with --format laz.")
        if not self.aligned:
            return pictures
        poses = read_poses(self.data.run.alignment)
        if [p.view_id for p in poses] != [p.view_id for p in pictures]:
            raise UserError(f"{self.data.run.alignment}: made from other pictures than those in views.csv; run "
                            "'swarmscan reconstruct' again.")
        return [pose.applied(p) for pose, p in zip(poses, pictures, strict=True)]


    @cached_property
    def optics(self) -> Optics:
        """Of the files in pictures/: as alignment found it, else as the mission says."""
        numbers = alignment_numbers(self.data.run.alignment)
        return Optics.from_numbers(numbers["camera"]) if numbers is not None else \
            Optics(self.pictures[0].camera, self.data.mission.camera.distortion)


def las(export: Export) -> list[Path]:
    """cloud.las"""
    return [_las(export, "cloud.las")]


def laz(export: Export) -> list[Path]:
    """cloud.laz"""
    return [_las(export, "cloud.laz")]


def colmap(export: Export) -> list[Path]:
    """colmap/: the text model in the site's ENU frame, and where that frame's origin lies."""
    pictures = export.pictures
    folder = export.folder / "colmap"
    folder.mkdir(parents=True, exist_ok=True)
    if export.aligned:
        for name in MODEL_FILES:
            shutil.copyfile(export.data.run.alignment / name, folder / name)
    else:
        write_model(folder, pictures, export.optics)
    site = export.site
    (folder / "origin.json").write_text(json.dumps(
        {"world": "local East, North, Up, metres", "origin_lat_deg": site.lat_deg, "origin_lon_deg": site.lon_deg,
         "origin_height_m": site.alt_m, "heights": ELLIPSOIDAL, "poses": _poses(export)}, indent=1), encoding="utf-8")
    return [folder / name for name in (*MODEL_FILES, "origin.json")]


def metashape(export: Export) -> list[Path]:
    """metashape.csv"""
    path = export.folder / "metashape.csv"
    write_metashape(export.pictures, export.site, export.accuracy, path)
    return [path]


def realitycapture(export: Export) -> list[Path]:
    """realitycapture/: an XMP file per picture, in the site's ENU frame"""
    folder = export.folder / "realitycapture"
    folder.mkdir(parents=True, exist_ok=True)
    return write_realitycapture(export.pictures, export.optics, folder)


def geo(export: Export) -> list[Path]:
    """geo.txt"""
    path = export.folder / "geo.txt"
    write_geo(export.pictures, export.site, export.accuracy, path)
    return [path]


def orthophoto(export: Export) -> list[Path]:
    """orthophoto.tif"""
    path = export.folder / "orthophoto.tif"
    write_orthophoto(export.raster, path)
    return [path]


def dsm(export: Export) -> list[Path]:
    """dsm.tif"""
    path = export.folder / "dsm.tif"
    write_dsm(export.raster, path)
    return [path]


FORMATS: dict[str, Callable[[Export], list[Path]]] = {
    "las": las, "laz": laz, "colmap": colmap, "metashape": metashape,
    "realitycapture": realitycapture, "geo": geo, "orthophoto": orthophoto, "dsm": dsm}
CLOUDS = ("las", "laz")
RASTERS = ("orthophoto", "dsm")
USUAL = ("laz", "colmap", "metashape", "realitycapture", "geo")


def export_run(run: RunFolder, formats: list[str], folder: Path, epsg: int | None = None,
               gsd_m: float | None = None) -> dict[str, Any]:
    """Write the formats into the folder; returns what was written, in which CRS, what heights are above, whose poses.

    Raises UserError when the run lacks what a format needs, when the CRS does not suit, or nothing can be written.
    """
    export = Export(read_run(run), folder, epsg, gsd_m)
    document: dict[str, Any] = {"heights": ELLIPSOIDAL}
    if set(formats) & {*CLOUDS, *RASTERS}:
        document |= _crs(export)
    if set(formats) & set(CLOUDS):
        document |= {"points": len(export.cloud)}
    if set(formats) & set(RASTERS):
        rows, columns = export.raster.height_m.shape
        document |= {"cells": [columns, rows], "gsd_m": export.raster.gsd_m}
    if set(formats) - {*CLOUDS, *RASTERS}:
        document |= {"pictures": len(export.pictures), "poses": _poses(export)}
    try:
        folder.mkdir(parents=True, exist_ok=True)
        files = [path for name in formats for path in FORMATS[name](export)]
    except OSError as e:
        raise UserError(f"{folder}: cannot be written ({e.strerror or e}); choose another folder with --out.") from e
    return {**document, "files": [str(path) for path in files]}


def _crs(export: Export) -> dict[str, Any]:
    """In which CRS places are, and what heights are above."""
    crs = export.projection.horizontal
    return {"crs": f"EPSG:{export.projection.epsg}", "crs_name": crs.name,
            "crs_scale": round(export.projection.scale, 7), "crs_accuracy_m": export.projection.accuracy_m,
            "heights": f"metres above the {crs.ellipsoid.name if crs.ellipsoid else ''} ellipsoid"}


def _las(export: Export, name: str) -> Path:
    path = export.folder / name
    write_las(export.cloud, export.projection, path)
    return path


def _poses(export: Export) -> str:
    return "aligned" if export.aligned else "measured"


def main(argv: list[str]) -> int:
    """Cloud, cameras, orthophoto and surface model of a run for other programs."""
    options = _parser().parse_args(argv)
    root = Path(options.run)
    if not root.is_dir():
        raise UserError(f"{root}: no such run folder; give the folder that 'swarmscan fly' made.")
    folder = Path(options.out) if options.out else root / "export"
    document = export_run(RunFolder(root.resolve()), list(dict.fromkeys(options.format)), folder, options.crs,
                          options.gsd)
    print_result(document, "\n".join(_sentences(document)), options.json)
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="swarmscan export", description=main.__doc__)
    parser.add_argument("run", metavar="RUN", help="the run folder that 'swarmscan fly' made")
    parser.add_argument("--format", nargs="+", choices=list(FORMATS), default=list(USUAL), metavar="FORMAT",
                        help=f"any of {', '.join(FORMATS)} (default: {' '.join(USUAL)})")
    parser.add_argument("--out", metavar="DIR", help="where to (default: RUN/export)")
    parser.add_argument("--crs", type=_epsg, metavar="EPSG",
                        help="projected CRS of cloud and rasters, in metres (default: the UTM zone of the site)")
    parser.add_argument("--gsd", type=_metres, metavar="M",
                        help="cell of orthophoto and dsm in metres (default: survey.gsd_m)")
    parser.add_argument("--json", action="store_true", help="print one JSON document on stdout")
    return parser


def _epsg(text: str) -> int:
    """25832 or EPSG:25832."""
    code = text.upper().removeprefix("EPSG:")
    if not code.isdecimal():
        raise argparse.ArgumentTypeError(f"{text}: give an EPSG code, such as 25832")
    return int(code)


def _metres(text: str) -> float:
    """A positive length."""
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0.0 < value < math.inf:
        raise argparse.ArgumentTypeError(f"{text}: give metres, such as 0.02")
    return value


def _sentences(document: dict[str, Any]) -> list[str]:
    lines = []
    if "points" in document:
        lines.append(f"{document['points']} points in {document['crs']} ({document['crs_name']}), heights in "
                     f"{document['heights']}")
    if "cells" in document:
        columns, rows = document["cells"]
        lines.append(f"{columns} x {rows} cells of {document['gsd_m']:g} m in {document['crs']} "
                     f"({document['crs_name']}), heights in {document['heights']}")
    if "pictures" in document:
        lines.append(f"{document['pictures']} pictures with {document['poses']} poses, heights in {ELLIPSOIDAL}")
    return [*lines, *document["files"]]
