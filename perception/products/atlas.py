"""A texture for a surface: pieces of pictures, cut out where they are best, made equally bright, in one image."""

from __future__ import annotations

import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import spsolve

from missions.errors import UserError
from missions.frames import Array
from perception.products.best_pictures import NONE, project
from perception.products.surface import Surface
from perception.reconstruct.pictures import SurveyPicture, read_colour

GUTTER_PX = 2
"""Of picture around every piece, so that filtering at its edge finds the same surface."""
PATCH_PX = 3
"""A triangle that no picture shows has a square of its vertices' colour."""
SMALLEST_PX = 512
BISECTIONS = 10
GAIN_PRIOR = 1.0
"""How much a piece is held to its own brightness, against one seam vertex."""
GAIN_RANGE = (0.6, 1.6)
ODD_RATIO = 1.5
"""Pieces whose brightness differs more where they meet do not show the same there."""


@dataclass(frozen=True)
class Textured:
    """A surface with an image (h, w, 3) RGB and where in it each corner lies: (f, 3, 2) pixels, right and down."""

    surface: Surface
    image: NDArray[np.uint8]
    corner_px: NDArray[np.float32]


@dataclass(frozen=True)
class Cut:
    """How a texture was cut out: pieces, their scale against their pictures, share of triangles that none shows."""

    pieces: int
    scale: float
    unseen: float


@dataclass(frozen=True)
class _Layout:
    """Where things lie in a square: left top corners of pieces, then of patches (n + m, 2); sizes of pieces (n, 2)."""

    side_px: int
    scale: float
    places: NDArray[np.int64]
    sizes: NDArray[np.int64]


@dataclass(frozen=True)
class _Pieces:
    """Connected triangles of one picture each. Boxes (left, top, right, bottom) in the picture's pixels."""

    of_face: NDArray[np.int64]
    picture: NDArray[np.int64]
    box_px: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.picture)


def textured(surface: Surface, pictures: list[SurveyPicture], chosen: NDArray[np.int32], largest_px: int,
             threads: int = 1, told: Callable[[int], None] = lambda done: None) -> tuple[Textured, Cut]:
    """The surface with a square texture of at most largest_px, from the picture chosen for each triangle.

    Pieces are as large as in their pictures, or as much smaller as they have to be. `told` hears how many pictures
    have been cut up.
    """
    corner_px = _corners(surface, pictures, chosen)
    pieces = _pieces(surface, chosen, corner_px)
    layout = _packed(pieces, int(np.sum(chosen == NONE)), largest_px)
    image = np.zeros((layout.side_px, layout.side_px, 3), np.uint8)

    def cut_up(k: int) -> None:
        colours = read_colour(pictures[k], pictures[k].camera.width_px)
        for i in np.flatnonzero(pieces.picture == k).tolist():
            _paste(image, colours, pieces.box_px[i], layout.places[i], layout.sizes[i])

    with ThreadPoolExecutor(threads) as pool:
        for done, _ in enumerate(pool.map(cut_up, np.unique(pieces.picture).tolist()), start=1):
            told(done)
    shown = chosen != NONE
    piece = pieces.of_face[shown]
    scale = layout.sizes[piece] / (pieces.box_px[piece, 2:] - pieces.box_px[piece, :2])
    offset = corner_px[shown] - pieces.box_px[piece, None, :2]
    corner_px[shown] = layout.places[piece, None] + offset * scale[:, None]
    corner_px[~shown] = _patches(image, surface, ~shown, layout.places[len(pieces):])
    _level(image, surface, pieces, shown, corner_px, layout)
    cut = Cut(len(pieces), layout.scale, float(1.0 - shown.mean()))
    return Textured(surface, image, corner_px.astype(np.float32)), cut


def _corners(surface: Surface, pictures: list[SurveyPicture], chosen: NDArray[np.int32]) -> Array:
    """(f, 3, 2) where each corner lies in the triangle's picture; zero where it has none."""
    corner_px = np.zeros((len(surface), 3, 2))
    for k, picture in enumerate(pictures):
        rows = np.flatnonzero(chosen == k)
        if len(rows):
            points = surface.corners_enu_m[rows].reshape(-1, 3)
            corner_px[rows] = project(picture, picture.camera, points)[0].reshape(-1, 3, 2)
    return corner_px


