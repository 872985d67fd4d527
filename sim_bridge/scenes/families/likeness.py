"""Organic bodies from melted limbs, and the plinths that they stand on."""

from __future__ import annotations

import numpy as np

from sim_bridge.scenes.families.body import Body
from sim_bridge.scenes.families.shapes import drum
from sim_bridge.scenes.implicit import Field, Limb, relaxed, surface
from sim_bridge.scenes.solids import Solid, planar_mapped


class Shape:
    """Limbs that melt into one closed body, sampled every step_m; joints are rounded over melt_m."""

    def __init__(self, step_m: float, melt_m: float) -> None:
        self._step_m, self._melt_m = step_m, melt_m
        self._limbs: list[tuple[Limb, float]] = []

    def add(self, *limbs: Limb, melt_m: float = 0.0) -> None:
        """Add limbs, with a rounding of their own if given."""
        self._limbs += [(limb, melt_m or self._melt_m) for limb in limbs]

    def solid(self) -> Solid:
        """The body's surface, evened out."""
        margin = 3.0 * self._step_m + max(melt for _, melt in self._limbs)
        lo = np.min([limb[1] for limb, _ in self._limbs], axis=0) - margin
        hi = np.max([limb[2] for limb, _ in self._limbs], axis=0) + margin
        field = Field.empty(lo, hi, self._step_m)
        for (distance, low, high), melt in self._limbs:
            field.add(distance, low, high, melt)
        vertices, faces = surface(field)
        return planar_mapped(relaxed(vertices, faces, rounds=6), faces)


def plinth(body: Body, kind: str, half: tuple[float, float], height: float) -> None:
    """A plinth with half sides (x, y) at its top: a moulded block, a stack of steps, or a drum."""
    x, y = half
    if kind == "drum":
        r = float(np.hypot(x, y)) * 0.95
        body.add("stone", drum([(r + 0.5, 0.0), (r + 0.5, 0.35), (r + 0.1, 0.45), (r + 0.1, height - 0.5),
                                (r + 0.35, height - 0.35), (r + 0.35, height)], sides=56))
    elif kind == "steps":
        count = min(6, max(2, round(height / 0.5)))
        for i in range(count):
            out = 0.4 * (count - 1 - i)
            low, high = i * height / count, (i + 1) * height / count
            body.blocks.add("stone", (-x - out, -y - out, low), (x + out, y + out, high))
    else:
        for out, low, high in ((0.5, 0.0, 0.4), (0.0, 0.4, height - 0.45), (0.25, height - 0.45, height)):
            body.blocks.add("stone", (-x - out, -y - out, low), (x + out, y + out, high))
