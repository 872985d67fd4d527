"""What a photograph says of itself: EXIF, read by Pillow, and XMP as DJI and Parrot write it.

Everything is optional, and what cannot be true is not believed: a position of exactly 0, 0 is a receiver without a fix.
Pixels are those that the file stores; EXIF's orientation says how to turn them for the eye and is not applied.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from PIL import ExifTags, Image, UnidentifiedImageError

from perception.photographs.pixels import decoded

FILM_DIAGONAL_MM = math.hypot(36.0, 24.0)
MM_PER_UNIT = {2: 25.4, 3: 10.0, 4: 1.0}
"""FocalPlaneResolutionUnit: inch, centimetre, millimetre."""
TURNED_DEG = {1: 0, 3: 180, 6: 90, 8: 270}
"""EXIF's orientation as the clockwise turn that shows the picture upright; mirrored ones do not come out of cameras."""
FOCAL_SHARE = (0.25, 12.0)
"""Focal lengths beyond this many picture widths are mistakes."""

CONTRADICTS = 1.5
SAME_SHAPE = 0.02

Numbers = Mapping[int, Any]


@dataclass(frozen=True)
class Metadata:
    """Of one photograph. Focal length in pixels of the file, position as WGS 84 degrees and metres."""

    width_px: int
    height_px: int
    make: str = ""
    model: str = ""
    taken: str = ""
    upright_turn_deg: int = 0
    """Clockwise turn of the stored pixels that shows the picture upright."""
    focal_px: float | None = None
    latitude_deg: float | None = None
    longitude_deg: float | None = None
    altitude_m: float | None = None
    position_sigma_m: float | None = None
    """What an RTK receiver says of its own error; None without one."""
    gimbal_deg: tuple[float, float, float] | None = None
    """Yaw clockwise from North, pitch (-90 looks down) and roll of the camera."""
    panorama: bool = False
    """Whether it was put together from several pictures."""

    @property
    def placed(self) -> bool:
        """Whether it says where it was taken."""
        return self.latitude_deg is not None


def read_metadata(path: Path) -> Metadata:
    """Of damaged EXIF as much as can be read. Raises OSError, or what else Pillow raises, when the file is no picture.
    """
    try:
        image = Image.open(path)
    except UnidentifiedImageError:
        height, width = decoded(path).shape[:2]
        return Metadata(width, height)
    with image:
        width, height = image.size
        try:
            exif = image.getexif()
            details, gps = exif.get_ifd(ExifTags.IFD.Exif), exif.get_ifd(ExifTags.IFD.GPSInfo)
            return _told(width, height, exif, details, gps, _xmp(image.info.get("xmp")))
        except Exception:  # Pillow's readers raise whatever a damaged file makes them raise
            return Metadata(width, height)


def _told(width: int, height: int, exif: Numbers, details: Numbers, gps: Numbers, xmp: Mapping[str, str]) -> Metadata:
    lat, lon = _degrees(gps, ExifTags.GPS.GPSLatitude, "S"), _degrees(gps, ExifTags.GPS.GPSLongitude, "W")
    lat = _number(xmp, "GpsLatitude") if lat is None else lat
    lon = _number(xmp, "GpsLongitude", "GpsLongtitude") if lon is None else lon
    if lat is None or lon is None or not (abs(lat) <= 90.0 and abs(lon) <= 180.0) or lat == lon == 0.0:
        lat = lon = None
    return Metadata(
        width, height, _text(exif.get(ExifTags.Base.Make)), _text(exif.get(ExifTags.Base.Model)),
        _text(details.get(ExifTags.Base.DateTimeOriginal)) + _text(details.get(ExifTags.Base.SubsecTimeOriginal)),
        TURNED_DEG.get(exif.get(ExifTags.Base.Orientation, 1), 0), _focal_px(details, xmp, width, height), lat, lon,
        None if lat is None else _altitude(gps, xmp), _number(xmp, "RtkStdHgt") if xmp.get("RtkFlag") else None,
        _gimbal(xmp), "ProjectionType" in xmp)