def _pieces(surface: Surface, chosen: NDArray[np.int32], corner_px: Array) -> _Pieces:
    pairs, _ = surface.shared_edges
    joined = pairs[chosen[pairs[:, 0]] == chosen[pairs[:, 1]]]
    graph = coo_array((np.ones(len(joined), np.bool_), (joined[:, 0], joined[:, 1])), shape=(len(surface),) * 2)
    group = connected_components(graph, directed=False)[1]
    shown = np.flatnonzero(chosen != NONE)
    _, first, of_shown = np.unique(group[shown], return_index=True, return_inverse=True)
    of_face = np.full(len(surface), NONE, np.int64)
    of_face[shown] = of_shown
    low, high = np.full((len(first), 2), np.inf), np.full((len(first), 2), -np.inf)
    np.minimum.at(low, of_shown, corner_px[shown].min(axis=1))
    np.maximum.at(high, of_shown, corner_px[shown].max(axis=1))
    box = np.concatenate([np.floor(low) - GUTTER_PX, np.ceil(high) + GUTTER_PX], axis=1).astype(np.int64)
    return _Pieces(of_face, chosen[shown[first]].astype(np.int64), box)


def _sizes(pieces: _Pieces, scale: float) -> NDArray[np.int64]:
    """(n, 2) width and height of each piece in the image."""
    size = pieces.box_px[:, 2:] - pieces.box_px[:, :2]
    return np.asarray(np.maximum(np.ceil(size * scale), 2 * GUTTER_PX + 1).astype(np.int64))


def _packed(pieces: _Pieces, patches: int, largest_px: int) -> _Layout:
    """Everything at full size in the smallest square that holds it, else in the largest at the largest scale that fits.

    Raises UserError when even the smallest pieces do not fit.
    """
    side_px = min(SMALLEST_PX, largest_px)
    while (full := _placed(pieces, patches, 1.0, side_px)) is None and side_px < largest_px:
        side_px = min(2 * side_px, largest_px)
    low, high, best = 0.0, 1.0, full
    for _ in range(BISECTIONS if full is None else 0):
        scale = 0.5 * (low + high)
        found = _placed(pieces, patches, scale, side_px)
        low, high, best = (low, scale, best) if found is None else (scale, high, found)
    if best is None:
        raise UserError(f"reconstruct.texture_px {largest_px}: too small for the {len(pieces)} pieces of the texture; "
                        "raise it or lower reconstruct.model_triangles.")
    return best


def _placed(pieces: _Pieces, patches: int, scale: float, side_px: int) -> _Layout | None:
    sizes = _sizes(pieces, scale)
    places = shelves(np.concatenate([sizes, np.full((patches, 2), PATCH_PX)]), side_px)
    return None if places is None else _Layout(side_px, scale, places, sizes)


def shelves(sizes: NDArray[np.int64], side_px: int) -> NDArray[np.int64] | None:
    """(n, 2) left top corners of rectangles (n, 2: width, height) in a square, None when they do not fit.

    In shelves from the top, the highest first (next fit, decreasing height): Coffman et al. 1980.
    """
    places = np.zeros_like(sizes)
    left, top, height = 0, 0, 0
    for i in np.argsort(-sizes[:, 1], kind="stable").tolist():
        w, h = int(sizes[i, 0]), int(sizes[i, 1])
        if left + w > side_px:
            left, top, height = 0, top + height, 0
        height = max(height, h)
        if w > side_px or top + height > side_px:
            return None
        places[i] = left, top
        left += w
    return places


def _paste(image: NDArray[np.uint8], colours: NDArray[np.uint8], box: NDArray[np.int64], place: NDArray[np.int64],
           size: NDArray[np.int64]) -> None:
    """Cut a box out of a picture, beyond whose frame its edge is repeated, and put it into the image."""
    h, w = colours.shape[:2]
    left, top, right, bottom = (int(v) for v in box)
    if min(left, top) >= 0 and right <= w and bottom <= h:
        cut = colours[top:bottom, left:right]
    else:
        cut = colours[np.clip(np.arange(top, bottom), 0, h - 1)[:, None], np.clip(np.arange(left, right), 0, w - 1)]
    small = cv2.resize(cut, (int(size[0]), int(size[1])), interpolation=cv2.INTER_AREA)
    image[place[1]:place[1] + size[1], place[0]:place[0] + size[0]] = small


