"""A prior model from file to flight: read, refused with reasons, planned on by ground station and vehicles."""

from __future__ import annotations

import itertools
import json
from pathlib import Path

import numpy as np
import pytest
import trimesh

from ground_station.airspace import Airspace
from ground_station.prior import Prior, open_prior
from ground_station.survey_views import check_survey, survey_views
from missions.errors import UserError
from missions.grid import FREE, OCCUPIED
from missions.messages import RangeScan, SiteBrief
from missions.mission import ExploreSpec, Mission
from missions.mission_file import load_mission
from missions.pads import hover_points
from missions.prior_file import load_prior, prior_file
from missions.run_folder import RunFolder
from missions.sensors import RANGE_DIRECTIONS
from tests.test_loopback import audited, flight_of, fly
from vehicle.sensor_memory import SensorMemory

BOX = trimesh.creation.box(extents=(8.0, 6.0, 7.0)).apply_translation((0.0, 0.0, 3.5))
SITE = SiteBrief(object_min_enu_m=(-4.0, -3.0, 0.0), object_max_enu_m=(4.0, 3.0, 7.0), ground_up_m=0.0)
MISSION = Mission(title="t", knowledge="mesh", explore=ExploreSpec(enabled=False))


@pytest.mark.parametrize("suffix", ["glb", "obj", "ply", "stl"])
def test_every_format_gives_the_same_triangles(tmp_path: Path, suffix: str) -> None:
    scene = trimesh.Scene({"a": BOX, "b": BOX.copy().apply_translation((20.0, 0.0, 0.0))})
    (scene if suffix in ("glb", "obj") else scene.to_mesh()).export(tmp_path / f"m.{suffix}")
    mesh = load_prior(tmp_path / f"m.{suffix}")
    assert len(mesh.faces) == 24
    np.testing.assert_allclose(mesh.bounds, [[-4.0, -3.0, 0.0], [24.0, 3.0, 7.0]], atol=1e-5)


@pytest.mark.parametrize(("name", "text"), [("none.ply", None), ("bad.ply", "no mesh"), ("empty.obj", "v 0 0 0\n"),
                                            ("odd.obj", "v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"), ("a.txt", "x")])
def test_bad_models_are_refused_in_one_sentence(tmp_path: Path, name: str, text: str | None) -> None:
    if text is not None:
        (tmp_path / name).write_text(text)
    with pytest.raises(UserError) as refusal:
        load_prior(tmp_path / name)
    assert str(refusal.value).startswith(str(tmp_path / name))
    assert "\n" not in str(refusal.value)


def test_the_model_is_the_missions_own_or_the_runs(tmp_path: Path) -> None:
    run = RunFolder(tmp_path)
    assert prior_file(Mission(title="t"), run) is None
    assert open_prior(Mission(title="t"), run, SITE) is None
    assert prior_file(MISSION, run) == run.prior
    assert prior_file(Mission(title="t", knowledge="mesh", prior_path="a/b.glb"), run) == Path("a/b.glb")


def test_a_path_without_mesh_knowledge_is_refused(tmp_path: Path) -> None:
    (tmp_path / "m.toml").write_text('title = "x"\nprior_path = "a.glb"\n')
    with pytest.raises(UserError, match="knowledge"):
        load_mission(tmp_path / "m.toml")


def test_survey_views_are_planned_on_the_model_where_nobody_explores() -> None:
    check_survey(MISSION)
    prior = Prior.of(BOX, MISSION, SITE)
    views = survey_views(MISSION, SITE, prior.grid, [], [np.array(hover_points(MISSION, SITE)[0])], prior)
    places = np.array([v.pose.position_enu_m for v in views])
    assert len(views) > 4
    gap = np.maximum(np.abs(places - BOX.bounds.mean(axis=0)) - BOX.extents / 2, 0.0)
    assert np.all(np.linalg.norm(gap, axis=1) >= MISSION.fleet.clearance_m)


def test_planned_legs_are_clear_for_the_vehicles_too() -> None:
    prior = Prior.of(BOX, MISSION, SITE)
    space = Airspace.of(prior.grid, MISSION, SITE, prior)
    a, b = np.array([-6.0, 0.0, 5.0]), np.array([6.0, 0.0, 5.0])
    path = space.path(a, b, [])
    memory = SensorMemory.of(MISSION, SITE, Prior.of(BOX, MISSION, SITE).field)
    memory.put_map(prior.grid)
    ranges = BOX.ray.intersects_location(np.broadcast_to(a, RANGE_DIRECTIONS.shape), RANGE_DIRECTIONS,
                                         multiple_hits=False)
    far = np.full(len(RANGE_DIRECTIONS), np.inf)
    far[ranges[1]] = np.linalg.norm(ranges[0] - a, axis=1)
    memory.put_scan(RangeScan(vehicle_id=1, t_ns=0, position_enu_m=tuple(a), ranges_m=far.tolist()), np.zeros((0, 3)),
                    1.0)
    clear = [memory.field(p, q, 1.0).segments_clear(p, q, MISSION.fleet.clearance_m)[0]
             for p, q in itertools.pairwise(path)]
    assert all(clear)
    assert (prior.grid.state == OCCUPIED).sum() < (prior.grid.state == FREE).sum()


@pytest.mark.loopback
@pytest.mark.xdist_group("loopback")
def test_a_mission_flies_on_the_model_and_the_ground_never_opens_the_scene(tmp_path: Path) -> None:
    settings = ['knowledge="mesh"', "explore.enabled=false", "survey.max_views=4", "fleet.vehicles=1"]
    run, complaints = fly(tmp_path, settings, environment=audited(tmp_path))
    assert complaints == []
    assert run.prior.is_file()
    assert list(flight_of(run)["outcomes"].values()) == ["flown"] * 4
    assert json.loads(run.referee.read_text())["collisions"] == 0
    logs = [p.read_text().splitlines() for p in tmp_path.glob("audit.*")]
    ground = next(lines[1:] for lines in logs if "-m ground_station " in lines[0])
    assert any(line.startswith("open ") and line.endswith(run.prior.name) for line in ground)
    assert [line for line in ground if "very_secret_house" in line or "/truth" in line] == []
