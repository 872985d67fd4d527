"""A contact sheet of scenes: pictures from two sides with sizes and parameters, as one HTML page or one PNG."""

from __future__ import annotations

import base64
import html
import io
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from missions.camera import Camera, Pose
from missions.errors import UserError
from missions.mission import CameraSpec
from missions.simulation import RenderSpec
from sim_bridge.render import make_renderer
from sim_bridge.render.light import Bytes
from sim_bridge.scenes.scene import Scene

PICTURE_PX = (480, 300)
VIEWS = ((-60.0, 16.0), (150.0, 30.0))
"""Azimuth from the object to the camera, counter-clockwise from East, and its elevation, degrees."""
DIAGONAL_FOV_DEG = 50.0
COLUMNS = 4
CAPTION_PX = 18

STYLE = """body{font:14px/1.45 system-ui,sans-serif;margin:24px;max-width:1500px;background:#fff;color:#222}
h2{margin:32px 0 8px}.cards{display:grid;grid-template-columns:repeat(auto-fill,minmax(480px,1fr));gap:16px}
figure{margin:0}img{width:50%;display:inline-block;vertical-align:top}figcaption{padding:6px 0;color:#444}
b{color:#111}code{font-size:12px;color:#666}"""


@dataclass(frozen=True)
class Card:
    """One scene on the sheet. group is the heading that it stands under; facts is a line of text."""

    group: str
    title: str
    facts: str
    pictures: tuple[Bytes, ...]


def portraits(scene: Scene) -> tuple[Bytes, ...]:
    """(h, w, 3) pictures of the whole object from two sides."""
    camera = Camera.from_diagonal_fov(*PICTURE_PX, DIAGONAL_FOV_DEG)
    renderer = make_renderer(scene, RenderSpec(), CameraSpec(), seed=1)
    try:
        poses = [whole_object(scene, camera, math.radians(azimuth), math.radians(up)) for azimuth, up in VIEWS]
        return tuple(renderer.render(camera, pose, [], key) for key, pose in enumerate(poses))
    finally:
        renderer.close()


def whole_object(scene: Scene, camera: Camera, azimuth_rad: float, elevation_rad: float) -> Pose:
    """The nearest pose in a direction from the object's middle from which its whole box is in the picture."""
    lo, hi = np.array(scene.object_min_enu_m), np.array(scene.object_max_enu_m)
    level = math.cos(elevation_rad)
    outward = np.array([math.cos(azimuth_rad) * level, math.sin(azimuth_rad) * level, math.sin(elevation_rad)])
    right = np.array([-math.sin(azimuth_rad), math.cos(azimuth_rad), 0.0])
    up = np.cross(outward, right)
    corners = np.array(np.meshgrid(*zip(lo, hi, strict=True))).reshape(3, -1).T - (lo + hi) / 2
    wide, high = (np.abs(corners @ axis) / math.tan(half) for axis, half in
                  zip((right, up), camera.half_fov_rad, strict=True))
    distance = 1.04 * float((np.maximum(wide, high) + corners @ outward).max())
    east, north, above = (float(c) for c in (lo + hi) / 2 + distance * outward)
    return Pose((east, north, above), math.atan2(-outward[1], -outward[0]), -elevation_rad)


def write_gallery(path: Path, cards: Sequence[Card]) -> None:
    """Write the sheet; the file's suffix says as what. Raises UserError for another suffix or an unwritable file."""
    check_suffix(path)
    try:
        if path.suffix.lower() == ".html":
            path.write_text(_page(cards), encoding="utf-8")
        else:
            Image.fromarray(_sheet(cards)).save(path)
    except OSError as e:
        raise UserError(f"{path}: cannot be written ({e.strerror}); choose another file.") from e


def check_suffix(path: Path) -> None:
    """Accept .html and .png. Raises UserError otherwise."""
    if path.suffix.lower() not in (".html", ".png"):
        raise UserError(f"{path}: the gallery is written as .html or .png; give the file one of these suffixes.")


def _page(cards: Sequence[Card]) -> str:
    parts = [f"<!doctype html><meta charset='utf-8'><title>Scenes</title><style>{STYLE}</style><h1>Scenes</h1>"]
    for group in dict.fromkeys(card.group for card in cards):
        parts.append(f"<h2>{html.escape(group)}</h2><div class='cards'>")
        for card in cards:
            if card.group == group:
                pictures = "".join(f"<img alt='' src='{_data_uri(p)}'>" for p in card.pictures)
                parts.append(f"<figure>{pictures}<figcaption><b>{html.escape(card.title)}</b><br>"
                             f"<code>{html.escape(card.facts)}</code></figcaption></figure>")
        parts.append("</div>")
    return "\n".join(parts) + "\n"


def _data_uri(picture: Bytes) -> str:
    stream = io.BytesIO()
    Image.fromarray(picture).save(stream, "JPEG", quality=85)
    return f"data:image/jpeg;base64,{base64.b64encode(stream.getvalue()).decode('ascii')}"


def _sheet(cards: Sequence[Card]) -> Bytes:
    """All first pictures in rows of four, each under its title."""
    width, height = PICTURE_PX
    rows = math.ceil(len(cards) / COLUMNS)
    sheet = Image.new("RGB", (COLUMNS * width, rows * (height + CAPTION_PX)), "white")
    draw = ImageDraw.Draw(sheet)
    for k, card in enumerate(cards):
        x, y = k % COLUMNS * width, k // COLUMNS * (height + CAPTION_PX)
        sheet.paste(Image.fromarray(card.pictures[0]), (x, y + CAPTION_PX))
        draw.text((x + 4, y + 3), f"{card.group}: {card.title}", fill="black")
    return np.asarray(sheet)
