"""Take-off columns held against the true scene."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from missions.errors import UserError
from missions.messages import SiteBrief
from missions.mission import FleetSpec, Mission, SiteSpec
from missions.simulation import SceneSpec
from sim_bridge.__main__ import site_brief
from sim_bridge.opening import check_columns
from sim_bridge.scenes.builtin import BUILT_IN
from sim_bridge.scenes.load import load_scene
from sim_bridge.truth import Truth

SITE = SiteBrief(object_min_enu_m=(-4.0, -3.0, 0.0), object_max_enu_m=(4.0, 3.0, 7.0), ground_up_m=0.0)


@pytest.mark.parametrize("name", sorted(BUILT_IN))
def test_eight_vehicles_take_off_freely_beside_every_built_in_structure(name: str) -> None:
    mission = Mission(title="t", scene=SceneSpec(name=name), fleet=FleetSpec(vehicles=8))
    scene = load_scene(mission.scene, SiteSpec())
    check_columns(mission, site_brief(mission, scene), Truth(*scene.mesh(), []))


@pytest.mark.parametrize("where", [(0.0, -15.0, 3.0), (2.5, -17.5, 1.5), (-2.0, -13.0, 5.5)])
def test_a_pole_in_a_column_is_named_with_its_vehicle(where: tuple[float, float, float]) -> None:
    mission = Mission(title="t", fleet=FleetSpec(vehicles=1))
    pole = trimesh.creation.box((0.3, 0.3, 1.0), np.array(trimesh.transformations.translation_matrix(where)))
    with pytest.raises(UserError, match=r"column of vehicle 1, over \(0\.0, -15\.0\) m, .* fleet\.takeoff_enu_m"):
        check_columns(mission, SITE, Truth(pole.vertices, pole.faces, []))
    elsewhere = mission.fleet.__class__(vehicles=1, takeoff_enu_m=[(20.0, -15.0, 0.2)])
    check_columns(Mission(title="t", fleet=elsewhere), SITE, Truth(pole.vertices, pole.faces, []))
