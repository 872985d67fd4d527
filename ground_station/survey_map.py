"""The explored map as the survey's own pictures complete it: they show what exploration has left out."""

from __future__ import annotations

import cv2

from ground_station.ingest import Picture
from missions.grid import VoxelGrid
from perception.mapping.explorer_map import ExplorerMap

BATCH = 8
"""Pictures that are mapped at a time: their depth is looked for among all before them and each other."""


class SurveyMap:
    """Survey pictures in, at the exploration's resolution; map out."""

    def __init__(self, explored: ExplorerMap, picture_px: tuple[int, int]) -> None:
        """explored: is added to."""
        self._map, self._picture_px = explored, picture_px
        self._new = 0

    def add(self, picture: Picture) -> None:
        """Take in a picture; one that was not decoded is left out."""
        if picture.rgb is None:
            return
        small = cv2.resize(picture.rgb, self._picture_px, interpolation=cv2.INTER_AREA).astype(picture.rgb.dtype)
        self._map.add_picture(small, picture.meta.camera.scaled(*self._picture_px), picture.meta.pose)
        self._new += 1
        if self._new >= BATCH:
            self._update()

    def grid(self) -> VoxelGrid:
        """With all pictures so far."""
        self._update()
        return self._map.grid()

    def _update(self) -> None:
        self._map.update()
        self._new = 0
