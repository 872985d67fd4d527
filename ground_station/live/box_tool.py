"""A box that a person draws in the 3-D view by dragging two of its corners."""

from __future__ import annotations

import numpy as np
import viser

from ground_station.live.colours import Rgb
from ground_station.live.map_in_scene import box_edges
from missions.messages import Vector, vector

LEAST_M = 0.5
HANDLE_PX = 90.0


class BoxTool:
    """Two corners to drag and the box between them."""

    def __init__(self, scene: viser.SceneApi, lower: Vector, upper: Vector, colour: Rgb) -> None:
        self._edges = scene.add_line_segments("/tool/box", box_edges(lower, upper), colour, thickness=3.0,
                                              thickness_units="screen")
        self._corners = [scene.add_transform_controls(
            f"/tool/corner_{n}", scale=HANDLE_PX, fixed=True, position=corner,
            disable_rotations=True, disable_sliders=True, depth_test=False)
            for n, corner in enumerate((lower, upper))]
        for corner in self._corners:
            corner.on_update(lambda _: self._redraw())

    @property
    def box(self) -> tuple[Vector, Vector]:
        """Its lower and upper corner, whichever way they were dragged."""
        a, b = (np.array(c.position) for c in self._corners)
        low, high = np.minimum(a, b), np.maximum(np.maximum(a, b), np.minimum(a, b) + LEAST_M)
        return vector(low, 2), vector(high, 2)

    def remove(self) -> None:
        """Take it away."""
        for node in (*self._corners, self._edges):
            node.remove()

    def _redraw(self) -> None:
        self._edges.points = box_edges(*self.box)
