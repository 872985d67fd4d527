"""Lines that stand alone in a picture, told from those of texture.

Grass or gravel seen at a low angle has lines all over that run the same way, so close together that where many pictures
have such a texture, several of them have a line wherever one is supposed. How many agree then says nothing, and lines
are found where the planes through cameras of the same height and such lines gather: a sheet just below these cameras.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from perception.depth.compiled import compiled
from perception.reconstruct.pictures import SurveyPicture
from perception.wires.agreement import TURN_COS
from perception.wires.lookup import NEAR_PX, Lines, Seen, gathered, nearest, sorted_lines

BESIDE = 6
"""Places looked at to either side of a line: strips as wide as a match may be off, one beside the other."""
FIRST_PX = 3.0 * NEAR_PX
"""Where the first one is: nearer, it might be the line itself."""
MOST_BESIDE = 2
"""So many lines beside it leave a line alone: a twin, and what looks like a line between the two."""


def alone(lines: Lines, picture: SurveyPicture) -> Lines:
    """The lines of a picture without those that run among others like them.

    What is left has a line at few of the places where one could be supposed, and hardly agrees by chance (the
    background of a-contrario detection: Desolneux et al., IJCV 2000).
    """
    if not len(lines.ridges):
        return lines
    beside = np.zeros(len(lines.ridges), np.int64)
    _count(gathered([picture], [lines]), picture.camera.width_px, picture.camera.height_px, beside)
    return sorted_lines(lines.ridges.select(np.flatnonzero(beside <= MOST_BESIDE)), picture)


@compiled
def _count(seen: Seen, width_px: int, height_px: int, beside: NDArray[np.int64]) -> None:
    """For each sample of the only picture, how many lines run beside it the same way."""
    for s in range(len(beside)):
        dx, dy = seen.direction[s, 0], seen.direction[s, 1]
        for side in (-1.0, 1.0):
            last = 0.0
            for k in range(BESIDE):
                off = side * (FIRST_PX + 2.0 * NEAR_PX * k)
                x, y = seen.place_px[s, 0] - off * dy, seen.place_px[s, 1] + off * dx
                if x < 0.0 or x >= width_px or y < 0.0 or y >= height_px:
                    break
                j = nearest(seen, 0, x, y, dx, dy, TURN_COS)
                if j < 0:
                    continue
                ex, ey = seen.place_px[j, 0] - seen.place_px[s, 0], seen.place_px[j, 1] - seen.place_px[s, 1]
                aside = abs(ex * seen.direction[j, 1] - ey * seen.direction[j, 0])
                # one line may be near two places, and be found at both sizes of the picture
                beside[s] += 1 if aside > last + NEAR_PX else 0
                last = aside
