"""`swarmscan reconstruct PICTURES`: a folder of photographs becomes a run folder, with which everything else goes on.

photographs.json in it says of every picture what became of it. See docs/reconstruction.md.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap

from ground_station.control_file import MarkedPoint
from ground_station.photograph_record import (
    FOLDED,
    MISPLACED,
    RECORD,
    add_models,
    record_of,
    write_record,
)
from ground_station.positions_file import with_positions
from missions.errors import UserError
from missions.frames import Array, Site, quaternion_from_matrix
from missions.mission import CameraSpec, Mission, ReconstructSpec, SiteSpec, SurveySpec
from missions.mission_file import write_mission
from missions.mission_section import Point
from missions.run_folder import RunFolder, write_views
from missions.simulation import SceneSpec
from perception.photographs.adjust import refined
from perception.photographs.folds import leave_out_folded
from perception.photographs.georeference import Placement, place
from perception.photographs.mapping import told_focal_px
from perception.photographs.photograph import Photograph, photographs_in
from perception.photographs.placed import (
    common_camera,
    leave_out_misplaced,
    members,
    redraw,
    spacing_for,
    stations,
    surface,
)
from perception.photographs.quality import reasons
from perception.photographs.sparse import map_photographs
from perception.reconstruct.control_points import Found, find, hold, similarity
from perception.reconstruct.pictures import SurveyPicture

LEAST = 3
DEPTH_WIDTH_PX = 960

Tell = Callable[[str, int, int], None]


@dataclass(frozen=True)
class Wishes:
    """What the user may choose."""

    keep_all: bool = False
    """Also pictures that the quality gate would reject."""
    control: tuple[MarkedPoint, ...] = ()
    """Ground control and check points; marks name photographs."""
    positions: Path | None = None
    """A file whose positions stand for those that photographs carry."""
    mapper: str = "incremental"
    threads: int = 3


def prepare_run(folder: Path, run: RunFolder, wishes: Wishes, tell: Tell) -> dict[str, Any]:
    """Read, judge, map, place and draw the photographs of a folder anew; returns what photographs.json says.

    Raises UserError with the reason when there can be no model.
    """
    found = photographs_in(folder, wishes.threads, lambda done, total: tell("read", done, total))
    if wishes.positions is not None:
        found = with_positions(found, wishes.positions)
    left_out = _gate(found, wishes.keep_all)
    used = sorted((p for p in found if p.name not in left_out), key=_taken)
    record = record_of(found, left_out, used)
    write_record(run.root, record)
    if len(used) < LEAST:
        raise UserError(f"{folder}: {len(used)} usable pictures of {len(found)}, and a model needs at least {LEAST}. "
                        + _left_out_in_words(left_out))
    site, placed_enu_m = _gps(used, wishes.control)
    try:
        models = map_photographs(used, placed_enu_m, run.root / "sparse", wishes.threads, wishes.mapper, tell)
    except UserError as e:
        raise UserError(f"{folder}: {e} {_left_out_in_words(left_out)}".rstrip()) from e
    folded = leave_out_folded(models[0])
    placements = [_place(model, used, placed_enu_m) for model in models]
    misplaced = leave_out_misplaced(models[0], placements[0])
    if folded or misplaced:
        models[0] = refined(models[0], told_focal_px(used))
        placements[0] = _place(models[0], used, placed_enu_m)
    models[0], tied, carried = _tied(models[0], used, site, wishes.control)
    if carried is not None:
        placements[0] = Placement(carried, "control points")
    pictures = _redraw(models[0], used, run, tell)
    write_mission(_mission(folder, site, models[0], pictures, placements[0]), run.mission)
    _write_views(run, pictures)
    add_models(record, used, models, placements, site,
               dict.fromkeys(folded, FOLDED) | dict.fromkeys(misplaced, MISPLACED))
    record["control_points"] = [found.row for found in tied]
    write_record(run.root, record)
    return record


def _taken(photograph: Photograph) -> tuple[str, list[tuple[int, str]]]:
    """By time, then by name, frame 10 after frame 9."""
    parts = re.split(r"(\d+)", photograph.name)
    return (photograph.metadata.taken if photograph.metadata else "",
            [(int(part), "") if part.isdecimal() else (-1, part) for part in parts])


def _gate(found: Sequence[Photograph], keep_all: bool) -> dict[str, str]:
    """Why pictures are left out, by name."""
    left_out = {p.name: p.fault for p in found if p.fault}
    good = [(p, p.look) for p in found if p.look is not None and not p.fault]
    if not keep_all:
        why = reasons([look for _, look in good], [p.sha256 for p, _ in good], [p.name for p, _ in good])
        left_out |= {p.name: reason for (p, _), reason in zip(good, why, strict=True) if reason}
    return left_out


def _left_out_in_words(left_out: dict[str, str]) -> str:
    kinds = Counter(why.partition(":")[0] for why in left_out.values())
    if not kinds:
        return ""
    counted = ", ".join(f"{count} {kind}" for kind, count in sorted(kinds.items()))
    return f"Left out: {counted} ({RECORD} says which and why; --keep-all takes those that can be read)."


def _tied(model: pycolmap.Reconstruction, used: Sequence[Photograph], site: Site,
          control: Sequence[MarkedPoint]
          ) -> tuple[pycolmap.Reconstruction, list[Found], pycolmap.Sim3d | None]:
    """The model is carried to the control points and adjusted between them; where all points are found then, and how
    it was carried: None where there is too little control."""
    number_of = {p.name: i for i, p in enumerate(used)}
    unknown = sorted({name for point in control for name in point.marks} - set(number_of))
    if unknown:
        raise UserError(f"control points: {unknown[0]} is none of the pictures that are used; name them as {RECORD} "
                        "does, and use --keep-all if the quality gate has left it out.")
    points = [p.placed(site, number_of) for p in control]
    carried = similarity(find(points, model))
    if carried is not None:
        model.transform(carried)
        model = refined(model, told_focal_px(used), hold(model, points))
    return model, find(points, model), carried


def _gps(used: Sequence[Photograph], control: Sequence[MarkedPoint]) -> tuple[Site, Array]:
    """The anchor in the middle of the GNSS positions, else of the control points, and (n, 3) those positions, NaN where
    unknown."""
    told = np.array([[np.nan] * 3 if m is None or m.latitude_deg is None or m.longitude_deg is None else
                     [m.latitude_deg, m.longitude_deg, np.nan if m.altitude_m is None else m.altitude_m]
                     for m in (p.metadata for p in used)])
    if not np.any(np.isfinite(told[:, 0])):
        surveyed = [p.place for p in control if p.geodetic]
        middle = np.median(surveyed, axis=0).round(6).tolist() if surveyed else [0.0, 0.0, 0.0]
        return Site(*middle), np.full((len(used), 3), np.nan)
    heights = told[np.isfinite(told[:, 2]), 2]
    height = round(float(np.median(heights)), 1) if len(heights) else 0.0
    told[np.isfinite(told[:, 0]) & ~np.isfinite(told[:, 2]), 2] = height
    lat, lon = (round(float(np.nanmedian(told[:, k])), 6) for k in (0, 1))
    site = Site(lat, lon, height)
    return site, np.array([site.enu_from_geodetic(*row) for row in told])


def _place(model: pycolmap.Reconstruction, used: Sequence[Photograph], placed_enu_m: Array) -> Placement:
    """Carries the model there; outliers are photographs' numbers."""
    which = members(model)
    placement = place(stations(model, used, placed_enu_m), surface(model).usual)
    model.transform(placement.enu_from_model)
    return replace(placement, outliers=tuple(which[k] for k in placement.outliers))


