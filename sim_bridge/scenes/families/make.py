"""One scene of a family by name and seed."""

from __future__ import annotations

from missions.mission import SiteSpec
from missions.scene_names import FamilyScene
from missions.simulation import SceneSpec
from sim_bridge.scenes.load import load_scene
from sim_bridge.scenes.scene import Scene


def make_family(name: str, seed: int) -> Scene:
    """The scene "family:NAME:SEED" with its ground and surroundings. Raises UserError for an unknown family."""
    return load_scene(SceneSpec(name=FamilyScene(name, seed).name), SiteSpec())
