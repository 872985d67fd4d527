"""Which picture shows each triangle best.

After Waechter, Moehrle and Goesele, "Let There Be Color!" (ECCV 2014): a picture is the better the more of its pixels a
triangle fills, head-on; what another part of the surface hides does not count; nor does a picture whose colour
differs from what the others agree on, as it does where something thin stands before the surface that the mesh lacks.
Where a picture has sky in its place, a triangle is none: meshes bulge at their rims and around thin members.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import cv2
import numba
import numpy as np
import open3d as o3d
from numpy.typing import NDArray

from missions.camera import Camera
from missions.frames import Array
from perception.depth.sky import SAFETY_PX, sky_and_gaps
from perception.products.surface import Surface
from perception.reconstruct.pictures import SurveyPicture, read_colour
from perception.reconstruct.resources import in_order

NONE = -1
CANDIDATES = 6
LARGEST_ANGLE_COS = 0.2
BORDER_PX = 3.0
PROBE_WIDTH_PX = 960
"""Width at which colours are compared and sky is looked for."""
SKY_VOTES = 0.15
"""A triangle is none when this share of the pictures that show its place have sky there, and no fewer than two."""
LIFT = 0.02
"""Rays to the camera start this share of their length off the surface, so that they do not meet their own triangle."""
SKY_GROWTH = np.ones((2 * SAFETY_PX + 1, 2 * SAFETY_PX + 1), np.uint8)
"""The sky mask keeps SAFETY_PX away from everything else: up to there it is given back."""
ODD_DN = 40.0
"""A picture is no candidate where its colour is this far (root of summed squares) from the candidates' median."""
SEAM_COST = 0.4
"""What a neighbour in another picture costs, in shares of the best picture's score."""
SWEEPS = 12


@dataclass(frozen=True)
class Candidates:
    """Up to CANDIDATES pictures per triangle, best first: index (f, k) or NONE, score (f, k), 0 where there is none.

    solid (f,): whether a triangle is one, by what pictures have in its place.
    """

    picture: NDArray[np.int32]
    score: NDArray[np.float32]
    solid: NDArray[np.bool_]

    def select(self, which: NDArray[np.bool_]) -> Candidates:
        """The triangles that are true."""
        return Candidates(self.picture[which], self.score[which], self.solid[which])


def best_pictures(surface: Surface, found: Candidates) -> NDArray[np.int32]:
    """(f,) index of the picture for each triangle, NONE where none shows it.

    Neighbours take the same picture where it shows both nearly as well as others would, for fewer seams.
    """
    neighbours = _neighbours(surface)
    chosen = np.where(found.score[:, 0] > 0.0, found.picture[:, 0], NONE).astype(np.int32)
    share = found.score / np.maximum(found.score[:, :1], 1e-9)
    _smooth(found.picture, share, neighbours, np.float32(SEAM_COST), SWEEPS, chosen)
    return chosen


def project(picture: SurveyPicture, camera: Camera, points_enu_m: Array) -> tuple[Array, Array]:
    """(n, 2) pixel coordinates of points (n, 3), and (n,) their depths; meaningless behind the camera."""
    local = (points_enu_m - picture.position_enu_m) @ picture.enu_from_camera
    depth = local[:, 2]
    safe = np.where(np.abs(depth) < 1e-6, 1e-6, depth)[:, None]
    return local[:, :2] / safe * [camera.fx_px, camera.fy_px] + [camera.cx_px, camera.cy_px], depth


def candidates(surface: Surface, pictures: list[SurveyPicture], threads: int = 1,
               told: Callable[[int], None] = lambda done: None) -> Candidates:
    """The best pictures of every triangle, those of an odd colour left out. `told` hears how many were looked at."""
    shape = (len(surface), CANDIDATES)
    picture, score = np.full(shape, NONE, np.int32), np.zeros(shape, np.float32)
    colour = np.zeros((*shape, 3), np.uint8)
    seen, sky = np.zeros((2, len(surface)), np.int32)
    _ = surface.rays, surface.normals_enu, surface.centres_enu_m  # made before several threads ask for them
    with ThreadPoolExecutor(threads) as pool:
        for k, found in enumerate(in_order(pool, lambda p: _sighting(surface, p), pictures, 2 * threads)):
            seen[found.faces] += 1
            sky[found.faces] += found.sky
            slot = np.argmin(score[found.faces], axis=1)
            better = (found.score > score[found.faces, slot]) & ~found.maybe_sky
            faces, slot = found.faces[better], slot[better]
            picture[faces, slot], score[faces, slot] = k, found.score[better]
            colour[faces, slot] = found.colours[better]
            told(k + 1)
    score[_odd(picture, colour)] = 0.0
    order = np.argsort(-score, axis=1, kind="stable")
    each = np.arange(len(surface))[:, None]
    return Candidates(picture[each, order], score[each, order], (sky < 2) | (sky < SKY_VOTES * seen))


@dataclass(frozen=True)
class _Sighting:
    """What a picture shows of the surface: a row per triangle."""

    faces: NDArray[np.int64]
    score: NDArray[np.float32]
    colours: NDArray[np.uint8]
    sky: NDArray[np.bool_]
    maybe_sky: NDArray[np.bool_]


