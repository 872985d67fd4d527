"""Lines of many pictures by place: which one passes near a point of a picture, in a given direction."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from missions.frames import Array
from perception.depth.compiled import compiled
from perception.reconstruct.pictures import SurveyPicture
from perception.wires.ridges import SAMPLE_PX, Float, Index, Ridges

CELL_PX = 4
NEAR_PX = 2.0
"""A line passes near a point at this distance."""
ALONG_PX = SAMPLE_PX + 1.0
"""A sample speaks for its line over so much of it to both sides."""


class Lines(NamedTuple):
    """A picture's samples sorted by cells of CELL_PX pixels, row by row; first[c] is the first one of cell c."""

    ridges: Ridges
    normal: Array
    """(n, 3) unit, ENU, of the plane through the camera and the line at the sample."""
    first: Index
    columns: int


class Seen(NamedTuple):
    """The lines of several pictures, one after the other; those of picture j from starts[j], its cells from cells[j].

    rotations (k, 3, 3) camera_from_enu, centres (k, 3), matrices (k, 6): fx, fy, cx, cy, width, height.
    """

    rotations: Array
    centres: Array
    matrices: Array
    place_px: Float
    direction: Float
    chain: Index
    normal: Array
    first: Index
    columns: NDArray[np.int64]
    starts: NDArray[np.int64]
    cells: NDArray[np.int64]


def sorted_lines(found: Ridges, picture: SurveyPicture) -> Lines:
    """For a picture's ridges."""
    camera = picture.camera
    columns, rows = camera.width_px // CELL_PX + 1, camera.height_px // CELL_PX + 1
    cell = np.floor(found.place_px / CELL_PX).astype(np.int64)
    key = np.clip(cell[:, 1], 0, rows - 1) * columns + np.clip(cell[:, 0], 0, columns - 1)
    order = np.argsort(key, kind="stable")
    ordered = found.select(order)
    first = np.searchsorted(key[order], np.arange(columns * rows + 1)).astype(np.int32)
    along = np.column_stack([ordered.direction / np.array([camera.fx_px, camera.fy_px]), np.zeros(len(order))])
    normal = np.cross(rays_enu(ordered, picture), along @ picture.enu_from_camera.T)
    return Lines(ordered, normal / np.linalg.norm(normal, axis=1, keepdims=True), first, columns)


def rays_enu(found: Ridges, picture: SurveyPicture) -> Array:
    """(n, 3) directions of samples, one metre deep."""
    c = picture.camera
    pinhole = (found.place_px.astype(np.float64) - [c.cx_px, c.cy_px]) / [c.fx_px, c.fy_px]
    return np.asarray(np.column_stack([pinhole, np.ones(len(pinhole))]) @ picture.enu_from_camera.T)


def gathered(pictures: list[SurveyPicture], lines: list[Lines]) -> Seen:
    """Of several pictures."""
    cameras = [p.camera for p in pictures]
    matrices = np.array([[c.fx_px, c.fy_px, c.cx_px, c.cy_px, c.width_px, c.height_px] for c in cameras], np.float64)
    return Seen(
        rotations=np.array([p.enu_from_camera.T for p in pictures]),
        centres=np.array([p.position_enu_m for p in pictures]), matrices=matrices,
        place_px=np.concatenate([x.ridges.place_px for x in lines]),
        direction=np.concatenate([x.ridges.direction for x in lines]),
        chain=np.concatenate([x.ridges.chain for x in lines]), normal=np.concatenate([x.normal for x in lines]),
        first=np.concatenate([x.first for x in lines]), columns=np.array([x.columns for x in lines]),
        starts=np.cumsum([0, *(len(x.normal) for x in lines)]), cells=np.cumsum([0, *(len(x.first) for x in lines)]))


@compiled
def nearest(seen: Seen, j: int, x: float, y: float, dx: float, dy: float, turn_cos: float) -> int:
    """The sample of picture j whose line passes nearest to a point, within NEAR_PX, along a unit direction; or -1."""
    base, cells, columns = seen.starts[j], seen.cells[j], seen.columns[j]
    rows = (seen.cells[j + 1] - cells - 1) // columns
    best, closest = -1, NEAR_PX
    top, bottom = max(0, int((y - ALONG_PX) // CELL_PX)), min(rows - 1, int((y + ALONG_PX) // CELL_PX))
    left, right = max(0, int((x - ALONG_PX) // CELL_PX)), min(columns - 1, int((x + ALONG_PX) // CELL_PX))
    for row in range(top, bottom + 1):
        cell = cells + row * columns
        for k in range(base + seen.first[cell + left], base + seen.first[cell + right + 1]):
            ex, ey = x - seen.place_px[k, 0], y - seen.place_px[k, 1]
            tx, ty = seen.direction[k, 0], seen.direction[k, 1]
            aside = abs(ex * ty - ey * tx)
            if aside < closest and abs(ex * tx + ey * ty) <= ALONG_PX and abs(tx * dx + ty * dy) >= turn_cos:
                best, closest = k, aside
    return best