def _xmp(packet: object) -> dict[str, str]:
    """Attributes and texts of an XMP packet by their names without namespace; none where it is damaged."""
    fields: dict[str, str] = {}
    data = packet.encode() if isinstance(packet, str) else packet
    if not isinstance(data, bytes):
        return fields
    with suppress(ET.ParseError, ValueError):
        for element in ET.fromstring(data.strip(b"\x00 \r\n")).iter():
            named = {**element.attrib, element.tag: element.text or ""}
            fields |= {str(k).rpartition("}")[2]: v.strip() for k, v in named.items() if v.strip()}
    return fields


def _number(fields: Mapping[Any, Any], *names: Any) -> float | None:
    """The first of the fields that is a finite number."""
    for name in names:
        with suppress(TypeError, ValueError, ZeroDivisionError):
            value = float(fields[name]) if name in fields else math.nan
            if math.isfinite(value):
                return value
    return None


def _text(value: object) -> str:
    return value.strip("\x00 ") if isinstance(value, str) else ""


def _degrees(gps: Numbers, tag: int, negative: str) -> float | None:
    """Degrees, minutes and seconds with the reference that precedes them."""
    with suppress(KeyError, TypeError, ValueError, ZeroDivisionError):
        parts = gps[tag] if isinstance(gps[tag], tuple) else (gps[tag],)
        value = sum(float(part) / 60.0**k for k, part in enumerate(parts))
        if math.isfinite(value):
            return -value if _text(gps.get(tag - 1)).upper() == negative else value
    return None


def _altitude(gps: Numbers, xmp: Mapping[str, str]) -> float | None:
    """DJI's own absolute altitude where there is one: its GPSAltitude is rounded by some models."""
    told = _number(xmp, "AbsoluteAltitude")
    exif = _number(gps, ExifTags.GPS.GPSAltitude)
    below = gps.get(ExifTags.GPS.GPSAltitudeRef) in (b"\x01", b"\x03", 1, 3)
    return told if told is not None else (None if exif is None else (-exif if below else exif))


def _focal_px(details: Numbers, xmp: Mapping[str, str], width: int, height: int) -> float | None:
    """From DJI's calibration, the 35 mm equivalent (by the diagonal), or the focal plane's resolution.

    Only the second is still true when somebody has made the picture smaller and left its EXIF; the others are of the
    size that EXIF tells, and are not believed where the second contradicts them.
    """
    share = _resized(details, width, height)
    millimetres = _number(details, ExifTags.Base.FocalLength)
    film = _number(details, ExifTags.Base.FocalLengthIn35mmFilm)
    per_unit = _number(details, ExifTags.Base.FocalPlaneXResolution)
    unit = MM_PER_UNIT.get(details.get(ExifTags.Base.FocalPlaneResolutionUnit, 2), 25.4)
    calibrated = _number(xmp, "CalibratedFocalLength")
    by_film = film * math.hypot(width, height) / FILM_DIAGONAL_MM if film else None
    for focal in (calibrated * share if calibrated else None, by_film,
                  millimetres * per_unit / unit * share if millimetres and per_unit else None):
        if focal is not None and FOCAL_SHARE[0] < focal / max(width, height) < FOCAL_SHARE[1] \
                and (by_film is None or 1.0 / CONTRADICTS < focal / by_film < CONTRADICTS):
            return focal
    return None


def _resized(details: Numbers, width: int, height: int) -> float:
    """Pixels of the file per pixel of the picture that the camera took, as far as EXIF tells."""
    sides = (ExifTags.Base.ExifImageWidth, ExifTags.Base.ExifImageHeight)
    shorter, longer = sorted(_number(details, side) or 0.0 for side in sides)
    if shorter < 1.0 or abs(longer / shorter * min(width, height) / max(width, height) - 1.0) > SAME_SHAPE:
        return 1.0
    return max(width, height) / longer


def _gimbal(xmp: Mapping[str, str]) -> tuple[float, float, float] | None:
    """DJI's gimbal angles, or Parrot's of the camera, which name the same things."""
    for prefix, suffix in (("Gimbal", "Degree"), ("Camera", "Degree"), ("", "")):
        yaw, pitch, roll = (_number(xmp, f"{prefix}{name}{suffix}") for name in ("Yaw", "Pitch", "Roll"))
        if yaw is not None and pitch is not None:
            return yaw, pitch, roll or 0.0
    return None
