"""XMP as DJI's cameras write it (drone-dji), which photogrammetry programs read for how a camera was turned.

Angles are degrees in NED, rotations in the order yaw, pitch, roll (DJI, Mavic 3 user manual, "XMP Data List"): yaw
clockwise from true North, pitch 0 level and -90 down, roll lowers the right side. AbsoluteAltitude is above the
WGS 84 ellipsoid, which AltitudeType RtkAlt says; RelativeAltitude is above the take-off point.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET

import numpy as np

from missions.frames import Site, heading_deg_from_yaw_enu
from missions.messages import PictureMeta

HEADER = b"http://ns.adobe.com/xap/1.0/\x00"
"""What precedes XMP in a JPEG's APP1 segment (XMP specification part 3, 1.1.3)."""
DJI = "http://www.dji.com/drone-dji/1.0/"
RDF = "http://www.w3.org/1999/02/22-rdf-syntax-ns#"
FIXED, SINGLE_POINT = 50, 16
"""RtkFlag: centimetres, metres."""
FIXED_WITHIN_M = 0.1


def dji_xmp(meta: PictureMeta, site: Site, home_up_m: float) -> bytes:
    """The packet for a picture, with its header. home_up_m: height of the take-off point in ENU."""
    ET.register_namespace("rdf", RDF)
    ET.register_namespace("drone-dji", DJI)
    ET.register_namespace("x", "adobe:ns:meta/")
    root = ET.Element("{adobe:ns:meta/}xmpmeta")
    description = ET.SubElement(ET.SubElement(root, f"{{{RDF}}}RDF"), f"{{{RDF}}}Description", {f"{{{RDF}}}about": ""})
    for name, value in _fields(meta, site, home_up_m).items():
        description.set(f"{{{DJI}}}{name}", value)
    begin, end = b'<?xpacket begin="\xef\xbb\xbf" id="W5M0MpCehiHzreSzNTczkc9d"?>', b'<?xpacket end="w"?>'
    return HEADER + begin + ET.tostring(root) + end


def _fields(meta: PictureMeta, site: Site, home_up_m: float) -> dict[str, str]:
    lat_deg, lon_deg, height_m = site.geodetic_from_enu(np.array(meta.pose.position_enu_m))
    yaw_deg = math.remainder(heading_deg_from_yaw_enu(meta.pose.yaw_enu_rad), 360.0)
    camera, sigma_m = meta.camera, f"{meta.position_sigma_m:.5f}"
    return {
        "AltitudeType": "RtkAlt", "GpsStatus": "RTK",
        "GpsLatitude": f"{lat_deg:+.9f}", "GpsLongitude": f"{lon_deg:+.9f}",
        "AbsoluteAltitude": f"{height_m:+.4f}", "RelativeAltitude": f"{meta.pose.position_enu_m[2] - home_up_m:+.4f}",
        "GimbalYawDegree": f"{yaw_deg:+.5f}", "GimbalPitchDegree": f"{math.degrees(meta.pose.elevation_rad):+.5f}",
        "GimbalRollDegree": f"{math.degrees(meta.pose.roll_rad):+.5f}",
        "FlightYawDegree": f"{yaw_deg:+.5f}", "FlightPitchDegree": "+0.00", "FlightRollDegree": "+0.00",
        "RtkFlag": str(FIXED if meta.position_sigma_m <= FIXED_WITHIN_M else SINGLE_POINT),
        "RtkStdLon": sigma_m, "RtkStdLat": sigma_m, "RtkStdHgt": sigma_m,
        "CalibratedFocalLength": f"{camera.fx_px:.6f}", "CalibratedOpticalCenterX": f"{camera.cx_px:.6f}",
        "CalibratedOpticalCenterY": f"{camera.cy_px:.6f}",
    }
