"""Pitched roofs."""

from __future__ import annotations

from sim_bridge.scenes.families.body import Body
from sim_bridge.scenes.families.facades import Mass
from sim_bridge.scenes.families.shapes import loft, rectangle_ring, ribbon, turned

TILES_M = 0.22


def gable_roof(body: Body, mass: Mass, rise: float, *, along: str = "x", wall: str = "brick", cover: str = "tiles",
               overhang: float = 0.4) -> None:
    """A roof with its ridge along x or y on top of a mass, with gable walls under it."""
    if along == "x":
        half, length, middle = (mass.y1 - mass.y0) / 2, (-mass.x1, -mass.x0), (mass.y0 + mass.y1) / 2
    else:
        half, length, middle = (mass.x1 - mass.x0) / 2, (mass.y0, mass.y1), (mass.x0 + mass.x1) / 2
    z, drop = mass.z1, overhang * rise / half
    base = [(middle - half, z - 0.02), (middle, z - 0.02), (middle + half, z - 0.02)]
    gable = ribbon(base, [(middle - half, z), (middle, z + rise), (middle + half, z)], *length)
    lower = [(middle - half - overhang, z - drop), (middle, z + rise), (middle + half + overhang, z - drop)]
    upper = [(x, up + TILES_M) for x, up in lower]
    slab = ribbon(lower, upper, length[0] - overhang, length[1] + overhang)
    body.add(wall, turned(gable) if along == "x" else gable)
    body.add(cover, turned(slab) if along == "x" else slab)


def hip_roof(body: Body, mass: Mass, rise: float, cover: str = "tiles", overhang: float = 0.4) -> None:
    """A roof that falls to all four sides of a mass; a pyramid over a square one."""
    middle = (mass.x0 + mass.x1) / 2, (mass.y0 + mass.y1) / 2
    a, b = (mass.x1 - mass.x0) / 2 + overhang, (mass.y1 - mass.y0) / 2 + overhang
    ridge = max(a - b, 0.05), max(b - a, 0.05)
    z = mass.z1 - 0.05
    body.add(cover, loft([rectangle_ring(middle, (a, b), z), rectangle_ring(middle, (a, b), z + 0.18),
                          rectangle_ring(middle, ridge, z + rise)]))
