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

BESIDE = 4
"""Places looked at to either side of a line: strips as wide as a match may be off, one beside the other."""
FIRST_PX = 3.0 * NEAR_PX
"""Where the first one is: nearer, it might be the line itself."""
MOST_BESIDE = 1
"""Of these places to both sides, so many may have a line that runs the same way."""


def alone(lines: Lines, picture: SurveyPicture) -> Lines:
    """The lines of a picture without those that run among others like them.

    What is left has a line by chance at few of the places where one could be supposed: the pictures that agree on one
    do so because it is there (the background of a-contrario detection: Desolneux et al., IJCV 2000).
    """
    if not len(lines.ridges):
        return lines
    beside = np.zeros(len(lines.ridges), np.int64)
    _count(gathered([picture], [lines]), picture.camera.width_px, picture.camera.height_px, beside)
    return sorted_lines(lines.ridges.select(np.flatnonzero(beside <= MOST_BESIDE)), picture)


@compiled
def _count(seen: Seen, width_px: int, height_px: int, beside: NDArray[np.int64]) -> None:
    """For each sample of the only picture, in how many places beside it there is a line that runs the same way."""
    for s in range(len(beside)):
        dx, dy = seen.direction[s, 0], seen.direction[s, 1]
        for k in range(2 * BESIDE):
            off = (FIRST_PX + 2.0 * NEAR_PX * (k // 2)) * (1.0 if k % 2 else -1.0)
            x, y = seen.place_px[s, 0] - off * dy, seen.place_px[s, 1] + off * dx
            if 0.0 <= x < width_px and 0.0 <= y < height_px and nearest(seen, 0, x, y, dx, dy, TURN_COS) >= 0:
                beside[s] += 1
