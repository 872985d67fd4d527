"""Which pictures to look for the lines of a picture in, from their poses alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from missions.frames import Array
from perception.reconstruct.pictures import SurveyPicture
from perception.reconstruct.settings import Region

DEPTHS = (0.75, 1.25, 2.0, 3.0)
"""Where a picture's field is probed, in usual distances: thin members are seen from farther off than surfaces."""
FINDERS, WITNESSES = 6, 40
BEST_PARALLAX_DEG = 20.0
LEAST_OVERLAP = 0.03


@dataclass(frozen=True)
class Partners:
    """Indices of pictures: those in whose lines a match is looked for, and those that only confirm it."""

    finders: list[int]
    witnesses: list[int]

    def __len__(self) -> int:
        return len(self.finders) + len(self.witnesses)


def partners_of(i: int, pictures: list[SurveyPicture], region: Region, distance_m: float) -> Partners:
    """Finders have a good parallax, with baselines to different sides: a line along one baseline is told by another
    alone. Witnesses are the others with the most overlap within the region."""
    overlap, fitness, baseline = _scores(pictures[i], pictures, _probes(pictures[i], region, distance_m))
    overlap[i] = fitness[i] = 0.0
    finders: list[int] = []
    while len(finders) < FINDERS and fitness.max() > 0.5 * LEAST_OVERLAP:
        best = int(np.argmax(fitness))
        finders.append(best)
        fitness *= 1.0 - 0.7 * np.abs(baseline @ baseline[best]) ** 4
        fitness[finders] = 0.0
    order = np.argsort(-overlap, kind="stable")[:WITNESSES].tolist()
    return Partners(finders, [j for j in order if overlap[j] > LEAST_OVERLAP and j not in finders])


def _probes(picture: SurveyPicture, region: Region, distance_m: float) -> Array:
    """(n, 3) points of the picture's field that lie in the region, or nearly."""
    c = picture.camera
    u, v = np.meshgrid(np.linspace(0.1, 0.9, 6) * c.width_px, np.linspace(0.1, 0.9, 4) * c.height_px)
    rays = np.stack([(u - c.cx_px) / c.fx_px, (v - c.cy_px) / c.fy_px, np.ones_like(u)], axis=-1).reshape(-1, 3)
    points = np.concatenate([picture.position_enu_m + depth * distance_m * rays @ picture.enu_from_camera.T
                             for depth in DEPTHS])
    inside = (points > region.lower_enu_m - 1.0) & (points < region.upper_enu_m + 1.0)
    return np.asarray(points[inside.all(axis=1)])


def _scores(own: SurveyPicture, pictures: list[SurveyPicture], points: Array) -> tuple[Array, Array, Array]:
    """Share of the points that each picture shows (k,), that share weighted by parallax (k,), unit baselines (k, 3)."""
    position = np.array([p.position_enu_m for p in pictures])
    step = position - own.position_enu_m
    baseline = step / np.maximum(np.linalg.norm(step, axis=1), 1e-9)[:, None]
    if not len(points):
        return np.zeros(len(pictures)), np.zeros(len(pictures)), baseline
    camera = own.camera
    local = np.einsum("jba,jpb->jpa", np.array([p.enu_from_camera for p in pictures]), points[None] - position[:, None])
    pixel = local[..., :2] / np.maximum(local[..., 2:], 1e-6) * [camera.fx_px, camera.fy_px]
    pixel += [camera.cx_px, camera.cy_px]
    shown = (local[..., 2] > 1.0) & np.all((pixel > 0.0) & (pixel < [camera.width_px, camera.height_px]), axis=-1)
    to_own, to_other = points - own.position_enu_m, points[None] - position[:, None]
    cosine = np.einsum("pk,jpk->jp", to_own, to_other) / np.linalg.norm(to_other, axis=-1)
    cosine /= np.linalg.norm(to_own, axis=-1)
    parallax_deg = np.maximum(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))), 0.1)
    fit = np.exp(-0.5 * (np.log(parallax_deg / BEST_PARALLAX_DEG) / 0.7) ** 2)
    return shown.mean(axis=1), (shown * fit).mean(axis=1), baseline
