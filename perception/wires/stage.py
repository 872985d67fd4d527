"""Members thinner than stereo resolves, as points: wires, cables, bars of lattices and railings."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from missions.frames import Array
from perception.reconstruct.cloud import Cloud, on_grid
from perception.reconstruct.pictures import SurveyPicture, grey, read_colour
from perception.reconstruct.resources import in_order
from perception.reconstruct.settings import Progress, Region, Settings
from perception.wires.agreement import agree
from perception.wires.crowds import alone
from perception.wires.lookup import Lines, gathered, rays_enu, sorted_lines
from perception.wires.mutual import drawn_together
from perception.wires.partners import partners_of
from perception.wires.ridges import ridges

EVERY = 3
"""One in so many samples of a line is looked for in space; all of them confirm what others find."""
METHOD = 3
"""Raised whenever the points change for the same pictures."""
NEAREST_M = 2.0
AROUND_M = 1.0
"""Lines are looked for so far beyond the region as well, where what is found is dropped: a blade of grass just below it
would otherwise be given the best of the wrong places above, and where the ground's texture repeats all pictures agree
on that place."""
FARTHEST = 5.5
"""Lines are looked for up to so many usual distances away."""
LEAST_AGREEING, LEAST_SHARE = 4, 0.2
"""Pictures that have a line there, and their share among those that see the place from as near."""
LARGEST_SIGMA_M = 0.03
"""Of the place across the line, per pixel of error, in its worse direction."""
LEAST_PICTURES = 5
MUTUAL_SHARE = 0.5
"""Pictures that found a line themselves, in all, and as a share of those that have a line there. Where the lines of
several pictures meet by chance, most of these pictures find the true line, which is another."""
PIECE_M = 0.2
"""What was found is drawn out by so much to both sides; what it was averaged from reaches farther."""

FOUND = np.dtype([("place", np.float64, 3), ("line", np.float64, 3), ("agreeing", np.float64), ("share", np.float64),
                  ("sigma_m", np.float64), ("picture", np.int64), ("colour", np.uint8, 3)])


@dataclass(frozen=True)
class _Search:
    """Everything that the search of one picture's lines needs."""

    pictures: list[SurveyPicture]
    lines: list[Lines]
    region: Region
    distance_m: float


def thin_members(pictures: list[SurveyPicture], region: Region, settings: Settings, progress: Progress) -> Cloud:
    """Points on the axes of thin members in the region, one per voxel of settings.spacing_m.

    Confidence is the number of pictures that found the member, at most 255. pictures: with poses that can be trusted to
    a pixel. The same whatever the number of threads. `progress` is told "lines" and "wires".
    """
    with ThreadPoolExecutor(settings.threads) as pool:
        lines: list[Lines] = []
        for own in in_order(pool, _lines, pictures, 2 * settings.threads):
            lines.append(own)
            progress("lines", len(lines), len(pictures))
        search = _Search(pictures, lines, region, settings.distance_m)
        parts: list[NDArray[np.void]] = []
        for part in in_order(pool, lambda i: _found(search, i), range(len(pictures)), 2 * settings.threads):
            parts.append(part)
            progress("wires", len(parts), len(pictures))
    found = np.concatenate(parts)
    count, place, line = drawn_together(found["place"], found["line"], found["picture"])
    sure = (count >= LEAST_PICTURES) & (count >= MUTUAL_SHARE * found["agreeing"])
    found, count, place, line = found[sure], count[sure], place[sure], line[sure]
    return _pieces(found, count, place, line, pictures, region, settings.spacing_m)


def _lines(picture: SurveyPicture) -> Lines:
    return alone(sorted_lines(ridges(grey(read_colour(picture, picture.camera.width_px))), picture), picture)


def _found(search: _Search, i: int) -> NDArray[np.void]:
    """(n,) FOUND: what a picture's lines are in space, with the help of its partners."""
    picture, own = search.pictures[i], search.lines[i]
    partners = partners_of(i, search.pictures, search.region, search.distance_m)
    if len(partners) < LEAST_AGREEING - 1:
        return np.empty(0, FOUND)
    others = [*partners.finders, *partners.witnesses]
    along_chains = np.lexsort((own.ridges.place_px[:, 1], own.ridges.place_px[:, 0], own.ridges.chain))
    chosen = np.sort(along_chains[::EVERY])
    samples = own.ridges.select(chosen)
    rays = rays_enu(samples, picture)
    out = np.zeros((len(chosen), 9))
    agree(_depths(picture, rays, search), own.normal[chosen], rays, np.asarray(picture.position_enu_m, np.float64),
          picture.camera.fx_px, gathered([search.pictures[j] for j in others], [search.lines[j] for j in others]),
          len(partners.finders), out)
    kept = (out[:, 6] >= LEAST_AGREEING) & (out[:, 7] >= LEAST_SHARE) & (out[:, 8] <= LARGEST_SIGMA_M)
    found = np.empty(int(kept.sum()), FOUND)
    found["place"], found["line"], found["picture"] = out[kept, :3], out[kept, 3:6], i
    for column, name in enumerate(("agreeing", "share", "sigma_m"), start=6):
        found[name] = out[kept, column]
    at = np.floor(samples.place_px[kept]).astype(np.int64)
    found["colour"] = read_colour(picture, picture.camera.width_px)[at[:, 1], at[:, 0]] if len(at) else 0
    return found


def _depths(picture: SurveyPicture, rays: Array, search: _Search) -> Array:
    """(n, 2) depths between which lines are looked for along rays: where they are in the region or AROUND_M about it.
    The second is less where they miss the region."""
    own, around = (_through(picture, rays, search.region, margin_m) for margin_m in (0.0, AROUND_M))
    near = np.maximum(around[0], NEAREST_M)
    far = np.minimum(around[1], FARTHEST * search.distance_m)
    return np.column_stack([near, np.where(own[0] < own[1], far, -np.inf)])


def _through(picture: SurveyPicture, rays: Array, region: Region, margin_m: float) -> tuple[Array, Array]:
    """(n,) depths at which rays enter and leave the region, grown by a margin; they leave first where they miss it."""
    with np.errstate(divide="ignore"):
        one = (region.lower_enu_m - margin_m - picture.position_enu_m) / rays
        other = (region.upper_enu_m + margin_m - picture.position_enu_m) / rays
    return np.minimum(one, other).max(axis=1), np.maximum(one, other).min(axis=1)


def _pieces(found: NDArray[np.void], count: NDArray[np.int64], place: Array, line: Array,
            pictures: list[SurveyPicture], region: Region, spacing_m: float) -> Cloud:
    """Points along a piece of line around each place, turned to the camera that found it."""
    steps = np.arange(-PIECE_M, PIECE_M + 1e-9, 0.5 * spacing_m)
    points = (place[:, None, :] + steps[None, :, None] * line[:, None, :]).reshape(-1, 3)
    towards = np.array([p.position_enu_m for p in pictures])[found["picture"]] - place
    towards -= np.sum(towards * line, axis=1, keepdims=True) * line
    towards /= np.maximum(np.linalg.norm(towards, axis=1, keepdims=True), 1e-9)
    each = len(steps)
    cloud = Cloud(points.astype(np.float32), np.repeat(found["colour"], each, axis=0),
                  np.repeat(towards, each, axis=0).astype(np.float32),
                  np.repeat(np.minimum(count, 255), each).astype(np.uint8))
    return on_grid(cloud.select(region.contains(cloud.points_enu_m)), spacing_m)
