"""The families by name. Structure class and split of each are the table in missions/scene_names.py:

bridge     train       girder_bridge, truss_bridge, suspension_bridge
           validation  tied_arch_bridge, trestle_viaduct
           test        cable_stayed_bridge, arch_bridge, river_bridge
building   train       office_block, gabled_house, tower_block
           validation  setback_tower, terraced_row
           test        courtyard_building, church
tower      train       chimney, lattice_mast, clock_tower
           validation  cooling_tower, observation_tower
           test        water_tower, lighthouse
powerline  train       lattice_line, tubular_line, h_frame_line
           validation  cat_head_line, concrete_pole_line
           test        guyed_v_line, substation_gantry
statue     train       knot_sculpture, standing_figure, bust
           validation  quadruped, pebble_totem
           test        seated_figure, equestrian_statue
plant      train       tank_farm, pipe_rack, boiler_house
           validation  gas_spheres, silo_battery
           test        refinery_columns, conveyor_works
"""

from __future__ import annotations

import zlib

import numpy as np

from missions.scene_names import FamilyScene
from sim_bridge.scenes.families.animals import EquestrianStatue, Quadruped
from sim_bridge.scenes.families.arch_bridges import ArchBridge, TiedArchBridge
from sim_bridge.scenes.families.beam_bridges import GirderBridge, TrestleViaduct, TrussBridge
from sim_bridge.scenes.families.bulk import ConveyorWorks, GasSpheres, SiloBattery
from sim_bridge.scenes.families.cable_bridges import CableStayedBridge, SuspensionBridge
from sim_bridge.scenes.families.draw import Family
from sim_bridge.scenes.families.flat_buildings import CourtyardBuilding, OfficeBlock
from sim_bridge.scenes.families.heads import Bust
from sim_bridge.scenes.families.high_buildings import SetbackTower, TowerBlock
from sim_bridge.scenes.families.lattice_lines import CatHeadLine, GuyedVLine, LatticeLine
from sim_bridge.scenes.families.lookouts import Lighthouse, ObservationTower
from sim_bridge.scenes.families.people import SeatedFigure, StandingFigure
from sim_bridge.scenes.families.pitched_buildings import Church, GabledHouse, TerracedRow
from sim_bridge.scenes.families.pole_lines import ConcretePoleLine, HFrameLine, TubularLine
from sim_bridge.scenes.families.river_bridges import RiverBridge
from sim_bridge.scenes.families.round_towers import Chimney, CoolingTower, WaterTower
from sim_bridge.scenes.families.sculptures import KnotSculpture, PebbleTotem
from sim_bridge.scenes.families.square_towers import ClockTower, LatticeMast
from sim_bridge.scenes.families.substations import SubstationGantry
from sim_bridge.scenes.families.tanks import RefineryColumns, TankFarm
from sim_bridge.scenes.families.works import BoilerHouse, PipeRack
from sim_bridge.scenes.scene import Part, merged

GENERATORS: dict[str, type[Family]] = {
    "girder_bridge": GirderBridge,
    "truss_bridge": TrussBridge,
    "suspension_bridge": SuspensionBridge,
    "tied_arch_bridge": TiedArchBridge,
    "trestle_viaduct": TrestleViaduct,
    "cable_stayed_bridge": CableStayedBridge,
    "arch_bridge": ArchBridge,
    "office_block": OfficeBlock,
    "gabled_house": GabledHouse,
    "tower_block": TowerBlock,
    "setback_tower": SetbackTower,
    "terraced_row": TerracedRow,
    "courtyard_building": CourtyardBuilding,
    "church": Church,
    "chimney": Chimney,
    "lattice_mast": LatticeMast,
    "clock_tower": ClockTower,
    "cooling_tower": CoolingTower,
    "observation_tower": ObservationTower,
    "water_tower": WaterTower,
    "lighthouse": Lighthouse,
    "lattice_line": LatticeLine,
    "tubular_line": TubularLine,
    "h_frame_line": HFrameLine,
    "cat_head_line": CatHeadLine,
    "concrete_pole_line": ConcretePoleLine,
    "guyed_v_line": GuyedVLine,
    "substation_gantry": SubstationGantry,
    "knot_sculpture": KnotSculpture,
    "standing_figure": StandingFigure,
    "bust": Bust,
    "quadruped": Quadruped,
    "pebble_totem": PebbleTotem,
    "seated_figure": SeatedFigure,
    "equestrian_statue": EquestrianStatue,
    "tank_farm": TankFarm,
    "pipe_rack": PipeRack,
    "boiler_house": BoilerHouse,
    "gas_spheres": GasSpheres,
    "silo_battery": SiloBattery,
    "refinery_columns": RefineryColumns,
    "conveyor_works": ConveyorWorks,
    "river_bridge": RiverBridge,
}


def member(scene: FamilyScene) -> Family:
    """The structure that a family's scene name stands for, its parameters drawn from the seed."""
    return GENERATORS[scene.family].drawn(_rng(scene, 0))


def member_parts(scene: FamilyScene) -> list[Part]:
    """The object's parts, centred on the origin in x and y, standing on z = 0, and those around it where the family
    brings them; the same bytes for the same name."""
    family = member(scene)
    parts = family.build(_rng(scene, 1)).parts(_rng(scene, 2))
    vertices, _ = merged(parts)
    return parts + family.surroundings(_rng(scene, 3), vertices.min(axis=0), vertices.max(axis=0))


def _rng(scene: FamilyScene, stream: int) -> np.random.Generator:
    return np.random.default_rng([scene.seed, zlib.crc32(scene.family.encode()), stream])