def _sighting(surface: Surface, picture: SurveyPicture) -> _Sighting:
    faces, score = _shown(surface, picture)
    return _Sighting(faces, score, *_probed(picture, surface.centres_enu_m[faces]))


def _shown(surface: Surface, picture: SurveyPicture) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """Triangles that the whole picture shows unhidden, and how well: pixels times the cosine of the angle."""
    camera = picture.camera
    pixel, depth = project(picture, camera, surface.vertices_enu_m)
    inside = (depth > 0.1) & np.all((pixel > BORDER_PX) & (pixel < [camera.width_px - BORDER_PX,
                                                                    camera.height_px - BORDER_PX]), axis=1)
    rows = np.flatnonzero(inside[surface.triangles].all(axis=1))
    towards = picture.position_enu_m - surface.centres_enu_m[rows]
    distance = np.linalg.norm(towards, axis=1)
    cosine = np.einsum("ij,ij->i", surface.normals_enu[rows], towards) / distance
    rows, towards, distance, cosine = (a[cosine > LARGEST_ANGLE_COS] for a in (rows, towards, distance, cosine))
    free = _free(surface, rows, towards)
    rows, cosine = rows[free], cosine[free]
    a, b, c = (pixel[surface.triangles[rows, k]] for k in range(3))
    area = 0.5 * np.abs((b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0]))
    return rows, (area * cosine).astype(np.float32)


def _free(surface: Surface, rows: NDArray[np.int64], towards: Array) -> NDArray[np.bool_]:
    """Whether nothing stands between centres of triangles and the camera."""
    start = surface.centres_enu_m[rows] + LIFT * towards
    rays = np.concatenate([start, (1.0 - LIFT) * towards], axis=1).astype(np.float32)
    return np.asarray(~surface.rays.test_occlusions(o3d.core.Tensor.from_numpy(rays), 0.0, 1.0).numpy())


def _probed(picture: SurveyPicture, points_enu_m: Array) -> tuple[NDArray[np.uint8], NDArray[np.bool_],
                                                                  NDArray[np.bool_]]:
    """(n, 3) what a reduced picture shows at points in its frame, (n,) whether that is sky, and whether it may be."""
    width_px = min(PROBE_WIDTH_PX, picture.camera.width_px)
    camera = picture.camera_at(width_px)
    column, row = np.floor(project(picture, camera, points_enu_m)[0]).astype(np.int64).T
    at = np.clip(row, 0, camera.height_px - 1), np.clip(column, 0, camera.width_px - 1)
    colours = read_colour(picture, width_px)
    sky = sky_and_gaps(colours, camera, picture.pose)
    grown = cv2.dilate(sky.astype(np.uint8), SKY_GROWTH) > 0
    return colours[at], sky[at], grown[at]


def _odd(picture: NDArray[np.int32], colour: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """(f, k) candidates far from the median colour of at least three."""
    known = picture != NONE
    values = np.where(known[..., None], colour, np.float32(np.nan)).astype(np.float32)
    enough = known.sum(axis=1) >= 3
    median = np.zeros((len(picture), 1, 3), np.float32)
    median[enough] = np.nanmedian(values[enough], axis=1, keepdims=True)
    away = np.sqrt(np.sum((values - median) ** 2, axis=2))
    return np.asarray(enough[:, None] & (np.nan_to_num(away) > ODD_DN))


def _neighbours(surface: Surface) -> NDArray[np.int32]:
    """(f, 3) triangles across edges, NONE where there is none; of more than three, some."""
    pairs, _ = surface.shared_edges
    both = np.concatenate([pairs, pairs[:, ::-1]])
    both = both[np.argsort(both[:, 0], kind="stable")]
    first = np.searchsorted(both[:, 0], both[:, 0])
    place = np.arange(len(both)) - first
    table = np.full((len(surface), 3), NONE, np.int32)
    few = place < 3
    table[both[few, 0], place[few]] = both[few, 1]
    return table


def _sweep_faces(picture: NDArray[np.int32], share: NDArray[np.float32], neighbours: NDArray[np.int32],
                 seam_cost: np.float32, sweeps: int, chosen: NDArray[np.int32]) -> None:
    """Iterated conditional modes (Besag 1986): each triangle takes what is cheapest beside its neighbours."""
    for _ in range(sweeps):
        changed = 0
        for f in range(len(chosen)):
            if chosen[f] < 0:
                continue
            best, best_cost = chosen[f], np.inf
            for k in range(picture.shape[1]):
                if share[f, k] <= 0.0:
                    continue
                cost = 1.0 - share[f, k]
                for n in range(3):
                    other = neighbours[f, n]
                    if other >= 0 and chosen[other] != picture[f, k]:
                        cost += seam_cost
                if cost < best_cost:
                    best, best_cost = picture[f, k], cost
            if best != chosen[f]:
                chosen[f] = best
                changed += 1
        if changed == 0:
            break


_smooth = numba.njit(nogil=True, cache=True)(_sweep_faces)
