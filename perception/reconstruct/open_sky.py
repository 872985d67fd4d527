"""Where pictures show open sky there is nothing on the whole ray: what was reconstructed there is none."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray

from missions.frames import Array
from perception.depth.sky import sky_and_gaps
from perception.reconstruct.pictures import SurveyPicture, read_colour
from perception.reconstruct.resources import in_order
from perception.reconstruct.settings import Progress

WIDTH_PX = 1920
"""Width at which sky is looked for, at most."""


def sky_votes(points_enu_m: Array, pictures: list[SurveyPicture], reach_m: float, threads: int,
              progress: Progress) -> NDArray[np.int64]:
    """(n,) pictures from within reach_m that show sky, also between the members of a structure, in the place of each
    point (n, 3). `progress` is told "sky"."""
    votes = np.zeros(len(points_enu_m), np.int64)
    with ThreadPoolExecutor(threads) as pool:
        found = in_order(pool, lambda p: _in_sky(points_enu_m, p, reach_m), pictures, 2 * threads)
        for done, rows in enumerate(found, start=1):
            votes[rows] += 1
            progress("sky", done, len(pictures))
    return votes


def _in_sky(points_enu_m: Array, picture: SurveyPicture, reach_m: float) -> NDArray[np.int64]:
    """Points in whose place a picture shows sky."""
    width_px = min(WIDTH_PX, picture.camera.width_px)
    camera = picture.camera_at(width_px)
    near = np.flatnonzero(np.linalg.norm(points_enu_m - picture.position_enu_m, axis=1) < reach_m)
    local = (points_enu_m[near] - picture.position_enu_m) @ picture.enu_from_camera
    near, local = near[local[:, 2] > 0.1], local[local[:, 2] > 0.1]
    pixel = np.floor(local[:, :2] / local[:, 2:] * [camera.fx_px, camera.fy_px] + [camera.cx_px, camera.cy_px])
    inside = np.all((pixel >= 0) & (pixel < [camera.width_px, camera.height_px]), axis=1)
    column, row = pixel[inside].astype(np.int64).T
    sky = sky_and_gaps(read_colour(picture, width_px), camera, picture.pose)
    return np.asarray(near[inside][sky[row, column]])
