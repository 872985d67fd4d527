"""Steel frames that carry pipes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim_bridge.scenes.families.body import Body
from sim_bridge.scenes.families.shapes import bar, rod


@dataclass(frozen=True)
class Rack:
    """A pipe rack along x: its length and width, how many tiers, and how far they are apart (the lowest 1 m more)."""

    length: float
    width: float
    tiers: int
    tier_m: float

    def height(self, tier: int) -> float:
        """Height of a tier's beams, counted from 0."""
        return 1.0 + (tier + 1) * self.tier_m


def raise_rack(body: Body, rack: Rack, middle: tuple[float, float], rng: np.random.Generator) -> None:
    """Columns, beams, bracing, and pipes of differing sizes on every tier."""
    x0, y0 = middle
    bents = np.linspace(-rack.length / 2, rack.length / 2, max(2, round(rack.length / 6.0) + 1)) + x0
    top = rack.height(rack.tiers - 1)
    for x in bents:
        for s in (-1.0, 1.0):
            y = y0 + s * rack.width / 2
            body.blocks.add("concrete", (x - 0.4, y - 0.4, 0.0), (x + 0.4, y + 0.4, 0.35))
            body.add("paint", bar((x, y, 0.3), (x, y, top + 0.3), 0.26, 0.26))
        for tier in range(rack.tiers):
            z = rack.height(tier)
            body.add("paint", bar((x, y0 - rack.width / 2 - 0.3, z), (x, y0 + rack.width / 2 + 0.3, z), 0.2, 0.3))
    for tier in range(rack.tiers):
        z = rack.height(tier)
        for s in (-1.0, 1.0):
            y = y0 + s * rack.width / 2
            body.add("paint", bar((bents[0], y, z - 0.35), (bents[-1], y, z - 0.35), 0.16, 0.22))
        _pipes(body, rack, (x0, y0), z + 0.15, rng)
    for a, b in zip(bents[:-1:2], bents[1::2], strict=False):
        for s in (-1.0, 1.0):
            y = y0 + s * rack.width / 2
            body.add("paint", bar((a, y, 0.4), (b, y, top - 0.4), 0.1), bar((b, y, 0.4), (a, y, top - 0.4), 0.1))


def _pipes(body: Body, rack: Rack, middle: tuple[float, float], z: float, rng: np.random.Generator) -> None:
    """Pipes side by side until the tier is full."""
    x0, y0 = middle
    y = -rack.width / 2 + 0.3
    while y < rack.width / 2 - 0.35:
        r = float(rng.choice([0.06, 0.1, 0.15, 0.22]))
        end = rack.length / 2 + rng.uniform(0.2, 0.8)
        material = ("zinc", "paint", "white", "red")[int(rng.choice(4, p=[0.5, 0.25, 0.2, 0.05]))]
        body.add(material, rod((x0 - end, y0 + y + r, z + r - 0.01), (x0 + end, y0 + y + r, z + r - 0.01), r, 14))
        y += 2.0 * r + rng.uniform(0.08, 0.3)
