"""More matches once the poses of most pictures are known better, for those that hang together badly.

Pictures that were adjusted together are matched anew, nearer to the lines of their poses by now; the others are tied to
the points of these. Those that are in no large group, or hang in it by few points, are also looked at closer, at twice
the width: what tells one bar of a lattice from the next is too small for the reduced picture.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from perception.reconstruct.bundle import Adjusted
from perception.reconstruct.features import WIDTH_PX, Features, fine_features
from perception.reconstruct.matching import MAX_EPIPOLAR_PX, MIN_MATCHES, ByPair
from perception.reconstruct.pair_matching import match_pairs, pairs_of
from perception.reconstruct.pairs import overlapping_mutually
from perception.reconstruct.pictures import SurveyPicture
from perception.reconstruct.ties import tied

NARROW_PX = 10.0
"""The band of a second look, once poses are adjusted, in a picture 1920 pixels wide."""
LEAST_NARROW = 20
"""Matches of a pair then: fewer agree by chance so near to the line."""
FEW_POINTS = 100
"""A picture that sees fewer is looked at closer."""
CLOSE_PARTNERS = 10


@dataclass(frozen=True)
class Look:
    """What a second look goes by."""

    found: Adjusted
    """Of the first one."""
    together: NDArray[np.bool_]
    """(n,) which pictures were adjusted with many others."""
    distance_m: float
    band_px: float
    """How near to the lines of measured poses matches are looked for."""
    partners: int
    """Pictures that each is matched with anew."""

    @property
    def narrow_px(self) -> float:
        """The same for adjusted poses."""
        return min(self.band_px, NARROW_PX * self.found.optics.camera.width_px / 1920.0)


def second_look(pictures: list[SurveyPicture], survey: int, seen: list[Features], matches: ByPair, look: Look,
                pool: ThreadPoolExecutor) -> ByPair:
    """The matches to adjust by now. survey: so many pictures, the first ones, are the survey's own; only they are
    looked at closer. What is seen then is added to what those given see."""
    found, together = look.found, look.together
    now = [replace(p, enu_from_camera=found.enu_from_camera[i], position_enu_m=found.position_enu_m[i])
           for i, p in enumerate(pictures)]
    pairs = pairs_of(now, look.distance_m, look.partners, np.flatnonzero(together).tolist())
    # a picture whose best partners had nothing for it was matched with all others: that is not to be forgotten
    pairs = {(i, j) for i, j in pairs | matches.keys() if together[i] and together[j]}
    others = {pair: of_pair for pair, of_pair in matches.items() if not together[list(pair)].all()}
    again = match_pairs(pairs, now, seen, found.optics, look.narrow_px, MAX_EPIPOLAR_PX, pool, least=LEAST_NARROW)
    all_of_them = tied(now, seen, others | again, found, together, look.band_px)
    # alone, a group may have been adjusted to a wrong place: its pictures are looked for from where they were measured
    start = [n if joined else p for n, p, joined in zip(now, pictures, together, strict=True)]
    for pair, new in _closer(start[:survey], seen, look, pool).items():
        all_of_them[pair] = np.concatenate([all_of_them.get(pair, new[:0]), new])
    return all_of_them


def _closer(pictures: list[SurveyPicture], seen: list[Features], look: Look, pool: ThreadPoolExecutor) -> ByPair:
    """Matches at twice the width of pictures that hang together badly with those that show most of the same."""
    if pictures[0].camera.width_px <= WIDTH_PX:
        return {}
    joined = look.together[:len(pictures)]
    points = np.bincount(look.found.picture_of, minlength=len(look.together))[:len(pictures)]
    near = overlapping_mutually(pictures, look.distance_m, CLOSE_PARTNERS)
    pairs = {(min(i, j), max(i, j)) for i in np.flatnonzero(~joined | (points < FEW_POINTS)).tolist() for j in near[i]}
    which = sorted({i for pair in pairs for i in pair})
    fine = list(seen[:len(pictures)])
    for i, of_picture in zip(which, pool.map(fine_features, [pictures[i] for i in which]), strict=True):
        fine[i] = of_picture
    known = {(i, j) for i, j in pairs if joined[i] and joined[j]}
    found: ByPair = {}
    for some, band_px, least in ((known, look.narrow_px, LEAST_NARROW), (pairs - known, look.band_px, MIN_MATCHES)):
        found |= match_pairs(some, pictures, fine, look.found.optics, band_px, MAX_EPIPOLAR_PX, pool, least=least)
    coarse = np.array([len(s) for s in seen])
    for i in which:
        seen[i] = seen[i].with_more(fine[i])
    return {(i, j): (m + coarse[[i, j]]).astype(np.uint32) for (i, j), m in sorted(found.items())}
