"""A model put into its frame, drawn anew as the pictures of one pinhole, and what it says of where its surface is."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pycolmap

from missions.camera import Camera
from missions.errors import UserError
from missions.frames import Array
from perception.lens import redrawn
from perception.photographs.georeference import Placement, Stations
from perception.photographs.photograph import STORED_FROM_UPRIGHT, Photograph, read_pixels
from perception.reconstruct.optics import Optics
from perception.reconstruct.pictures import SurveyPicture

LONGEST_PX = 4096
JPEG_QUALITY = 96
LEAST_TRACK = 3
NEARLY_ALL, FEW_OF_USUAL = 0.8, 0.5


def members(model: pycolmap.Reconstruction) -> list[int]:
    """Indices of the photographs that the model holds, in order."""
    return sorted(image_id - 1 for image_id in model.reg_image_ids())


def stations(model: pycolmap.Reconstruction, photographs: Sequence[Photograph], placed_enu_m: Array) -> Stations:
    """Where the model's pictures stand. placed_enu_m: (n, 3) of all photographs."""
    which = members(model)
    poses = [model.image(i + 1).cam_from_world().inverse() for i in which]
    rotation = [p.rotation.matrix() @ np.linalg.matrix_power(STORED_FROM_UPRIGHT, _upright_turns(photographs[i]))
                for i, p in zip(which, poses, strict=True)]
    told = [m.gimbal_deg if (m := photographs[i].metadata) else None for i in which]
    return Stations(np.array(rotation), np.array([p.translation for p in poses]), placed_enu_m[which], told)


def _upright_turns(photograph: Photograph) -> int:
    return photograph.metadata.upright_turn_deg // 90 if photograph.metadata else 0


def leave_out_misplaced(model: pycolmap.Reconstruction, placement: Placement) -> list[int]:
    """Takes out of the model, and returns, the photographs that hang in it by few points at a place that their GPS
    positions contradict, where those of nearly all others agree: structures that look alike mislead such pictures."""
    if placement.by != "GPS" or placement.agreeing < NEARLY_ALL * (placement.agreeing + len(placement.outliers)):
        return []
    points = {i: model.image(i + 1).num_points3D for i in members(model)}
    few = FEW_OF_USUAL * float(np.median(list(points.values())))
    misplaced = [i for i in placement.outliers if points[i] < few]
    for i in misplaced:
        model.deregister_frame(i + 1)
    return misplaced


@dataclass(frozen=True)
class Surface:
    """Where the points of a model lie."""

    lower: Array
    """(3,) corner of the box around most of them, with a margin."""
    upper: Array
    near: float
    """Depths within which the pictures see them."""
    usual: float
    far: float


def surface(model: pycolmap.Reconstruction) -> Surface:
    """Of points that at least LEAST_TRACK pictures see, else of all."""
    points = [p for p in model.points3D.values() if p.track.length() >= LEAST_TRACK] or list(model.points3D.values())
    poses = {i: model.image(i).cam_from_world().matrix() for i in model.reg_image_ids()}
    xyz = np.array([p.xyz for p in points])
    depth = np.array([poses[e.image_id][2] @ [*p.xyz, 1.0] for p in points for e in p.track.elements])
    low, high = np.percentile(xyz, [0.5, 99.5], axis=0)
    margin = 0.1 * (high - low) + 0.02 * float(np.linalg.norm(high - low))
    near, usual, far = np.percentile(depth[depth > 0.0], [1.0, 50.0, 99.0])
    return Surface(low - margin, high + margin, 0.6 * float(near), float(usual), 1.6 * float(far))


def common_camera(model: pycolmap.Reconstruction, photographs: Sequence[Photograph]) -> Camera:
    """The pinhole that all pictures are drawn for: size, as shown upright, and focal length of most of them."""
    which = members(model)
    usual = Counter((model.image(i + 1).camera_id, _upright_turns(photographs[i]) % 2) for i in which)
    (camera_id, across), _ = usual.most_common(1)[0]
    camera = model.camera(camera_id)
    w, h = (camera.height, camera.width) if across else (camera.width, camera.height)
    share = min(1.0, LONGEST_PX / max(w, h))
    f = camera.mean_focal_length() * share
    w, h = round(w * share), round(h * share)
    return Camera(w, h, f, f, w / 2.0, h / 2.0)


def redraw(model: pycolmap.Reconstruction, photographs: Sequence[Photograph], index: int, wanted: Camera,
           path: Path) -> SurveyPicture:
    """Write a photograph as the wanted pinhole sees it, upright where that fits; returns it with its pose."""
    photograph = photographs[index]
    image = model.image(index + 1)
    optics = Optics.of(model.camera(image.camera_id))
    camera = optics.camera
    turns = _upright_turns(photograph)
    lies = (camera.width_px >= camera.height_px) == (turns % 2 == 0)
    if lies != (wanted.width_px >= wanted.height_px):
        turns -= 1
    if not path.is_file():
        drawn = redrawn(read_pixels(photograph), camera, optics.lens, wanted, turns)
        unfinished = path.with_name(f"part-{path.name}")
        if not cv2.imwrite(str(unfinished), drawn, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY]):
            raise UserError(f"{path}: cannot be written; free some disk space or choose another folder with --out.")
        unfinished.replace(path)
    pose = image.cam_from_world().inverse()
    rotation = pose.rotation.matrix() @ np.linalg.matrix_power(STORED_FROM_UPRIGHT, turns % 4)
    return SurveyPicture(index + 1, path, wanted, rotation, np.asarray(pose.translation))


def spacing_for(distance: float, camera: Camera, depth_width_px: int) -> float:
    """Of the cloud: two pixels of a depth map at the usual distance, rounded to two digits."""
    pixel = distance / (camera.fx_px * depth_width_px / camera.width_px)
    digits = 1 - math.floor(math.log10(2.0 * pixel))
    return round(2.0 * pixel, digits)
