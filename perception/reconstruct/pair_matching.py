"""Matches of many pairs of pictures at once."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

from perception.reconstruct.features import Features
from perception.reconstruct.matching import MIN_MATCHES, ByPair, Matches, match
from perception.reconstruct.optics import Optics
from perception.reconstruct.pairs import overlapping
from perception.reconstruct.pictures import SurveyPicture


def pairs_of(pictures: list[SurveyPicture], distance_m: float, count: int, which: list[int]) -> set[tuple[int, int]]:
    """Which of the pictures (indices), each with up to count others that overlap it most."""
    near = overlapping(pictures, distance_m, count) if which else []
    return {(min(i, j), max(i, j)) for i in which for j in near[i]}


def match_pairs(pairs: set[tuple[int, int]], taken: list[SurveyPicture], found: list[Features], optics: Optics,
                band_px: float, epipolar_px: float, pool: ThreadPoolExecutor,
                tell: Callable[[int, int], None] = lambda done, total: None,
                least: int = MIN_MATCHES) -> ByPair:
    """In order of the pairs; those without matches are left out."""
    pictures = [replace(p, camera=optics.camera) for p in taken]
    seen = [replace(f, points_px=optics.ideal(f.points_px)) for f in found]
    matches: ByPair = {}

    def one(pair: tuple[int, int]) -> Matches:
        i, j = pair
        return match(pictures[i], pictures[j], seen[i], seen[j], band_px, epipolar_px, least)

    ordered = sorted(pairs)
    for done, (pair, of_pair) in enumerate(zip(ordered, pool.map(one, ordered), strict=True), start=1):
        if len(of_pair):
            matches[pair] = of_pair
        tell(done, len(ordered))
    return matches
