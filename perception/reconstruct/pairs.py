"""Which pictures to match with which, from their poses alone."""

from __future__ import annotations

import math

import numpy as np

from missions.frames import Array
from perception.reconstruct.pictures import SurveyPicture

PARALLAX_RANGE_DEG = (3.0, 45.0)
BEST_PARALLAX_DEG = 12.0
MAX_TURN_DEG = 50.0
MAX_ALONG_AXIS = 0.75
MIN_OVERLAP = 0.15


def stereo_partners(pictures: list[SurveyPicture], distance_m: float, count: int) -> list[list[int]]:
    """For each picture, the indices of up to `count` others to match it with, best first.

    A good partner sees the same surface at `distance_m` under a parallax near 12 degrees (wide enough to measure
    depth, narrow enough to look alike), stands beside the picture rather than before it, and its baseline points
    elsewhere than those of the partners already taken: an edge along one baseline is only measured by another.
    """
    scores, baselines = _scores(pictures, distance_m)
    return [_diverse(scores[i], baselines[i], count) for i in range(len(pictures))]


def overlapping(pictures: list[SurveyPicture], distance_m: float, count: int) -> list[list[int]]:
    """For each picture, up to `count` others that look at the same surface from any side, most overlap first."""
    return _most(pictures, _overlap(pictures, distance_m), count)


def overlapping_mutually(pictures: list[SurveyPicture], distance_m: float, count: int) -> list[list[int]]:
    """The same, but overlap counts as little as either picture has of it: who sees the surface from much farther away
    comes last, however much else is in its frame."""
    overlap = _overlap(pictures, distance_m)
    return _most(pictures, np.minimum(overlap, overlap.T), count)


def _most(pictures: list[SurveyPicture], overlap: Array, count: int) -> list[list[int]]:
    forward = np.array([p.forward_enu for p in pictures])
    overlap[forward @ forward.T < math.cos(math.radians(75.0))] = 0.0
    np.fill_diagonal(overlap, 0.0)
    order = np.argsort(-overlap, axis=1, kind="stable")[:, :count]
    return [[int(j) for j in row if overlap[i, j] > 0.05] for i, row in enumerate(order)]


def _scores(pictures: list[SurveyPicture], distance_m: float) -> tuple[Array, Array]:
    """(n, n) fitness as a partner, zero where unfit; (n, n, 3) unit baselines from row to column."""
    position = np.array([p.position_enu_m for p in pictures])
    forward = np.array([p.forward_enu for p in pictures])
    baseline = position[None, :, :] - position[:, None, :]
    length = np.linalg.norm(baseline, axis=-1)
    unit = baseline / np.maximum(length, 1e-9)[..., None]
    target = position + distance_m * forward
    to_own = -forward
    to_other = position[None, :, :] - target[:, None, :]
    to_other /= np.maximum(np.linalg.norm(to_other, axis=-1), 1e-9)[..., None]
    parallax = np.degrees(np.arccos(np.clip(np.einsum("ik,ijk->ij", to_own, to_other), -1.0, 1.0)))
    turn = np.degrees(np.arccos(np.clip(forward @ forward.T, -1.0, 1.0)))
    along = np.maximum(np.abs(np.einsum("ik,ijk->ij", forward, unit)), np.abs(np.einsum("jk,ijk->ij", forward, unit)))
    overlap = _overlap(pictures, distance_m)
    score = overlap * np.exp(-0.5 * (np.log(np.maximum(parallax, 1e-3) / BEST_PARALLAX_DEG) / 0.6) ** 2)
    score *= np.cos(np.radians(np.minimum(turn, 90.0))) * (1.0 - along**2)
    fit = (parallax >= PARALLAX_RANGE_DEG[0]) & (parallax <= PARALLAX_RANGE_DEG[1]) & (turn <= MAX_TURN_DEG)
    fit &= (along <= MAX_ALONG_AXIS) & (overlap >= MIN_OVERLAP) & (length > 0.05)
    return np.where(fit, score, 0.0), unit


def _diverse(score: Array, baseline: Array, count: int) -> list[int]:
    """Greedy choice; a baseline parallel to one already taken counts half."""
    chosen: list[int] = []
    weight = score.copy()
    while len(chosen) < count and weight.max(initial=0.0) > 0.0:
        best = int(np.argmax(weight))
        chosen.append(best)
        weight *= 1.0 - 0.5 * np.abs(baseline @ baseline[best]) ** 4
        weight[chosen] = 0.0
    return chosen


def _overlap(pictures: list[SurveyPicture], distance_m: float) -> Array:
    """(n, n) share of a picture's field, taken 0.7 to 1.8 distances away, that the other picture has in its frame."""
    n = len(pictures)
    result = np.zeros((n, n))
    camera = pictures[0].camera
    u, v = np.meshgrid(np.linspace(0.1, 0.9, 7) * camera.width_px, np.linspace(0.1, 0.9, 5) * camera.height_px)
    rays = np.stack([(u - camera.cx_px) / camera.fx_px, (v - camera.cy_px) / camera.fy_px, np.ones_like(u)], axis=-1)
    rays = rays.reshape(-1, 3)
    points = np.concatenate([rays * distance_m * s for s in (0.7, 1.0, 1.8)])
    camera_from_enu = np.array([p.enu_from_camera.T for p in pictures])
    position = np.array([p.position_enu_m for p in pictures])
    for i, picture in enumerate(pictures):
        world = points @ picture.enu_from_camera.T + picture.position_enu_m
        local = np.einsum("jab,jpb->jpa", camera_from_enu, world[None] - position[:, None])
        z = np.maximum(local[..., 2], 1e-6)
        x = local[..., 0] / z * camera.fx_px + camera.cx_px
        y = local[..., 1] / z * camera.fy_px + camera.cy_px
        inside = (local[..., 2] > 0.5) & (x >= 0) & (x < camera.width_px) & (y >= 0) & (y < camera.height_px)
        result[i] = inside.mean(axis=1)
    return result
