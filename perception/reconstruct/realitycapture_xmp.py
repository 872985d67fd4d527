"""Cameras as XMP files beside the pictures, which RealityCapture (RealityScan) takes with pictures of the same name.

Positions are metres in the site's ENU frame ("absolute" in a project with a local Euclidean coordinate system); the
rotation takes ENU to OpenCV's camera axes, row by row (rchelp.capturingreality.com, "Metadata (XMP) files"). Distortion
is Brown's with the same radial terms as ours, k1 k2 k3 k4, and tangential ones in the other order, p2 p1, which is how
AliceVision and Camorph read these files.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

from perception.reconstruct.optics import Optics
from perception.reconstruct.pictures import SurveyPicture

XCR = "http://www.capturingreality.com/ns/xcr/1.1#"
RDF = "http://www.w3.org/1999/02/22-rdf-syntax-ns#"
FILM_WIDTH_MM = 36.0


def write_realitycapture(pictures: list[SurveyPicture], optics: Optics, folder: Path) -> list[Path]:
    """One file per picture, named like it; returns them. Poses are initial: alignment may refine them. optics: of the
    pictures' files."""
    paths = []
    for picture in pictures:
        path = folder / picture.path.with_suffix(".xmp").name
        ET.ElementTree(_metadata(picture, optics)).write(path)
        paths.append(path)
    return paths


def _metadata(picture: SurveyPicture, optics: Optics) -> ET.Element:
    for prefix, uri in (("x", "adobe:ns:meta/"), ("rdf", RDF), ("xcr", XCR)):
        ET.register_namespace(prefix, uri)
    root = ET.Element("{adobe:ns:meta/}xmpmeta")
    description = ET.SubElement(ET.SubElement(root, f"{{{RDF}}}RDF"), f"{{{RDF}}}Description")
    camera, (k1, k2, p1, p2) = optics.camera, optics.lens
    longer_px = max(camera.width_px, camera.height_px)
    fields = {
        "Version": "3", "PosePrior": "initial", "Coordinates": "absolute", "DistortionModel": "brown3t2",
        "DistortionCoeficients": f"{k1:.9g} {k2:.9g} 0 0 {p2:.9g} {p1:.9g}", "Skew": "0",
        "CalibrationPrior": "initial", "CalibrationGroup": "0",
        "DistortionGroup": "0", "InTexturing": "1", "InMeshing": "1",
        "FocalLength35mm": f"{FILM_WIDTH_MM * camera.fx_px / longer_px:.9f}",
        "AspectRatio": f"{camera.fy_px / camera.fx_px:.9f}",
        "PrincipalPointU": f"{(camera.cx_px - camera.width_px / 2.0) / longer_px:.9f}",
        "PrincipalPointV": f"{(camera.cy_px - camera.height_px / 2.0) / longer_px:.9f}",
    }
    for name, value in fields.items():
        description.set(f"{{{XCR}}}{name}", value)
    _add(description, "Rotation", picture.enu_from_camera.T.ravel().tolist())
    _add(description, "Position", picture.position_enu_m.tolist())
    return root


def _add(parent: ET.Element, name: str, numbers: list[float]) -> None:
    ET.SubElement(parent, f"{{{XCR}}}{name}").text = " ".join(f"{v:.12g}" for v in numbers)
