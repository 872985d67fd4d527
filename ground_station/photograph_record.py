"""What became of each photograph: photographs.json, and the same for people."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from missions.frames import Site
from perception.photographs.folds import doubtful_pairs
from perception.photographs.georeference import Placement
from perception.photographs.mapping import told_focal_px
from perception.photographs.photograph import Photograph
from perception.photographs.placed import members
from perception.reconstruct.optics import Optics

RECORD = "photographs.json"
FEW_POINTS, LARGE_ERROR_PX = 100.0, 1.0
FOLDED = "apart: stands where others stand but shares few points with them, misled by what looks alike"
MISPLACED = "apart: its GPS position contradicts where its few tie points would put it"
ONE_WAY_DEG = 15.0
SHOWN = 40
"""Pictures that are listed for people; the file has all."""


def write_record(folder: Path, record: dict[str, Any]) -> None:
    """photographs.json"""
    (folder / RECORD).write_text(json.dumps(record, indent=1, ensure_ascii=False), encoding="utf-8")


def record_of(found: Sequence[Photograph], left_out: dict[str, str], used: Sequence[Photograph]) -> dict[str, Any]:
    """Before mapping: which photographs there are, and why some are left out."""
    return {"photographs": len(found), "usable": len(used), "left_out": len(left_out),
            "pictures": [{**p.row, "state": f"left out: {left_out[p.name]}" if p.name in left_out else "usable"}
                         for p in found]}


def add_models(record: dict[str, Any], used: Sequence[Photograph], models: Sequence[pycolmap.Reconstruction],
               placements: Sequence[Placement], site: Site, left_out: Mapping[int, str]) -> None:
    """After mapping: which photographs hang together, how they were placed, what the cameras are. left_out: why some
    were taken out of the model."""
    rows = {row["name"]: row for row in record["pictures"]}
    where: dict[int, int] = {}
    for k, model in reversed(list(enumerate(models))):
        where |= dict.fromkeys(members(model), k)
    for i, photograph in enumerate(used):
        rows[photograph.name]["state"] = left_out.get(i) or _state(where.get(i), placements[0], i)
    record["registered"] = sum(1 for k in where.values() if k == 0)
    record["components"] = [_component(k, model, [used[i].name for i, at in sorted(where.items()) if at == k], place)
                            for k, (model, place) in enumerate(zip(models, placements, strict=True))]
    record["apart"] = [p.name for i, p in enumerate(used) if where.get(i) != 0]
    record["cameras"] = [_camera(models[0], camera_id) for camera_id in sorted(models[0].cameras)
                         if _pictures_of(models[0], camera_id)]
    record["warnings"] = _warnings(models[0], used)
    record["origin"] = {"lat_deg": site.lat_deg, "lon_deg": site.lon_deg, "alt_m": site.alt_m} \
        if placements[0].scaled else None


def _warnings(model: pycolmap.Reconstruction, used: Sequence[Photograph]) -> list[str]:
    """What makes a model doubtful though it was made."""
    per_picture, error_px = model.num_points3D() / model.num_reg_images(), model.compute_mean_reprojection_error()
    found = []
    if per_picture < FEW_POINTS:
        found.append(f"only {per_picture:.0f} tie points per picture: they overlap little, and structures that look "
                     "alike may be folded onto each other; look at the positions, and take more pictures")
    if error_px > LARGE_ERROR_PX:
        found.append(f"mean reprojection error of {error_px:.1f} px: the poses may be wrong")
    axes = [model.image(i).cam_from_world().rotation.matrix()[2] for i in model.reg_image_ids()]
    if not told_focal_px(used) and np.linalg.norm(np.mean(axes, axis=0)) > math.cos(math.radians(ONE_WAY_DEG)):
        found.append("all pictures look the same way and none tells its focal length, which then trades off with "
                     "heights: add oblique pictures, or those that the camera itself wrote, with their EXIF")
    doubtful = doubtful_pairs(model)
    if doubtful:
        first, second = (used[i].name for i in doubtful[0])
        found.append(f"{len(doubtful)} pairs, such as {first} and {second}, stand in one place but share few points: "
                     "sides that look alike may be folded onto each other; look at the positions, add pictures between")
    return found


def _state(component: int | None, main: Placement, index: int) -> str:
    if component is None:
        return "apart: shares too few points with any other picture"
    if component:
        return f"apart: hangs together with others in component {component}, not with the model"
    return "in the model; its GPS position is an outlier" if index in main.outliers else "in the model"


def _component(number: int, model: pycolmap.Reconstruction, names: list[str], placement: Placement) -> dict[str, Any]:
    return {"component": number, "pictures": len(names), "points": model.num_points3D(),
            "reprojection_px": round(model.compute_mean_reprojection_error(), 3), "placed_by": placement.by,
            "metric": placement.scaled, "gps_agreeing": placement.agreeing, "gps_outliers": len(placement.outliers),
            "gps_error_m": None if placement.error_m is None else round(placement.error_m, 3), "names": names}


def _camera(model: pycolmap.Reconstruction, camera_id: int) -> dict[str, Any]:
    return {"pictures": _pictures_of(model, camera_id), **Optics.of(model.camera(camera_id)).numbers}


def _pictures_of(model: pycolmap.Reconstruction, camera_id: int) -> int:
    return sum(1 for i in model.reg_image_ids() if model.image(i).camera_id == camera_id)


def shown(record: dict[str, Any]) -> RenderableType:
    """What is not in the model, picture by picture, and how the rest was placed."""
    table = Table("picture", "blur", "brightness", "what became of it", title="Not in the model")
    apart = [row for row in record["pictures"] if not row["state"].startswith("in the model")]
    for row in apart[:SHOWN]:
        table.add_row(*(Text(str(row.get(key, ""))) for key in ("name", "blur", "brightness", "state")))
    lines = [f"{record['photographs']} photographs: " + ", ".join(
        f"{count} {state}" for state, count in Counter(_kind(row["state"]) for row in record["pictures"]).items())]
    if len(apart) > SHOWN:
        lines.append(f"{len(apart) - SHOWN} more that are not in the model: see {RECORD}")
    return Group(*([table] if apart else []), *(Text(line) for line in (*lines, *_placed_in_words(record))))


def _kind(state: str) -> str:
    return state.partition(":")[0].partition(";")[0]


def _placed_in_words(record: dict[str, Any]) -> list[str]:
    if not record.get("components"):
        return []
    main, *others = record["components"]
    lines = [f"{main['pictures']} pictures in the model, {main['points']} tie points, "
             f"{main['reprojection_px']} px mean reprojection error"]
    if main["placed_by"] == "control points":
        lines.append("placed by control points")
    elif main["metric"]:
        lines.append(f"placed by {main['placed_by']}: {main['gps_agreeing']} positions agree, "
                     f"{main['gps_outliers']} do not; mean distance {main['gps_error_m']} m")
    else:
        lines.append("no usable GPS: scale and place of the model are made up (median distance of the surface: 10)")
    lines += [f"camera of {c['pictures']} pictures: {c['width_px']}x{c['height_px']}, "
              f"focal length {c['fx_px']:.1f} px, distortion {' '.join(f'{v:.4f}' for v in c['distortion'])}"
              for c in record["cameras"]]
    lines += [f"warning: {text}" for text in record["warnings"]]
    lines += [f"{c['role']} point {c['name']} in {c['pictures']} pictures: "
              + ("not found" if c["error_m"] is None else f"{1000 * c['error_m']:.1f} mm off, {c['error_px']:.2f} px")
              for c in record.get("control_points", [])]
    return lines + [f"component {c['component']}: {c['pictures']} pictures that hang together apart from the model: "
                    + ", ".join(c["names"][:10]) + (" ..." if len(c["names"]) > 10 else "") for c in others]
