"""Where a vehicle was, as the corners of its way: what lies on a straight between them is left out."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from missions.messages import Vector

CORNER_M = 0.1
"""The trail passes what it leaves out this near."""
MOST_BETWEEN = 12
"""Places between two corners, so that the trail's last corner is never far behind."""
MOST_CORNERS = 400
"""Of every two in the older half the one that says more is kept, so a page does not grow in a long mission."""


class Trail:
    """Grows at its end."""

    def __init__(self) -> None:
        self.corners: list[Vector] = []
        self.thinned = 0
        """How often older corners have been left out."""
        self._since: list[Vector] = []

    def __len__(self) -> int:
        return len(self.points)

    @property
    def points(self) -> list[Vector]:
        """The corners, and where the vehicle was last."""
        return [*self.corners, *self._since[-1:]]

    def extend(self, places_enu_m: Iterable[Vector]) -> None:
        """The vehicle has been here since."""
        for place in places_enu_m:
            if self._since and (len(self._since) == MOST_BETWEEN or self._turns(place)):
                self.corners.append(self._since[-1])
                self._since = []
            (self._since if self.corners else self.corners).append(place)
        if len(self.corners) > MOST_CORNERS:
            self._thin(len(self.corners) // 4)
            self.thinned += 1

    def _thin(self, pairs: int) -> None:
        """Of each of the oldest pairs of corners, after the first, keep the one farther from between its neighbours."""
        corners = np.array(self.corners[:2 * pairs + 2])
        bend = np.linalg.norm(corners[1:-1] - 0.5 * (corners[:-2] + corners[2:]), axis=1).reshape(pairs, 2)
        kept = 1 + 2 * np.arange(pairs) + np.argmax(bend, axis=1)
        self.corners[1:2 * pairs + 1] = [self.corners[i] for i in kept]

    def _turns(self, place: Vector) -> bool:
        """Whether a straight from the last corner would leave the way that was flown."""
        start, between = np.array(self.corners[-1]), np.array(self._since)
        along = np.array(place) - start
        share = np.clip((between - start) @ along / max(float(along @ along), 1e-9), 0.0, 1.0)
        return bool(np.linalg.norm(between - start - share[:, None] * along, axis=1).max() > CORNER_M)
