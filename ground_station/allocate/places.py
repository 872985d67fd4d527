"""Positions to be visited, read from .npz, .csv, TSPLIB .tsp and QGroundControl .plan files."""

from __future__ import annotations

import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pymavlink.dialects.v20 import common as mav

from ground_station.views_file import read_views
from missions.errors import UserError
from missions.flight_plan import FILE_FRAMES, params_of_item
from missions.frames import Array, Site
from missions.qgc_plan import read_plan

POSE_COLUMNS = 5
"""Arrays of this width are trajectories as MACARONS writes them: x, y, z with y up, elevation, azimuth."""
TABLE = ("view_id", "position_enu_m")


@dataclass(frozen=True)
class Places:
    """n places: ids, unique, and positions (n, 3), z up, in metres or in the file's own unit."""

    ids: list[int]
    positions_m: Array


def read_places(path: Path, key: str | None = None) -> Places:
    """The places of a file, by its ending; key: the array of an .npz with several. Raises UserError."""
    readers = {".csv": _from_csv, ".tsp": _from_tsplib, ".plan": _from_plan}
    if path.suffix != ".npz" and path.suffix not in readers:
        raise UserError(f"{path}: of no known kind; give a .npz, .csv, .tsp or .plan file.")
    try:
        places = _from_npz(path, key) if path.suffix == ".npz" else readers[path.suffix](path)
    except (OSError, UnicodeDecodeError, zipfile.BadZipFile) as e:
        raise UserError(f"{path}: cannot be read ({e}); give a readable file.") from e
    except (ValueError, KeyError, TypeError, IndexError) as e:
        raise UserError(f"{path}: not a well-formed {path.suffix} file ({e}); mend it.") from e
    if not len(places.ids):
        raise UserError(f"{path}: holds no places; add some.")
    if not np.isfinite(places.positions_m).all():
        raise UserError(f"{path}: a position is not finite; mend it.")
    if len(set(places.ids)) < len(places.ids):
        raise UserError(f"{path}: an id occurs twice; number the places anew.")
    return places


def keys_of(path: Path) -> list[str]:
    """The names of an .npz file's arrays of positions, in the file's order."""
    try:
        with np.load(path) as file:
            if set(TABLE) <= set(file.files):
                return [TABLE[1]]
            return [k for k in file.files if file[k].ndim == 2 and file[k].shape[1] >= 2]
    except (OSError, ValueError, zipfile.BadZipFile) as e:
        raise UserError(f"{path}: cannot be read ({e}); give a readable .npz file.") from e


def _from_npz(path: Path, key: str | None) -> Places:
    names = keys_of(path)
    if key is None and len(names) != 1:
        found = ", ".join(names[:8]) + (", ..." if len(names) > 8 else "")
        raise UserError(f"{path}: has {len(names)} arrays of positions ({found}); choose one with --key.")
    name = names[0] if key is None else key
    if name not in names:
        raise UserError(f"{path}: has no array of positions {name!r}; choose another --key.")
    with np.load(path) as file:
        rows = np.asarray(file[name], dtype=np.float64)
        ids = file["view_id"] if name == TABLE[1] and "view_id" in file.files else np.arange(1, len(rows) + 1)
    if rows.shape[1] == POSE_COLUMNS:
        rows = np.stack([rows[:, 0], -rows[:, 2], rows[:, 1]], axis=1)
    chosen = np.asarray(ids) >= 0  # -1 marks waypoints that were inserted to get around something
    return Places([int(i) for i in ids[chosen]], _three_columns(rows[chosen]))


def _from_csv(path: Path) -> Places:
    views = read_views(path)
    return Places([v.view_id for v in views], np.array([v.pose.position_enu_m for v in views]))


def _from_tsplib(path: Path) -> Places:
    head, _, body = path.read_text(encoding="utf-8").partition("NODE_COORD_SECTION")
    kind = next((line.partition(":")[2].strip() for line in head.splitlines()
                 if line.startswith("EDGE_WEIGHT_TYPE")), "missing")
    if kind not in ("EUC_2D", "EUC_3D"):
        raise UserError(f"{path}: EDGE_WEIGHT_TYPE is {kind}; give an instance with EUC_2D or EUC_3D.")
    rows = [line.split() for line in body.partition("EOF")[0].splitlines() if line.strip()]
    positions = np.array([[float(x) for x in row[1:]] for row in rows])
    return Places([int(row[0]) for row in rows], _three_columns(positions))


def _from_plan(path: Path) -> Places:
    """Waypoints in metres East, North, up of the planned home. Ids count the file's waypoints from 1."""
    plan = read_plan(path)
    lat_deg, lon_deg, home_alt_m = params_of_item(plan.home)[4:]
    site = Site(lat_deg, lon_deg, 0.0)
    positions = []
    for item in plan.mission:
        if item.command != mav.MAV_CMD_NAV_WAYPOINT:
            continue
        if item.frame not in (mav.MAV_FRAME_GLOBAL_INT, mav.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT):
            raise UserError(f"{path}: a waypoint has frame {FILE_FRAMES[item.frame]}; use altitudes above home or the "
                            "sea.")
        lat_deg, lon_deg, alt_m = params_of_item(item)[4:]
        up_m = alt_m if item.frame == mav.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT else alt_m - home_alt_m
        positions.append(site.enu_from_geodetic(lat_deg, lon_deg, up_m))
    return Places(list(range(1, len(positions) + 1)), np.array(positions).reshape(-1, 3))


def _three_columns(rows: Array) -> Array:
    """(n, 3) of (n, 2 or more): missing heights are 0, further columns are left out."""
    return np.pad(rows, ((0, 0), (0, 1)))[:, :3] if rows.shape[1] == 2 else rows[:, :3]
