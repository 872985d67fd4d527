"""Pairs of pictures whose matches the poses deny that all pairs made together.

Rows of bricks match one row aside, and one relative pose explains hundreds of such matches. Within the pair nothing is
wrong with them; but a picture's pairs with others put it elsewhere.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from missions.frames import Array
from perception.reconstruct.bundle import Accuracy, Adjusted, adjust
from perception.reconstruct.control_points import ControlPoint
from perception.reconstruct.features import Features
from perception.reconstruct.matching import ByPair, fundamental
from perception.reconstruct.optics import Optics
from perception.reconstruct.pictures import SurveyPicture

NEAR_PX = 2.0
"""Matches as near to their epipolar line are confirmed, in a picture 1920 pixels wide."""
LEAST_SHARE = 0.8
"""Of a pair's matches. Of 2,500 pairs of two surveys of a building 73 of the 74 wrong ones and 11 of the 2,300 right
ones had a smaller share (`docs/benchmarks.md`)."""
ENOUGH = 150
"""Matches of a picture. Where fewer are left, its pose may be what is wrong: it keeps the best of its other pairs."""


def adjust_agreeing(pictures: list[SurveyPicture], seen: list[Features], matches: ByPair, accuracy: Accuracy,
                    first_px: float, optics: Optics, calibrate: bool = False,
                    control: list[ControlPoint] | None = None) -> tuple[ByPair, Adjusted]:
    """Bundle adjustment as in `adjust`, and again without the pairs that it denied; with it the matches it rests on."""
    found = adjust(pictures, seen, matches, accuracy, first_px, optics, calibrate, control)
    believed = confirmed(matches, pictures, seen, found)
    if len(believed) < len(matches):
        found = adjust(pictures, seen, believed, accuracy, first_px, found.optics, calibrate, control)
    return believed, found


def confirmed(matches: ByPair, pictures: list[SurveyPicture], seen: list[Features], found: Adjusted) -> ByPair:
    """The matches of those pairs most of whose matches lie near the epipolar lines of the poses that were found, and of
    the next best until every picture has enough, in the order of the pairs."""
    share = _confirmed_share(matches, pictures, seen, found)
    count = np.zeros(len(pictures), dtype=np.int64)
    kept = []
    for pair in sorted(matches, key=lambda pair: (-share[pair], pair)):
        if share[pair] >= LEAST_SHARE or count[list(pair)].min() < ENOUGH:
            count[list(pair)] += len(matches[pair])
            kept.append(pair)
    return {pair: matches[pair] for pair in sorted(kept)}


def _confirmed_share(matches: ByPair, pictures: list[SurveyPicture], seen: list[Features],
                     found: Adjusted) -> dict[tuple[int, int], float]:
    near_px = NEAR_PX * found.optics.camera.width_px / 1920.0
    placed = [replace(p, camera=found.optics.camera, enu_from_camera=turn, position_enu_m=position)
              for p, turn, position in zip(pictures, found.enu_from_camera, found.position_enu_m, strict=True)]
    points_px = [found.optics.ideal(f.points_px) for f in seen]
    return {(i, j): float(np.mean(off_line_px(placed[i], placed[j], points_px[i][m[:, 0]], points_px[j][m[:, 1]])
                                  < near_px)) for (i, j), m in matches.items()}


def off_line_px(first: SurveyPicture, second: SurveyPicture, a: NDArray[np.float32], b: NDArray[np.float32]) -> Array:
    """(m,) how far points (m, 2) of the second picture lie from the epipolar lines of points (m, 2) of the first."""
    lines = np.column_stack([a, np.ones(len(a))]) @ fundamental(first, second).T
    off = np.einsum("ij,ij->i", lines, np.column_stack([b, np.ones(len(b))]))
    return np.asarray(np.abs(off) / np.maximum(np.linalg.norm(lines[:, :2], axis=1), 1e-12))
