"""Names of true scenes: the built-in structures, and the procedural families with their split.

A family's scene is named "family:NAME:SEED", such as family:girder_bridge:3. Learned parts are trained on the families
of split "train" alone, tuned on "validation" and judged on "test": no kind of structure is in two of them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from missions.errors import UserError

Split = Literal["train", "validation", "test"]

BUILT_IN = ("bridge", "building", "powerline", "statue")
STRUCTURES = ("bridge", "building", "tower", "powerline", "statue", "plant")
SPLITS: tuple[Split, ...] = ("train", "validation", "test")
PREFIX = "family:"
LARGEST_SEED = 2**31 - 1

FAMILIES: dict[str, tuple[str, Split]] = {
    "girder_bridge": ("bridge", "train"),
    "truss_bridge": ("bridge", "train"),
    "suspension_bridge": ("bridge", "train"),
    "tied_arch_bridge": ("bridge", "validation"),
    "trestle_viaduct": ("bridge", "validation"),
    "cable_stayed_bridge": ("bridge", "test"),
    "arch_bridge": ("bridge", "test"),
    "office_block": ("building", "train"),
    "gabled_house": ("building", "train"),
    "tower_block": ("building", "train"),
    "setback_tower": ("building", "validation"),
    "terraced_row": ("building", "validation"),
    "courtyard_building": ("building", "test"),
    "church": ("building", "test"),
    "chimney": ("tower", "train"),
    "lattice_mast": ("tower", "train"),
    "clock_tower": ("tower", "train"),
    "cooling_tower": ("tower", "validation"),
    "observation_tower": ("tower", "validation"),
    "water_tower": ("tower", "test"),
    "lighthouse": ("tower", "test"),
    "lattice_line": ("powerline", "train"),
    "tubular_line": ("powerline", "train"),
    "h_frame_line": ("powerline", "train"),
    "cat_head_line": ("powerline", "validation"),
    "concrete_pole_line": ("powerline", "validation"),
    "guyed_v_line": ("powerline", "test"),
    "substation_gantry": ("powerline", "test"),
    "knot_sculpture": ("statue", "train"),
    "standing_figure": ("statue", "train"),
    "bust": ("statue", "train"),
    "quadruped": ("statue", "validation"),
    "pebble_totem": ("statue", "validation"),
    "seated_figure": ("statue", "test"),
    "equestrian_statue": ("statue", "test"),
    "tank_farm": ("plant", "train"),
    "pipe_rack": ("plant", "train"),
    "boiler_house": ("plant", "train"),
    "gas_spheres": ("plant", "validation"),
    "silo_battery": ("plant", "validation"),
    "refinery_columns": ("plant", "test"),
    "conveyor_works": ("plant", "test"),
    "river_bridge": ("bridge", "test"),
}
"""Structure class and split of every family."""


@dataclass(frozen=True)
class FamilyScene:
    """One scene of a family."""

    family: str
    seed: int

    @property
    def name(self) -> str:
        """The name that a mission or a command gives it."""
        return f"{PREFIX}{self.family}:{self.seed}"


def families_of(split: Split, structure: str = "") -> tuple[str, ...]:
    """The families of a split, of one structure class if given, in the table's order."""
    return tuple(name for name, (kind, part) in FAMILIES.items() if part == split and structure in ("", kind))


def parse_family(name: str) -> FamilyScene | None:
    """What a family's scene name says, or None where the name is not of that form.

    Raises UserError for an unknown family or a seed that is no whole number from 0 to 2147483647.
    """
    if not name.startswith(PREFIX):
        return None
    family, colon, seed = name.removeprefix(PREFIX).partition(":")
    if family not in FAMILIES:
        raise UserError(f"scene {name!r}: there is no family {family!r}; choose one of: {', '.join(FAMILIES)}.")
    if not (colon and seed.isascii() and seed.isdigit() and int(seed) <= LARGEST_SEED):
        raise UserError(f"scene {name!r}: the seed must be a whole number from 0 to {LARGEST_SEED}; write "
                        f"{PREFIX}{family}:1.")
    return FamilyScene(family, int(seed))


def is_scene_name(name: str) -> bool:
    """Whether this names a built-in structure or a family's scene, and not a file. Raises UserError as parse_family."""
    return name in BUILT_IN or parse_family(name) is not None


def check_scene_name(name: str) -> None:
    """Accept a built-in structure or a family's scene. Raises UserError in one sentence otherwise."""
    if not is_scene_name(name):
        raise UserError(f"scene.name: there is no built-in structure {name!r}; choose one of: {', '.join(BUILT_IN)}, "
                        f"or a family's scene such as {PREFIX}girder_bridge:1.")
