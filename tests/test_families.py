"""The procedural families: repeatable, closed, standing on the ground, of different members, split without overlap."""

from __future__ import annotations

import argparse
import dataclasses
import itertools
import json
from pathlib import Path

import numpy as np
import PIL.Image
import pytest
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from ground_station.launcher import _parse
from ground_station.mission_setup import prepare
from missions.camera import Camera
from missions.errors import UserError
from missions.messages import SiteBrief
from missions.mission import Mission, SiteSpec
from missions.pads import takeoff_points
from missions.scene_names import BUILT_IN as NAMED
from missions.scene_names import FAMILIES, SPLITS, STRUCTURES, FamilyScene, families_of, parse_family
from missions.simulation import SceneSpec
from sim_bridge.render.gallery import Card, whole_object, write_gallery
from sim_bridge.scenes import commands
from sim_bridge.scenes.builtin import BUILT_IN
from sim_bridge.scenes.families.blocks import Blocks
from sim_bridge.scenes.families.body import Body
from sim_bridge.scenes.families.make import make_family
from sim_bridge.scenes.families.registry import GENERATORS, member, member_parts
from sim_bridge.scenes.load import load_scene
from sim_bridge.scenes.repair import Repairs, mended, without_doubles
from sim_bridge.scenes.river import WATER
from sim_bridge.scenes.scene import Part
from sim_bridge.scenes.solids import joined
from sim_bridge.scenes.surroundings import PREFIX

SEEDS = (1, 2)
LARGEST_M, TALLEST_M = 75.0, 56.0


def built_body(name: str, seed: int) -> Body:
    return member(FamilyScene(name, seed)).build(np.random.default_rng(seed))


def assert_solid(vertices: np.ndarray, faces: np.ndarray) -> None:
    """Every edge is run through as often in one direction as in the other, no face lies on another one, and whatever
    hangs together encloses a positive volume."""
    _, place = np.unique(np.floor(vertices / 1e-5 + 0.37).astype(np.int64), axis=0, return_inverse=True)
    corners = place.ravel()[faces].astype(np.int64)
    start, end = (np.concatenate([np.roll(corners, -k, axis=1)[:, 0] for k in (i, i + 1, i + 2)]) for i in (0, 1))
    count = place.max() + 1
    np.testing.assert_array_equal(np.sort(start * count + end), np.sort(end * count + start))
    a, b, c = np.sort(corners, axis=1).T
    assert len(np.unique((a * count + b) * count + c)) == len(faces)
    _, body = connected_components(coo_array((np.ones(len(start)), (start, end)), shape=(count, count)))
    middle = vertices.mean(axis=0)
    p, q, r = (vertices[faces[:, i]] - middle for i in range(3))
    volume = np.bincount(body[corners[:, 0]], (p * np.cross(q, r)).sum(axis=1))
    assert (volume[np.unique(body[corners[:, 0]])] > 0).all()


@pytest.mark.parametrize(("name", "seed"), list(itertools.product(FAMILIES, SEEDS)))
def test_object_is_closed_and_stands_on_the_ground(name: str, seed: int) -> None:
    built = joined(built_body(name, seed).surfaces().values())
    lo, hi = built.vertices_m.min(axis=0), built.vertices_m.max(axis=0)
    assert lo[2] == pytest.approx(0.0, abs=1e-9)
    np.testing.assert_allclose((lo + hi)[:2], 0.0, atol=1e-9)
    assert (hi - lo)[:2].max() < LARGEST_M
    assert 6.0 < hi[2] < TALLEST_M
    assert 2_000 < len(built.faces) < 230_000
    assert_solid(built.vertices_m, built.faces)


@pytest.mark.parametrize("structure", STRUCTURES)
def test_parts_are_sound_and_textured(structure: str) -> None:
    parts = member_parts(FamilyScene(families_of("test", structure)[0], 3))
    repairs = Repairs()
    without_doubles(parts, repairs)
    for part in parts:
        mended(part.vertices_enu_m, part.faces, part.uv, repairs)
        assert repairs == Repairs(), part.name
        assert part.is_object
        assert not part.procedural
        assert part.texture is not None
        assert part.texture.std() > 8


@pytest.mark.parametrize("name", list(FAMILIES))
def test_two_seeds_differ_in_parameters_and_shape(name: str) -> None:
    first, second = (member(FamilyScene(name, seed)) for seed in SEEDS)
    assert first == member(FamilyScene(name, SEEDS[0]))
    different = [f.name for f in dataclasses.fields(first)
                 if getattr(first, f.name) != getattr(second, f.name)]
    assert len(different) >= 3


def same(a: list[Part], b: list[Part]) -> bool:
    return all(p.name == q.name and p.vertices_enu_m.tobytes() == q.vertices_enu_m.tobytes()
               and p.faces.tobytes() == q.faces.tobytes() and np.array_equal(p.texture, q.texture)
               and np.array_equal(p.uv, q.uv) for p, q in zip(a, b, strict=True))


def test_the_name_says_everything() -> None:
    scene = make_family("water_tower", 7)
    assert scene.name == "family:water_tower:7"
    again = load_scene(SceneSpec(name="family:water_tower:7", seed=99), SiteSpec())
    assert same(scene.parts, again.parts)
    assert scene.object_min_enu_m == again.object_min_enu_m
    assert scene.object_min_enu_m[2] == scene.ground_up_m == 0.0
    assert 20_000 <= scene.triangles() <= 300_000
    vertices, _ = scene.object_mesh()
    np.testing.assert_array_equal(vertices.max(axis=0), scene.object_max_enu_m)


