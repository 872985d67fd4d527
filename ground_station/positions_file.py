"""Positions of photographs from a CSV file, in place of what the photographs themselves say.

Columns: picture (the file's name, with the folders below the one that is reconstructed), lat_deg, lon_deg, height_m
(WGS 84, above the ellipsoid), and, where known, yaw_deg (clockwise from North), pitch_deg (-90 looks down), roll_deg.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from ground_station.csv_table import read_table
from missions.errors import UserError
from perception.photographs.metadata import Metadata
from perception.photographs.photograph import Photograph

PLACE = ("lat_deg", "lon_deg", "height_m")
ANGLES = ("yaw_deg", "pitch_deg", "roll_deg")


def with_positions(found: Sequence[Photograph], path: Path) -> list[Photograph]:
    """The photographs with the positions of the file; those that it does not name keep their own.

    Raises UserError naming file, line and remedy.
    """
    rows, columns = read_table(path)
    missing = [c for c in ("picture", *PLACE) if c not in columns]
    if missing:
        raise UserError(f"{path}: columns {', '.join(missing)} are missing; add them.")
    by_name = {p.name: p for p in found}
    for line, row in enumerate(rows, start=2):
        photograph = by_name.get((row["picture"] or "").strip())
        if photograph is None:
            raise UserError(f"{path}: line {line}: there is no picture {row['picture']}; correct or remove that line.")
        if photograph.metadata is not None:
            by_name[photograph.name] = replace(photograph, metadata=_placed(photograph.metadata, row, path, line))
    return list(by_name.values())


def _placed(metadata: Metadata, row: dict[str, str], path: Path, line: int) -> Metadata:
    try:
        lat, lon, height = (float(row[c]) for c in PLACE)
        angles = tuple(float(row[c]) for c in ANGLES) if all(row.get(c) for c in ANGLES) else None
    except (TypeError, ValueError) as e:
        raise UserError(f"{path}: line {line}: {e}; write numbers there.") from e
    if not (abs(lat) <= 90.0 and abs(lon) <= 180.0 and all(map(math.isfinite, (height, *(angles or ()))))):
        raise UserError(f"{path}: line {line}: no place on Earth; correct lat_deg, lon_deg and height_m.")
    gimbal = metadata.gimbal_deg if angles is None else (angles[0], angles[1], angles[2])
    return replace(metadata, latitude_deg=lat, longitude_deg=lon, altitude_m=height, gimbal_deg=gimbal)
