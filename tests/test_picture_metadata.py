"""EXIF and DJI's XMP in received pictures, read back with Exiv2."""

from __future__ import annotations

import hashlib
from datetime import datetime

import cv2
import numpy as np
import pyexiv2
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from ground_station.exif import with_metadata, without_metadata
from missions.camera import Camera, Pose
from missions.frames import Site, ned_from_enu
from missions.messages import PictureMeta

CAMERA = Camera(64, 48, 50.0, 50.0, 31.5, 24.25)
EPOCH = datetime.fromisoformat("2026-06-01T10:00:00Z")
JPEG = bytes(cv2.imencode(".jpg", np.full((48, 64, 3), 90, np.uint8))[1])
HOME_UP_M = 0.15
DJI = "Xmp.drone-dji."

poses = st.builds(Pose, st.tuples(*[st.floats(-300.0, 300.0)] * 3), st.floats(-np.pi, np.pi), st.floats(-1.5, 1.5),
                  st.floats(-0.2, 0.2))
sites = st.builds(Site, st.floats(-80, 80), st.floats(-179.9, 179.9), st.floats(-400, 4000))


def read(pose: Pose, site: Site, sigma_m: float = 0.0) -> tuple[dict[str, str], dict[str, str]]:
    """EXIF and XMP of a picture."""
    meta = PictureMeta(vehicle_id=1, view_id=7, phase="survey", t_capture_ns=12_345_000_000, pose=pose,
                       position_sigma_m=sigma_m, speed_m_s=0.0, camera=CAMERA, sha256=hashlib.sha256(JPEG).hexdigest(),
                       size_bytes=len(JPEG))
    with pyexiv2.ImageData(with_metadata(JPEG, meta, site, EPOCH, HOME_UP_M)) as image:
        return image.read_exif(), image.read_xmp()


def test_the_picture_itself_is_not_touched() -> None:
    meta = PictureMeta(vehicle_id=1, view_id=7, phase="survey", t_capture_ns=1, pose=Pose((1.0, 2.0, 3.0), 0.5, -0.2),
                       position_sigma_m=0.02, speed_m_s=0.0, camera=CAMERA, sha256="", size_bytes=len(JPEG))
    site = Site(52.0, 6.0, 40.0)
    assert without_metadata(with_metadata(JPEG, meta, site, EPOCH, HOME_UP_M)) == JPEG


def rational(text: str) -> float:
    above, below = text.split("/")
    return int(above) / int(below)


def degrees(exif: dict[str, str], name: str, negative: str) -> float:
    d, m, s = map(rational, exif[f"Exif.GPSInfo.GPS{name}"].split())
    return (d + m / 60 + s / 3600) * (-1.0 if exif[f"Exif.GPSInfo.GPS{name}Ref"] == negative else 1.0)


@given(pose=poses, site=sites)
@settings(max_examples=40, deadline=None)
def test_exif_and_xmp_say_where_the_picture_was_taken(pose: Pose, site: Site) -> None:
    exif, xmp = read(pose, site)
    below = exif["Exif.GPSInfo.GPSAltitudeRef"] == "1"
    height_m = rational(exif["Exif.GPSInfo.GPSAltitude"]) * (-1.0 if below else 1.0)
    told = site.enu_from_geodetic(degrees(exif, "Latitude", "S"), degrees(exif, "Longitude", "W"), height_m)
    assert np.abs(told - pose.position_enu_m).max() < 1e-3
    again = site.enu_from_geodetic(*(float(xmp[DJI + n]) for n in ("GpsLatitude", "GpsLongitude", "AbsoluteAltitude")))
    assert np.abs(again - pose.position_enu_m).max() < 1e-3
    assert float(xmp[DJI + "RelativeAltitude"]) == pytest.approx(pose.position_enu_m[2] - HOME_UP_M, abs=1e-4)


@given(pose=poses)
@settings(max_examples=40, deadline=None)
def test_the_gimbal_angles_turn_the_camera_as_it_was(pose: Pose) -> None:
    _, xmp = read(pose, Site(52.0, 6.0, 40.0))
    angles = [float(xmp[f"{DJI}Gimbal{name}Degree"]) for name in ("Yaw", "Pitch", "Roll")]
    assert -180.0 <= angles[0] <= 180.0
    forward, right, down = Rotation.from_euler("ZYX", angles, degrees=True).as_matrix().T
    enu_from_camera = ned_from_enu(np.array([right, down, forward])).T
    assert np.abs(enu_from_camera - pose.enu_from_camera).max() < 1e-6


def test_heights_are_ellipsoidal_and_say_so() -> None:
    for alt_m, reference in ((40.0, "0"), (-30.0, "1")):
        exif, xmp = read(Pose((0.0, 0.0, 5.0), 0.0, 0.0), Site(52.0, 6.0, alt_m))
        assert exif["Exif.Photo.ExifVersion"] == "48 51 48 48"  # 3.0, since which 0 and 1 are ellipsoidal
        assert exif["Exif.GPSInfo.GPSAltitudeRef"] == reference
        assert exif["Exif.GPSInfo.GPSMapDatum"] == "WGS-84"
        assert xmp[DJI + "AltitudeType"] == "RtkAlt"
        assert float(xmp[DJI + "AbsoluteAltitude"]) == alt_m + 5.0


@pytest.mark.parametrize(("sigma_m", "flag"), [(0.0, "50"), (0.1, "50"), (1.5, "16")])
def test_how_exactly_the_position_is_known(sigma_m: float, flag: str) -> None:
    exif, xmp = read(Pose((0.0, 0.0, 5.0), 0.0, 0.0), Site(52.0, 6.0, 40.0), sigma_m)
    assert xmp[DJI + "RtkFlag"] == flag
    assert {float(xmp[f"{DJI}RtkStd{axis}"]) for axis in ("Lon", "Lat", "Hgt")} == {sigma_m}
    assert rational(exif["Exif.GPSInfo.GPSHPositioningError"]) == sigma_m


def test_intrinsics_and_time_and_pixels() -> None:
    exif, xmp = read(Pose((0.0, 0.0, 5.0), 0.0, 0.0), Site(52.0, 6.0, 40.0))
    assert [float(xmp[f"{DJI}Calibrated{name}"]) for name in ("FocalLength", "OpticalCenterX", "OpticalCenterY")] == [
        50.0, 31.5, 24.25]
    assert exif["Exif.Photo.DateTimeOriginal"] == "2026:06:01 10:00:12"