def _patches(image: NDArray[np.uint8], surface: Surface, which: NDArray[np.bool_], places: NDArray[np.int64]) -> Array:
    """Paint a square for each triangle that no picture shows; (m, 3, 2) its corners, all in the middle."""
    colours = surface.colours[surface.triangles[which]].mean(axis=1)
    for dy in range(PATCH_PX):
        for dx in range(PATCH_PX):
            image[places[:, 1] + dy, places[:, 0] + dx] = colours
    return np.repeat(places[:, None] + 0.5 * PATCH_PX, 3, axis=1)


def _level(image: NDArray[np.uint8], surface: Surface, pieces: _Pieces, shown: NDArray[np.bool_], corner_px: Array,
           layout: _Layout) -> None:
    """Make pieces equally bright where they meet: a gain per piece, by least squares over seams."""
    if not len(pieces):
        return
    piece, colour = _seams(image, surface, pieces, shown, corner_px)
    light = np.maximum(colour.mean(axis=2), 4.0)
    alike = np.abs(np.log(light[:, 1] / light[:, 0])) < math.log(ODD_RATIO)
    gain = _gains(piece[alike], light[alike], len(pieces))
    for i in np.flatnonzero(np.abs(gain - 1.0) > 0.004).tolist():
        (x, y), (w, h) = layout.places[i], layout.sizes[i]
        part = image[y:y + h, x:x + w]
        part[:] = np.clip(np.rint(part * gain[i]), 0, 255).astype(np.uint8)


def _seams(image: NDArray[np.uint8], surface: Surface, pieces: _Pieces, shown: NDArray[np.bool_],
           corner_px: Array) -> tuple[NDArray[np.int64], Array]:
    """(s, 2) pieces that meet at a vertex, and (s, 2, 3) the colour that each of them has there."""
    pairs, ends = surface.shared_edges
    across = shown[pairs].all(axis=1) & (pieces.of_face[pairs[:, 0]] != pieces.of_face[pairs[:, 1]])
    pairs, ends = pairs[across], ends[across]
    colours = []
    for side in range(2):
        faces = pairs[:, side]
        at = [corner_px[faces, np.argmax(surface.triangles[faces] == ends[:, [e]], axis=1)] for e in range(2)]
        colours.append(np.mean([_sampled(image, a) for a in at], axis=0))
    return pieces.of_face[pairs], np.stack(colours, axis=1)


def _sampled(image: NDArray[np.uint8], px: Array) -> Array:
    """(n, 3) mean of 3 x 3 pixels around places in the image."""
    column, row = (np.floor(px[:, k]).astype(np.int64) for k in range(2))
    total = np.zeros((len(px), 3))
    for dy in (-1, 0, 1):
        for dx in (-1, 0, 1):
            total += image[np.clip(row + dy, 0, image.shape[0] - 1), np.clip(column + dx, 0, image.shape[1] - 1)]
    return total / 9.0


def _gains(piece: NDArray[np.int64], light: Array, count: int) -> Array:
    """(count,) gains g that minimise the squares of g_a + light_a - g_b - light_b, in logarithms, near zero."""
    a, b = piece.T
    step = np.log(light[:, 1] / light[:, 0])
    ones = np.ones(len(a))
    matrix = coo_array((np.concatenate([ones, ones, -ones, -ones]),
                        (np.concatenate([a, b, a, b]), np.concatenate([a, b, b, a]))), shape=(count, count)).tocsc()
    matrix += coo_array((np.full(count, GAIN_PRIOR), (np.arange(count),) * 2), shape=(count, count)).tocsc()
    right = np.bincount(a, step, count) - np.bincount(b, step, count)
    return np.asarray(np.clip(np.exp(spsolve(matrix, right)), *GAIN_RANGE))
