"""EXIF for received pictures, put into the JPEG without touching its pixels."""

from __future__ import annotations

from datetime import datetime, timedelta

import numpy as np
from PIL import ExifTags, Image
from PIL.TiffImagePlugin import IFDRational

from missions.frames import Site, heading_deg_from_yaw_enu
from missions.messages import PictureMeta

SENSOR_WIDTH_MM = 9.6
"""Width of the thesis's sensor; focal lengths in millimetres refer to it."""
MAKE, MODEL = "swarmscan", "swarmscan simulated camera"
SOI, APP1 = b"\xff\xd8", b"\xff\xe1"


def with_exif(jpeg: bytes, meta: PictureMeta, site: Site, epoch: datetime) -> bytes:
    """The same picture with GPS position, direction, time and focal length in an EXIF segment.

    epoch: simulated time zero.
    """
    payload = _exif(meta, site, epoch).tobytes()
    return SOI + APP1 + (len(payload) + 2).to_bytes(2, "big") + payload + jpeg[2:]


def _exif(meta: PictureMeta, site: Site, epoch: datetime) -> Image.Exif:
    taken = epoch + timedelta(microseconds=meta.t_capture_ns // 1000)
    focal_mm = SENSOR_WIDTH_MM * meta.camera.fx_px / meta.camera.width_px
    exif = Image.Exif()
    exif[ExifTags.Base.Make], exif[ExifTags.Base.Model] = MAKE, MODEL
    exif[ExifTags.Base.DateTime] = taken.strftime("%Y:%m:%d %H:%M:%S")
    details = exif.get_ifd(ExifTags.IFD.Exif)
    details[ExifTags.Base.DateTimeOriginal] = taken.strftime("%Y:%m:%d %H:%M:%S")
    details[ExifTags.Base.SubsecTimeOriginal] = f"{taken.microsecond // 1000:03d}"
    details[ExifTags.Base.FocalLength] = IFDRational(round(focal_mm * 10000), 10000)
    details[ExifTags.Base.FocalLengthIn35mmFilm] = round(36.0 * meta.camera.fx_px / meta.camera.width_px)
    details[ExifTags.Base.FocalPlaneXResolution] = IFDRational(round(meta.camera.width_px * 1000),
                                                              round(SENSOR_WIDTH_MM * 1000))
    details[ExifTags.Base.FocalPlaneResolutionUnit] = 4  # millimetres
    exif.get_ifd(ExifTags.IFD.GPSInfo).update(_gps(meta, site))
    return exif


def _gps(meta: PictureMeta, site: Site) -> dict[int, object]:
    lat, lon, alt = site.geodetic_from_enu(np.array(meta.pose.position_enu_m))
    heading = heading_deg_from_yaw_enu(meta.pose.yaw_enu_rad)
    gps = ExifTags.GPS
    return {
        gps.GPSVersionID: b"\x02\x03\x00\x00",
        gps.GPSLatitudeRef: "N" if lat >= 0 else "S", gps.GPSLatitude: _dms(abs(lat)),
        gps.GPSLongitudeRef: "E" if lon >= 0 else "W", gps.GPSLongitude: _dms(abs(lon)),
        gps.GPSAltitudeRef: b"\x00" if alt >= 0 else b"\x01",
        gps.GPSAltitude: IFDRational(round(abs(alt) * 1000), 1000),
        gps.GPSHPositioningError: IFDRational(round(meta.position_sigma_m * 1000), 1000),
        gps.GPSImgDirectionRef: "T", gps.GPSImgDirection: IFDRational(round(heading * 100), 100),
    }


def _dms(degrees: float) -> tuple[IFDRational, IFDRational, IFDRational]:
    """Degrees, minutes and seconds; seconds to 1e-6 (0.03 mm)."""
    micro_seconds = round(degrees * 3600 * 1_000_000)
    minutes, rest = divmod(micro_seconds, 60 * 1_000_000)
    whole, minutes = divmod(minutes, 60)
    return IFDRational(whole, 1), IFDRational(minutes, 1), IFDRational(rest, 1_000_000)
