"""`swarmscan bench photograph-set SCENE OUT`: pictures as a person would bring them home, and where they truly were.

What such sets have and a survey of ours has not: a lens that distorts about a point beside the middle, vignetting,
exposure and white balance that change, JPEG with halved chroma, things that move, a GNSS receiver that is metres off,
EXIF that says little. OUT.csv, beside the folder, has the true positions for `swarmscan bench photographs`.
"""

from __future__ import annotations

import argparse
import csv
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import ExifTags, Image
from PIL.TiffImagePlugin import IFDRational
from rich.progress import track

from missions.camera import Camera, Pose
from missions.frames import Array, Site, heading_deg_from_yaw_enu, yaw_elevation_from_forward
from missions.mission import CameraSpec, SiteSpec
from missions.simulation import RenderSpec, SceneSpec
from sim_bridge.render.geometry import Box
from sim_bridge.render.renderer import make_renderer
from sim_bridge.scenes.load import load_scene
from sim_bridge.scenes.scene import Scene

Picture = NDArray[np.uint8]

SITE = Site(46.5, 7.5, 620.0)
FILM_DIAGONAL_MM, SENSOR_DIAGONAL_MM = math.hypot(36.0, 24.0), math.hypot(13.2, 8.8)
FIELD_DEG = 75.0
LENS = (-0.09, 0.03, 0.0008, -0.0006)
AXIS_OFF = (0.006, -0.009)
"""Of the longer side, from the middle."""
VIGNETTE = 0.35
"""Light that corners lose."""
EXPOSURE_EV, WHITE = 0.25, 0.04
"""Standard deviations: of exposure, and of the gains of red and blue."""
XMP = ('<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">'
       '<rdf:Description xmlns:drone-dji="http://www.dji.com/drone-dji/1.0/" {}/></rdf:RDF></x:xmpmeta>')


def main(argv: Sequence[str]) -> int:
    """Run the command; returns the exit code."""
    options = _options(argv)
    scene = load_scene(SceneSpec(name=options.scene), SiteSpec())
    width, height = options.size
    pinhole = Camera.from_diagonal_fov(width, height, FIELD_DEG)
    off = max(width, height) * np.array(AXIS_OFF)
    camera = Camera(width, height, pinhole.fx_px, pinhole.fy_px, pinhole.cx_px + off[0], pinhole.cy_px + off[1])
    poses = FLIGHTS[options.flight](scene, options.pictures, options.distance)
    rng = np.random.default_rng(options.seed)
    options.out.mkdir(parents=True, exist_ok=True)
    renderer = make_renderer(scene, RenderSpec(), CameraSpec(distortion=LENS, noise_dn=2.0), seed=options.seed)
    with options.out.with_suffix(".csv").open("w", newline="", encoding="utf-8") as f:
        truth = csv.writer(f)
        truth.writerow(("picture", "east_m", "north_m", "up_m"))
        for k, pose in enumerate(track(poses, "pictures")):
            drawn = renderer.render(camera, pose, _moving(scene, options.moving, rng), k)
            path = options.out / f"DJI_{k + 1:04d}.JPG"
            Image.fromarray(_developed(drawn, rng)).save(
                path, quality=options.quality, subsampling="4:2:0", **_metadata(options, camera, pose, k, rng))
            truth.writerow((path.name, *pose.position_enu_m))
    renderer.close()
    return 0


