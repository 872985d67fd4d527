"""Exploration's pictures, for a survey picture that no other one overlaps enough: they stood nearby, smaller but posed.

They are taken as pictures of the survey's camera, enlarged, so that all share one camera and one lens.
"""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np

from missions.camera import Camera
from perception.reconstruct.bundle import Adjusted
from perception.reconstruct.features import COUNT, WIDTH_PX, Features, sift
from perception.reconstruct.pictures import SurveyPicture, grey, read_stored

EACH = 8
MAX_TURN_DEG = 45.0


def witnesses(lonely: list[SurveyPicture], explored: list[SurveyPicture], distance_m: float) -> list[SurveyPicture]:
    """The exploration pictures nearest to each lonely one, within distance_m and turned from it by 45 degrees at most;
    in the order of exploration. Those whose file has gone are left out."""
    if not explored:
        return []
    position = np.array([p.position_enu_m for p in explored])
    forward = np.array([p.forward_enu for p in explored])
    chosen: set[int] = set()
    for picture in lonely:
        away = np.linalg.norm(position - picture.position_enu_m, axis=1)
        fit = (away <= distance_m) & (forward @ picture.forward_enu >= math.cos(math.radians(MAX_TURN_DEG)))
        nearest = np.argsort(away, kind="stable")
        chosen |= {int(i) for i in nearest[fit[nearest]][:EACH] if explored[i].path.is_file()}
    return [explored[i] for i in sorted(chosen)]


def features_of(witness: SurveyPicture, camera: Camera) -> Features:
    """As if the survey's camera had taken it. Raises UserError when it cannot be read."""
    width = min(WIDTH_PX, camera.width_px)
    reduced = camera.scaled(width, round(camera.height_px * width / camera.width_px))
    own, scale = witness.camera, reduced.fx_px / witness.camera.fx_px
    shift = np.array([reduced.cx_px - 0.5, reduced.cy_px - 0.5]) - scale * np.array([own.cx_px - 0.5, own.cy_px - 0.5])
    enlarged = cv2.warpAffine(read_stored(witness), np.column_stack([scale * np.eye(2), shift]),
                              (reduced.width_px, reduced.height_px), flags=cv2.INTER_CUBIC)
    return sift(grey(np.ascontiguousarray(enlarged[:, :, ::-1])), COUNT, camera.width_px / width)


def of_the_first(found: Adjusted, count: int) -> Adjusted:
    """What was found of the first count pictures, and the points that they see."""
    mine = found.picture_of < count
    seen, point_of = np.unique(found.point_of[mine], return_inverse=True)
    return replace(found, enu_from_camera=found.enu_from_camera[:count], position_enu_m=found.position_enu_m[:count],
                   points_enu_m=found.points_enu_m[seen], picture_of=found.picture_of[mine], point_of=point_of,
                   feature_of=found.feature_of[mine], seen_px=found.seen_px[mine])
