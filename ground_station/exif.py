"""EXIF and XMP for received pictures, put into the JPEG without touching its pixels.

Heights are above the WGS 84 ellipsoid: since EXIF 3.0, which the pictures declare, that is what GPSAltitudeRef 0 and 1
mean (2 and 3 are the sea level); DJI's fields say it again (`dji_xmp.py`).
"""

from __future__ import annotations

from datetime import datetime, timedelta

import numpy as np
from PIL import ExifTags, Image
from PIL.TiffImagePlugin import IFDRational

from ground_station.dji_xmp import dji_xmp
from missions.frames import Site, heading_deg_from_yaw_enu
from missions.messages import PictureMeta

SENSOR_WIDTH_MM = 9.6
"""Width of the thesis's sensor; focal lengths in millimetres refer to it."""
MAKE, MODEL = "swarmscan", "swarmscan simulated camera"
SOI, APP1 = b"\xff\xd8", b"\xff\xe1"


def with_metadata(jpeg: bytes, meta: PictureMeta, site: Site, epoch: datetime, home_up_m: float) -> bytes:
    """The same picture with position, direction, time and focal length in an EXIF and an XMP segment.

    epoch: simulated time zero. home_up_m: height of the vehicle's take-off point in ENU.
    """
    segments = (_exif(meta, site, epoch).tobytes(), dji_xmp(meta, site, home_up_m))
    return SOI + b"".join(APP1 + (len(s) + 2).to_bytes(2, "big") + s for s in segments) + jpeg[2:]


def without_metadata(jpeg: bytes) -> bytes:
    """The picture as it was before `with_metadata`."""
    at = len(SOI)
    for _ in range(2):
        at += 2 + int.from_bytes(jpeg[at + 2:at + 4], "big")
    return SOI + jpeg[at:]


def _exif(meta: PictureMeta, site: Site, epoch: datetime) -> Image.Exif:
    taken = epoch + timedelta(microseconds=meta.t_capture_ns // 1000)
    focal_mm = SENSOR_WIDTH_MM * meta.camera.fx_px / meta.camera.width_px
    exif = Image.Exif()
    exif[ExifTags.Base.Make], exif[ExifTags.Base.Model] = MAKE, MODEL
    exif[ExifTags.Base.DateTime] = taken.strftime("%Y:%m:%d %H:%M:%S")
    details = exif.get_ifd(ExifTags.IFD.Exif)
    details[ExifTags.Base.ExifVersion] = b"0300"
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
        gps.GPSVersionID: b"\x02\x04\x00\x00", gps.GPSMapDatum: "WGS-84",
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