def test_splits_share_no_family_and_hold_every_class() -> None:
    assert set(FAMILIES) == set(GENERATORS)
    assert set(NAMED) == set(BUILT_IN)
    assert sorted(n for split in SPLITS for n in families_of(split)) == sorted(FAMILIES)
    assert len(set(GENERATORS.values())) == len(GENERATORS)
    for split, structure in itertools.product(("train", "test"), STRUCTURES):
        assert families_of(split, structure)


@pytest.mark.parametrize("name", ["family:castle:1", "family:chimney", "family:chimney:", "family:chimney:-1",
                                  "family:chimney:1.5", "family:chimney:99999999999", "family:", "family::1"])
def test_bad_names_are_refused_in_one_sentence(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(UserError):
        parse_family(name)
    assert commands.main(["export", name, "unused"]) == 2
    said = capsys.readouterr().err
    assert name in said
    assert said.count("\n") == 1


def test_commands_take_a_family_s_scene(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert commands.main(["export", "family:chimney:3", str(tmp_path), "--json"]) == 0
    written = json.loads(capsys.readouterr().out)
    assert commands.main(["check", written.pop("folder"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {**written, "name": "family_chimney_3"}


def test_launcher_takes_a_family_s_scene_and_refuses_a_wrong_one(tmp_path: Path) -> None:
    def options(scene: str) -> argparse.Namespace:
        return _parse(["bridge", "--scene", scene, "--run", str(tmp_path / scene.replace(":", "_"))])

    mission, _ = prepare(options("family:church:5"))
    assert (mission.scene.name, mission.scene.path) == ("family:church:5", "")
    for wrong in ("family:church:x", "family:temple:1", "nowhere.glb"):
        with pytest.raises(UserError):
            prepare(options(wrong))


def test_the_river_flows_under_the_bridge_and_nothing_grows_in_it() -> None:
    scene = make_family("river_bridge", 4)
    parts = {p.name: p for p in scene.parts}
    water = parts[WATER]
    assert [p.name for p in scene.parts if p.water] == [WATER]
    low, high = water.vertices_enu_m.min(axis=0), water.vertices_enu_m.max(axis=0)
    assert low[2] == high[2] < scene.ground_up_m == 0.0
    assert low[0] > scene.object_min_enu_m[0]
    assert high[0] < scene.object_max_enu_m[0]
    for name in ("trunks", "rocks"):
        x = parts[PREFIX + name].vertices_enu_m[:, 0]
        assert ((x < low[0]) | (x > high[0])).all()
    site = SiteBrief(object_min_enu_m=scene.object_min_enu_m, object_max_enu_m=scene.object_max_enu_m, ground_up_m=0.0)
    pads = np.array(takeoff_points(Mission(title="river"), site))
    weir = parts[PREFIX + "weir"].vertices_enu_m
    assert (weir[:, :2].min(axis=0) < pads[:, :2].min(axis=0)).all()
    assert (pads[:, 1] > weir[weir[:, 1] < scene.object_min_enu_m[1]][:, 1].min()).all()


def test_gallery_shows_scenes_with_their_parameters(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "sheet.html"
    assert commands.main(["gallery", str(file), "--families", "clock_tower", "--seeds", "2", "--json"]) == 0
    parameters = json.loads(capsys.readouterr().out)["scenes"][0]["parameters"]
    assert parameters == dataclasses.asdict(member(FamilyScene("clock_tower", 2)))
    page = file.read_text()
    assert page.count("data:image/jpeg;base64,") == 2
    assert "family:clock_tower:2" in page
    assert commands.main(["gallery", str(tmp_path / "sheet.gif")]) == 2


def test_gallery_as_png(tmp_path: Path) -> None:
    red = np.full((300, 480, 3), (200, 0, 0), np.uint8)
    write_gallery(tmp_path / "sheet.png", [Card("tower, test", str(k), "", (red,)) for k in range(5)])
    with PIL.Image.open(tmp_path / "sheet.png") as sheet:
        assert sheet.size == (4 * 480, 2 * (300 + 18))
        assert sheet.getpixel((240, 500)) == (200, 0, 0)


def test_portraits_hold_the_object_s_box() -> None:
    scene = make_family("bust", 2)
    camera = Camera.from_diagonal_fov(480, 300, 50.0)
    for azimuth, up in itertools.product(np.linspace(0.0, 6.0, 7), (0.1, 0.5)):
        camera_from_enu = whole_object(scene, camera, azimuth, up).camera_from_enu
        corners = np.array(list(itertools.product(*zip(scene.object_min_enu_m, scene.object_max_enu_m, strict=True))))
        x, y, z = (corners @ camera_from_enu[:3, :3].T + camera_from_enu[:3, 3]).T
        assert (z > 0).all()
        assert (np.abs(x / z) <= camera.cx_px / camera.fx_px).all()
        assert (np.abs(y / z) <= camera.cy_px / camera.fy_px).all()


def test_blocks_keep_only_faces_to_the_air() -> None:
    blocks = Blocks()
    blocks.add("a", (0, 0, 0), (2, 2, 2))
    blocks.add("b", (1, 0, 0), (3, 2, 2))
    blocks.cut((1, 1, 1), (3, 3, 3))
    solids = blocks.solids()
    both = joined(solids.values())
    assert_solid(both.vertices_m, both.faces)
    corners = both.vertices_m[both.faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (corners[:, 0] * normal).sum() / 6 == pytest.approx(12.0 - 2.0)
    assert np.linalg.norm(normal, axis=1).sum() / 2 == pytest.approx(2 * (6 + 6 + 4))
    assert {name: round(float(s.vertices_m[:, 0].min())) for name, s in solids.items()} == {"a": 0, "b": 1}
