"""The families by name; which structure class and split each belongs to is in missions/scene_names.py.

| class     | train                    | validation | test                  |
|-----------|--------------------------|------------|-----------------------|
"""

from __future__ import annotations

import zlib

import numpy as np

from missions.scene_names import FamilyScene
from sim_bridge.scenes.families.beam_bridges import GirderBridge
from sim_bridge.scenes.families.cable_bridges import CableStayedBridge
from sim_bridge.scenes.families.draw import Family
from sim_bridge.scenes.families.flat_buildings import CourtyardBuilding, OfficeBlock
from sim_bridge.scenes.families.lattice_lines import GuyedVLine, LatticeLine
from sim_bridge.scenes.families.people import SeatedFigure
from sim_bridge.scenes.families.round_towers import Chimney, WaterTower
from sim_bridge.scenes.families.sculptures import KnotSculpture
from sim_bridge.scenes.families.tanks import RefineryColumns, TankFarm
from sim_bridge.scenes.scene import Part

GENERATORS: dict[str, type[Family]] = {
    "girder_bridge": GirderBridge,
    "cable_stayed_bridge": CableStayedBridge,
    "office_block": OfficeBlock,
    "courtyard_building": CourtyardBuilding,
    "chimney": Chimney,
    "water_tower": WaterTower,
    "lattice_line": LatticeLine,
    "guyed_v_line": GuyedVLine,
    "knot_sculpture": KnotSculpture,
    "seated_figure": SeatedFigure,
    "tank_farm": TankFarm,
    "refinery_columns": RefineryColumns,
}


def member(scene: FamilyScene) -> Family:
    """The structure that a family's scene name stands for, its parameters drawn from the seed."""
    return GENERATORS[scene.family].drawn(_rng(scene, 0))


def member_parts(scene: FamilyScene) -> list[Part]:
    """The object's parts, centred on the origin in x and y, standing on z = 0; the same bytes for the same name."""
    return member(scene).build(_rng(scene, 1)).parts(_rng(scene, 2))


def _rng(scene: FamilyScene, stream: int) -> np.random.Generator:
    return np.random.default_rng([scene.seed, zlib.crc32(scene.family.encode()), stream])
