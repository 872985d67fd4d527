"""What a picture's neighbours know about it: their depth maps drawn into its view, and a vote on every ray.

Stability-free form of visibility-based fusion (Merrell et al., ICCV 2007): the depth that most maps agree on wins.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from perception.depth.compiled import compiled
from perception.depth.depth_map import DepthMap, Image, Mask

Counts = NDArray[np.uint8]

MAX_SHIFT = 3.0
"""Maps agree up to this many of their combined standard deviations of inverse depth ..."""
SLACK = 0.015
"""... and this share of it, for a slanted surface moves within a pixel."""
ALIKE_DN = 25.0
"""Most by which the grey of one surface may differ between two pictures."""


@dataclass(frozen=True)
class Consensus:
    """Per pixel (h, w): the depth that most maps agree on."""

    depth_m: Image
    support: Counts
    """Neighbours whose points on this ray agree with it."""
    agree: Counts
    """Neighbours that measure it where it lies in their pictures, and where it looks alike."""
    against: Counts
    """Neighbours that see through it, or have something before it on its ray."""


def consensus(depth: DepthMap, gray: Image, others: list[DepthMap], grays: list[Image]) -> Consensus:
    """The vote over a depth map and its neighbours', each with its grey picture at the maps' resolution."""
    drawn = np.zeros((len(others) + 1, *depth.valid.shape), np.float32)
    drawn[0] = np.where(depth.valid, 1.0 / depth.depth_m, 0.0)
    nears = [1.0 / other.depth_m for other in others]
    for image, other, other_near in zip(drawn[1:], others, nears, strict=True):
        _draw(other_near, other.valid, _into(other, depth), image)
    sigma = np.array([m.sigma_per_depth2 for m in (depth, *others)], np.float32)
    near, support, before = (np.zeros(depth.valid.shape, t) for t in (np.float32, np.uint8, np.uint8))
    _vote(drawn, sigma, near, support, before)
    near = np.where(near > 0.0, near, 1.0 / depth.depth_m).astype(np.float32)
    agree, against = np.zeros_like(before), before
    for other, other_near, other_gray, other_sigma in zip(others, nears, grays, sigma[1:], strict=True):
        _look_back(near, gray, _into(depth, other), other_near, other_gray, other.valid, other.sky,
                   np.float32(MAX_SHIFT * np.hypot(other_sigma, sigma[0])), agree, against)
    return Consensus((1.0 / near).astype(np.float32), support, agree, against)


def _into(source: DepthMap, target: DepthMap) -> NDArray[np.float32]:
    """(3, 4) from a homogeneous source pixel (column, row, 1, inverse depth) to a homogeneous target pixel."""
    k, k_source = target.camera.matrix, source.camera.matrix
    rotation = target.pose.enu_from_camera.T @ source.pose.enu_from_camera
    apart = np.array(source.pose.position_enu_m) - np.array(target.pose.position_enu_m)
    shift = target.pose.enu_from_camera.T @ apart
    return np.column_stack([k @ rotation @ np.linalg.inv(k_source), k @ shift]).astype(np.float32)


@compiled
def _draw(near: Image, valid: Mask, into: Image, out: Image) -> None:
    """Draws valid pixels of a map (inverse depth) into another view; the nearest stays."""
    h, w = near.shape
    h_out, w_out = out.shape
    for y in range(h):
        for x in range(w):
            if not valid[y, x]:
                continue
            u, v, n = np.float32(x + 0.5), np.float32(y + 0.5), near[y, x]
            z = into[2, 0] * u + into[2, 1] * v + into[2, 2] + into[2, 3] * n
            if z < 1e-3:
                continue
            column = int(np.floor((into[0, 0] * u + into[0, 1] * v + into[0, 2] + into[0, 3] * n) / z))
            row = int(np.floor((into[1, 0] * u + into[1, 1] * v + into[1, 2] + into[1, 3] * n) / z))
            if 0 <= column < w_out and 0 <= row < h_out:
                out[row, column] = max(out[row, column], n / z)


@compiled
def _vote(drawn: Image, sigma: Image, near: Image, agree: Counts, before: Counts) -> None:
    """The inverse depth with most agreement on each ray, the first map's in a tie; its mean over those that agree."""
    maps, h, w = drawn.shape
    limit = np.empty((maps, maps), np.float32)
    for a in range(maps):
        for b in range(maps):
            limit[a, b] = MAX_SHIFT * np.sqrt(sigma[a] * sigma[a] + sigma[b] * sigma[b])
    for y in range(h):
        for x in range(w):
            winner, most = -1, -maps
            for a in range(maps):
                n = drawn[a, y, x]
                if n <= 0.0:
                    continue
                votes = 0
                for b in range(maps):
                    m = drawn[b, y, x]
                    if m > 0.0:
                        if abs(m - n) <= limit[a, b] + SLACK * n:
                            votes += 1
                        elif m > n:
                            votes -= 1
                if votes > most or (votes == most and winner > 0 and n > drawn[winner, y, x]):
                    winner, most = a, votes
            if winner < 0:
                continue
            n, total, weight = drawn[winner, y, x], 0.0, 0.0
            for b in range(maps):
                m = drawn[b, y, x]
                if m <= 0.0:
                    continue
                if abs(m - n) <= limit[winner, b] + SLACK * n:
                    share = (4.0 if b == 0 else 1.0) / (sigma[b] * sigma[b])
                    total, weight = total + share * m, weight + share
                    agree[y, x] += b > 0
                elif m > n:
                    before[y, x] += 1
            near[y, x] = total / weight


@compiled
def _look_back(near: Image, gray: Image, into: Image, other: Image, other_gray: Image, valid: Mask, sky: Mask,
               limit: np.float32, agree: Counts, against: Counts) -> None:
    """Counts where another map measures surfaces at these inverse depths that look alike, and where it sees through."""
    h, w = near.shape
    for y in range(h):
        for x in range(w):
            u, v, n = np.float32(x + 0.5), np.float32(y + 0.5), near[y, x]
            z = into[2, 0] * u + into[2, 1] * v + into[2, 2] + into[2, 3] * n
            if z < 1e-3:
                continue
            column = int(np.floor((into[0, 0] * u + into[0, 1] * v + into[0, 2] + into[0, 3] * n) / z))
            row = int(np.floor((into[1, 0] * u + into[1, 1] * v + into[1, 2] + into[1, 3] * n) / z))
            if column < 0 or column >= other.shape[1] or row < 0 or row >= other.shape[0]:
                continue
            m = n / z
            if sky[row, column]:
                against[y, x] += 1
            elif valid[row, column]:
                allowed = limit + SLACK * m
                if m - other[row, column] > allowed:
                    against[y, x] += 1
                elif m - other[row, column] >= -allowed:
                    agree[y, x] += abs(gray[y, x] - other_gray[row, column]) <= ALIKE_DN