def _redraw(model: pycolmap.Reconstruction, used: Sequence[Photograph], run: RunFolder,
            tell: Tell) -> list[SurveyPicture]:
    """Pictures as one pinhole would have taken them, in pictures/; drawn again only where they are missing."""
    wanted, pictures, which = common_camera(model, used), [], members(model)
    key = f"{wanted.fx_px:.3f}"
    for i in which:
        name = f"{i + 1:04d}-{used[i].sha256[:8]}-{key}-{Path(used[i].name).stem}.jpg"
        pictures.append(redraw(model, used, i, wanted, run.pictures / name))
        tell("redraw", len(pictures), len(which))
    kept = {p.path for p in pictures}
    for old in run.pictures.glob("*.jpg"):
        if old not in kept:
            old.unlink()
    return pictures


def _mission(folder: Path, site: Site, model: pycolmap.Reconstruction, pictures: Sequence[SurveyPicture],
             placement: Placement) -> Mission:
    """What the stages that follow read: site, camera, region and how to reconstruct."""
    camera, seen = pictures[0].camera, surface(model)
    width = min(DEPTH_WIDTH_PX, camera.width_px)
    spec = SiteSpec(origin_lat_deg=site.lat_deg, origin_lon_deg=site.lon_deg, origin_alt_m=site.alt_m,
                    object_min_enu_m=_point(seen.lower), object_max_enu_m=_point(seen.upper))
    return Mission(
        title=folder.resolve().name, description=f"{len(pictures)} photographs; scale by {placement.by}",
        scene=SceneSpec(name=""), site=spec,
        camera=CameraSpec(survey_px=(camera.width_px, camera.height_px), focal_px=camera.fx_px),
        survey=SurveySpec(distance_m=seen.usual, gsd_m=seen.usual / camera.fx_px),
        reconstruct=ReconstructSpec(depth_width_px=width, near_m=seen.near, far_m=seen.far,
                                    cloud_spacing_m=spacing_for(seen.usual, camera, width)))


def _point(corner: Array) -> Point:
    east, north, up = (round(float(v), 3) for v in corner)
    return east, north, up


def _write_views(run: RunFolder, pictures: Sequence[SurveyPicture]) -> None:
    rows: list[list[Any]] = []
    for p in pictures:
        numbers = [f"{v:.9f}" for v in (0.0, *p.position_enu_m, *quaternion_from_matrix(p.enu_from_camera), 0.0)]
        rows.append([p.view_id, 1, "survey", *numbers, p.path.relative_to(run.root).as_posix()])
    write_views(run.views_csv, rows)