def _options(argv: Sequence[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="swarmscan bench photograph-set", description=__doc__)
    parser.add_argument("scene", help="a built-in structure")
    parser.add_argument("out", type=Path, help="folder for the pictures")
    parser.add_argument("--flight", choices=tuple(FLIGHTS), default="rings", help="how the camera goes")
    parser.add_argument("--pictures", type=int, default=48, metavar="N")
    parser.add_argument("--distance", type=float, default=25.0, metavar="M", help="from the object (default: 25)")
    parser.add_argument("--size", type=int, nargs=2, default=(4000, 3000), metavar=("W", "H"), help="pixels")
    parser.add_argument("--exif", choices=("dji", "millimetres", "none"), default="dji", help="what the pictures say")
    parser.add_argument("--gps-sigma", type=float, default=2.0, metavar="M", help="error of each position")
    parser.add_argument("--altitude-offset", type=float, default=20.0, metavar="M", help="common to all altitudes")
    parser.add_argument("--moving", type=int, default=4, metavar="N", help="things that move about")
    parser.add_argument("--quality", type=int, default=90, help="of the JPEG files")
    parser.add_argument("--seed", type=int, default=1)
    return parser.parse_args(argv)


def _nadir(scene: Scene, count: int, distance_m: float) -> list[Pose]:
    """Strips to and fro above the object, straight down."""
    low, high = np.array(scene.object_min_enu_m), np.array(scene.object_max_enu_m)
    span = high[:2] - low[:2] + distance_m
    rows = max(2, round(math.sqrt(count * span[1] / span[0])))
    columns = math.ceil(count / rows)
    middle = (low + high)[:2] / 2.0
    poses = []
    for k in range(count):
        row, column = divmod(k, columns)
        along = column if row % 2 == 0 else columns - 1 - column
        x, y = middle + span * (np.array([along / (columns - 1), row / (rows - 1)]) - 0.5)
        poses.append(Pose((float(x), float(y), float(high[2]) + distance_m), math.pi * (row % 2), math.radians(-89.5)))
    return poses


def _rings(scene: Scene, count: int, distance_m: float) -> list[Pose]:
    """Twice around, below and above the top, looking at the object."""
    low, high = np.array(scene.object_min_enu_m), np.array(scene.object_max_enu_m)
    middle, half = (low + high) / 2.0, (high - low) / 2.0 + distance_m
    poses = []
    for k in range(count):
        ring, angle = k * 2 // count, 4.0 * math.pi * k / count
        place = middle + np.array([half[0] * math.cos(angle), half[1] * math.sin(angle), 0.0])
        place[2] = low[2] + (high[2] - low[2]) * (0.5, 1.1)[ring] + (0.0, 0.4)[ring] * distance_m
        aim = middle + np.array([0.3 * (high - low)[0] * math.cos(angle), 0.0, 0.0])
        poses.append(Pose((float(place[0]), float(place[1]), float(place[2])),
                          *yaw_elevation_from_forward(aim - place)))
    return poses


def _mixed(scene: Scene, count: int, distance_m: float) -> list[Pose]:
    """A third straight down, the rest around."""
    return [*_nadir(scene, count // 3, distance_m), *_rings(scene, count - count // 3, distance_m)]


FLIGHTS = {"nadir": _nadir, "rings": _rings, "mixed": _mixed}


def _moving(scene: Scene, count: int, rng: np.random.Generator) -> list[Box]:
    """Cars and people on the ground around."""
    low, high = np.array(scene.object_min_enu_m), np.array(scene.object_max_enu_m)
    places = rng.uniform(low[:2] - 10.0, high[:2] + 10.0, (count, 2))
    sizes = rng.choice([[4.2, 1.8, 1.5], [0.6, 0.5, 1.8]], count)
    return [([*p.tolist(), scene.ground_up_m + s[2] / 2.0], s.tolist()) for p, s in zip(places, sizes, strict=True)]


def _developed(drawn: Picture, rng: np.random.Generator) -> Picture:
    """As an automatic camera would have kept it."""
    height, width = drawn.shape[:2]
    y, x = np.linspace(-1.0, 1.0, height, dtype=np.float32), np.linspace(-1.0, 1.0, width, dtype=np.float32)
    fade = 1.0 - VIGNETTE * ((y * y)[:, None] + (x * x)[None]) ** 2 / 4.0
    gain = 2.0 ** rng.normal(0.0, EXPOSURE_EV) * (1.0 + np.array([1.0, 0.0, 1.0]) * rng.normal(0.0, WHITE, 3))
    bright = drawn * fade[..., None] * gain.astype(np.float32)
    return np.asarray(np.clip(np.rint(bright), 0, 255), np.uint8)


def _metadata(options: argparse.Namespace, camera: Camera, pose: Pose, number: int,
              rng: np.random.Generator) -> dict[str, Any]:
    """What Pillow is to write beside the pixels."""
    if options.exif == "none":
        return {}
    exif = Image.Exif()
    maker = ("DJI", "FC6310") if options.exif == "dji" else ("Maker", "Unknown 1")
    exif[ExifTags.Base.Make], exif[ExifTags.Base.Model] = maker
    details, focal = exif.get_ifd(ExifTags.IFD.Exif), camera.fx_px / math.hypot(camera.width_px, camera.height_px)
    details[ExifTags.Base.FocalLength] = IFDRational(round(1000 * focal * SENSOR_DIAGONAL_MM), 1000)
    details[ExifTags.Base.DateTimeOriginal] = f"2024:05:01 10:{number // 30 % 60:02d}:{number % 30 * 2:02d}"
    if options.exif != "dji":
        return {"exif": exif.tobytes()}
    details[ExifTags.Base.FocalLengthIn35mmFilm] = round(focal * FILM_DIAGONAL_MM)
    told = np.array(pose.position_enu_m) + rng.normal(0.0, 1.0, 3) * options.gps_sigma
    exif.get_ifd(ExifTags.IFD.GPSInfo).update(_gps(told + np.array([0.0, 0.0, options.altitude_offset])))
    angles = {"Yaw": heading_deg_from_yaw_enu(pose.yaw_enu_rad), "Pitch": math.degrees(pose.elevation_rad), "Roll": 0.0}
    fields = {f"Gimbal{name}Degree": f"{angle + rng.normal(0.0, 1.0):+.2f}" for name, angle in angles.items()}
    fields["RelativeAltitude"] = f"{told[2]:+.2f}"
    return {"exif": exif.tobytes(),
            "xmp": XMP.format(" ".join(f'drone-dji:{k}="{v}"' for k, v in fields.items())).encode()}


def _gps(position_enu_m: Array) -> dict[int, object]:
    lat, lon, alt = SITE.geodetic_from_enu(position_enu_m)
    return {ExifTags.GPS.GPSLatitudeRef: "N", ExifTags.GPS.GPSLatitude: _dms(lat),
            ExifTags.GPS.GPSLongitudeRef: "E", ExifTags.GPS.GPSLongitude: _dms(lon),
            ExifTags.GPS.GPSAltitudeRef: b"\x00", ExifTags.GPS.GPSAltitude: IFDRational(round(alt * 1000), 1000)}


def _dms(degrees: float) -> tuple[IFDRational, IFDRational, IFDRational]:
    micro = round(degrees * 3_600_000_000)
    return (IFDRational(micro // 3_600_000_000, 1), IFDRational(micro // 60_000_000 % 60, 1),
            IFDRational(micro % 60_000_000, 1_000_000))
