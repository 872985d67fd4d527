"""A structure while it goes up: solids by material, then parts with textures in colours drawn from the seed."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace

import numpy as np

from sim_bridge.scenes import textures
from sim_bridge.scenes.families.blocks import Blocks
from sim_bridge.scenes.scene import Part
from sim_bridge.scenes.solids import Solid, joined, textured
from sim_bridge.scenes.textures import Rgb, Tile

Texture = Callable[[np.random.Generator, Rgb], Tile]

MATERIALS: dict[str, tuple[Texture, tuple[Rgb, ...]]] = {
    "concrete": (textures.concrete, ((168, 164, 156), (150, 148, 144), (184, 176, 160), (140, 136, 126))),
    "stone": (textures.stone, ((150, 138, 120), (172, 160, 138), (132, 130, 128), (168, 140, 112))),
    "brick": (textures.brick, ((158, 92, 70), (134, 76, 60), (176, 132, 92), (120, 100, 88))),
    "plaster": (textures.plaster, ((205, 186, 150), (214, 208, 196), (196, 160, 128), (176, 186, 178))),
    "paint": (textures.painted_steel, ((92, 120, 106), (110, 124, 140), (150, 62, 50), (176, 172, 160), (70, 92, 128))),
    "trim": (textures.painted_steel, ((168, 160, 140), (196, 192, 184), (88, 92, 98), (110, 84, 62))),
    "white": (textures.painted_steel, ((206, 204, 196), (196, 200, 202), (190, 184, 168))),
    "red": (textures.painted_steel, ((166, 58, 48), (182, 74, 44))),
    "zinc": (textures.galvanised, ((158, 162, 166), (140, 146, 150), (172, 172, 168))),
    "cable": (textures.galvanised, ((128, 130, 132), (104, 106, 110))),
    "ceramic": (textures.painted_steel, ((126, 74, 52), (150, 156, 150), (98, 110, 104))),
    "timber": (textures.bark, ((122, 98, 74), (104, 84, 66))),
    "copper": (textures.patina, ((104, 146, 128), (122, 142, 120))),
    "bronze": (textures.patina, ((124, 104, 74), (104, 96, 84), (136, 112, 78))),
    "rock": (textures.rock, ((132, 128, 122), (156, 148, 136), (112, 110, 108))),
    "marble": (textures.rock, ((196, 190, 178), (178, 176, 172), (188, 168, 146))),
    "tiles": (textures.roof_tiles, ((150, 84, 60), (112, 92, 84), (96, 100, 106))),
    "glass": (textures.window, ((62, 72, 82), (74, 84, 86), (52, 60, 72))),
    "asphalt": (textures.asphalt, ((92, 92, 94), (108, 106, 102))),
    "gravel": (textures.gravel, ((150, 142, 130), (128, 120, 112))),
}
"""Texture of each material and the colours that it comes in."""


class Body:
    """Solids gathered by material; blocks takes the axis-aligned boxes among them."""

    def __init__(self) -> None:
        self.blocks = Blocks()
        self._finished: list[Blocks] = []
        self._solids: dict[str, list[Solid]] = {}

    def add(self, material: str, *solids: Solid) -> None:
        """Add closed solids of a material."""
        self._solids.setdefault(material, []).extend(solids)

    def add_all(self, material: str, solids: Iterable[Solid]) -> None:
        """Add closed solids of a material."""
        self.add(material, *solids)

    def next_blocks(self) -> None:
        """Begin a body of boxes of its own, with its own grid: fewer faces where a building has unlike sections."""
        self._finished.append(self.blocks)
        self.blocks = Blocks()

    def surfaces(self) -> dict[str, Solid]:
        """The closed surface of all solids, by material in alphabetical order, centred in x and y."""
        gathered = {m: list(s) for m, s in self._solids.items()}
        for blocks in (*self._finished, self.blocks):
            for material, solid in blocks.solids().items():
                gathered.setdefault(material, []).append(solid)
        whole = {m: joined(gathered[m]) for m in sorted(gathered)}
        low = np.min([s.vertices_m.min(axis=0) for s in whole.values()], axis=0)
        high = np.max([s.vertices_m.max(axis=0) for s in whole.values()], axis=0)
        middle = (low + high) / 2 * (1.0, 1.0, 0.0)
        return {m: replace(s, vertices_m=s.vertices_m - middle) for m, s in whole.items()}

    def parts(self, rng: np.random.Generator) -> list[Part]:
        """One textured part per material, in colours that vary a little from the palette."""
        return [textured(m, [s], _tile(rng, m)) for m, s in self.surfaces().items()]


def _tile(rng: np.random.Generator, material: str) -> Tile:
    texture, palette = MATERIALS[material]
    base = np.array(palette[int(rng.integers(len(palette)))])
    red, green, blue = (float(c) for c in np.clip(base * rng.uniform(0.9, 1.1) + rng.uniform(-8, 8, 3), 30, 225))
    return texture(rng, (red, green, blue))
