"""The built-in structures: sizes, winding, exposed faces, free space for flying, repeatability."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from missions.errors import UserError
from missions.mission import SiteSpec
from missions.simulation import RenderSpec, SceneSpec
from sim_bridge.kept_world import read_world, world_bytes
from sim_bridge.render.light import make_light
from sim_bridge.scenes import powerline
from sim_bridge.scenes.builtin import BUILT_IN
from sim_bridge.scenes.exposure import exposed_surface
from sim_bridge.scenes.implicit import Field, round_cone, surface
from sim_bridge.scenes.load import load_scene
from sim_bridge.scenes.repair import Repairs, mended, without_doubles
from sim_bridge.scenes.scene import Scene
from sim_bridge.scenes.solids import beam, box, cells, lathe, tube
from sim_bridge.scenes.surroundings import GROUND, PREFIX

pytestmark = pytest.mark.xdist_group("scenes")

LIGHT = make_light(RenderSpec(), 1)
SIZES_M = {"building": (50.1, 5.5, 21.1), "bridge": (62.2, 9.9, 22.4), "statue": (43.6, 9.5, 51.1)}


@pytest.fixture(scope="module")
def scenes() -> dict[str, Scene]:
    return {name: load_scene(SceneSpec(name=name), SiteSpec()) for name in BUILT_IN}


@pytest.mark.parametrize("name", sorted(SIZES_M))
def test_overall_size_is_the_thesis_s(scenes: dict[str, Scene], name: str) -> None:
    lo, hi = np.array(scenes[name].object_min_enu_m), np.array(scenes[name].object_max_enu_m)
    np.testing.assert_allclose(hi - lo, SIZES_M[name], atol=1e-9)
    np.testing.assert_allclose((lo + hi)[:2], 0.0, atol=1e-9)
    assert lo[2] == scenes[name].ground_up_m == 0.0


def test_powerline_spans_its_length_between_towers_of_30_m(scenes: dict[str, Scene]) -> None:
    scene = scenes["powerline"]
    assert scene.object_max_enu_m[0] - scene.object_min_enu_m[0] == pytest.approx(62.5, abs=1e-9)
    assert scene.object_max_enu_m[2] > 30.0
    wires = next(p for p in scene.parts if p.name == "conductors").vertices_enu_m
    low = wires[np.abs(wires[:, 0]) < 0.3]
    y, z = powerline.conductor_ends_m()[0]
    one = low[np.abs(low[:, 1] - y) < 0.1]
    below = one[np.abs(one[:, 2] - (z - powerline.SAG_M)) < 0.1]
    assert np.ptp(below[:, 1]) == pytest.approx(0.03, abs=0.005)


@pytest.mark.parametrize("name", sorted(BUILT_IN))
def test_parts_are_sound_and_textured(scenes: dict[str, Scene], name: str) -> None:
    scene = scenes[name]
    assert 20_000 <= scene.triangles() <= 150_000
    repairs = Repairs()
    without_doubles(scene.parts, repairs)
    for part in scene.parts:
        vertices, _, uv = mended(part.vertices_enu_m, part.faces, part.uv, repairs)
        assert repairs == Repairs(), part.name
        assert len(vertices) == len(part.vertices_enu_m)
        assert part.texture is not None
        assert uv is not None
        assert not part.procedural
        assert part.texture.std() > 10
        assert part.is_object != part.name.startswith(PREFIX)


def test_same_seed_same_scene(scenes: dict[str, Scene]) -> None:
    for a, b in zip(scenes["statue"].parts, load_scene(SceneSpec(name="statue"), SiteSpec()).parts, strict=True):
        assert a.vertices_enu_m.tobytes() == b.vertices_enu_m.tobytes()
        assert a.faces.tobytes() == b.faces.tobytes()
        assert a.texture is not None
        assert b.texture is not None
        assert a.texture.tobytes() == b.texture.tobytes()


@pytest.mark.parametrize("name", ["bridge", "powerline"])
def test_a_scene_that_is_kept_is_read_as_it_was(scenes: dict[str, Scene], tmp_path: Path, name: str) -> None:
    path, scene = tmp_path / "scene.npz", scenes[name]
    path.write_bytes(world_bytes(scene, LIGHT))
    kept = read_world(path)
    assert kept is not None
    again, light = kept
    assert world_bytes(again, light) == world_bytes(scene, LIGHT)
    for a, b in zip(scene.parts, again.parts, strict=True):
        for one, other in ((a.vertices_enu_m, b.vertices_enu_m), (a.faces, b.faces), (a.uv, b.uv),
                           (a.texture, b.texture)):
            assert (one is None) == (other is None)
            assert one is None or (one.dtype == other.dtype and np.array_equal(one, other))
    assert len({id(p.texture) for p in again.parts}) == len({id(p.texture) for p in scene.parts})


def test_half_a_scene_is_none(scenes: dict[str, Scene], tmp_path: Path) -> None:
    path = tmp_path / "scene.npz"
    assert read_world(path) is None
    path.write_bytes(world_bytes(scenes["powerline"], LIGHT)[:-1000])
    assert read_world(path) is None


def test_other_seed_other_picture_and_without_surroundings_only_ground(scenes: dict[str, Scene]) -> None:
    other = load_scene(SceneSpec(name="statue", seed=2, surroundings=False), SiteSpec())
    first = other.parts[0].texture
    assert first is not None
    assert not np.array_equal(first, scenes["statue"].parts[0].texture)
    assert {p.name for p in other.parts if not p.is_object} == {GROUND, PREFIX + "apron"}


@pytest.mark.parametrize("name", sorted(BUILT_IN))
def test_cameras_and_pads_have_room(scenes: dict[str, Scene], name: str) -> None:
    scene = scenes[name]
    lo, hi = np.array(scene.object_min_enu_m), np.array(scene.object_max_enu_m)
    for part in scene.parts:
        v = part.vertices_enu_m
        beside = np.maximum(lo - v, v - hi)[:, :2].max(axis=1)
        if part.is_object:
            continue
        assert not ((v[:, 2] > 1.0) & (beside < 10.0)).any()
        assert not ((v[:, 2] > 0.05) & (v[:, 1] < lo[1]) & (v[:, 1] > lo[1] - 20.0)).any()
    ground = next(p for p in scene.parts if p.name == GROUND).vertices_enu_m
    assert (np.ptp(ground, axis=0)[:2] >= 160.0 - 1e-9).all()


@pytest.mark.parametrize("name", sorted(BUILT_IN))
def test_nearly_all_of_the_object_is_exposed_and_wound_outwards(scenes: dict[str, Scene], name: str) -> None:
    scene = scenes[name]
    vertices, faces = scene.object_mesh()
    seen = exposed_surface(scene, 4000, seed=3)
    np.testing.assert_allclose(np.linalg.norm(seen.normals, axis=1), 1.0, atol=1e-9)
    a, b, c = (vertices[faces[seen.faces, i]] for i in range(3))
    own = np.cross(b - a, c - a)
    own /= np.linalg.norm(own, axis=1, keepdims=True)
    assert np.abs(((seen.points_enu_m - a) * own).sum(axis=1)).max() < 1e-9
    assert ((own * seen.normals).sum(axis=1) > 0).mean() > 0.99


def test_exposure_leaves_out_what_is_buried_and_is_repeatable(scenes: dict[str, Scene]) -> None:
    scene = scenes["bridge"]
    inner = box((-30.9, -4.0, 1.0), (-28.5, 4.0, 6.0))
    sunk = box((20.0, -1.0, -3.0), (21.0, 1.0, -1.0))
    plain = scene.parts[0]
    hidden = [type(plain)(f"hidden{i}", s.vertices_m, s.faces, None, None, (9, 9, 9), True, True)
              for i, s in enumerate((inner, sunk))]
    more = Scene("x", [*scene.parts, *hidden], scene.object_min_enu_m, scene.object_max_enu_m, 0.0)
    a, b = exposed_surface(more, 3000, seed=5), exposed_surface(more, 3000, seed=5)
    assert np.array_equal(a.points_enu_m, b.points_enu_m)
    inside = ((a.points_enu_m > (-30.95, -4.1, 0.9)) & (a.points_enu_m < (-28.4, 4.1, 6.1))).all(axis=1)
    assert not inside.any()
    assert a.points_enu_m[:, 2].min() >= 0.0


def test_object_wholly_under_ground_is_refused(scenes: dict[str, Scene]) -> None:
    scene = scenes["bridge"]
    with pytest.raises(UserError, match="ground_up_m"):
        exposed_surface(Scene("deep", scene.parts, (0, 0, 0), (1, 1, 1), 100.0), 100)


def test_unknown_structure_names_the_known_ones() -> None:
    with pytest.raises(UserError, match="bridge, building, powerline, statue"):
        load_scene(SceneSpec(name="castle"), SiteSpec())


def test_closed_solids_are_watertight_with_outward_faces() -> None:
    profile = [(0.0, 0.0), (1.0, 0.0), (1.0, 2.0), (0.0, 2.0)]
    for solid, volume in ((box((0, 0, 0), (1, 2, 3)), 6.0), (lathe(profile, (1, 1, 1), 64), 2 * np.pi),
                          (tube([(0, 0, 0), (1, 0, 1), (2, 0, 1)], 0.1, 32, capped=True), None)):
        mesh = trimesh.Trimesh(solid.vertices_m, solid.faces)
        assert mesh.is_watertight
        assert mesh.volume > 0
        if volume is not None:
            assert mesh.volume == pytest.approx(volume, rel=0.01)


def test_beam_faces_point_outwards_in_every_direction() -> None:
    square = np.array([(-0.1, -0.1), (0.1, -0.1), (0.1, 0.1), (-0.1, 0.1)])
    rng = np.random.default_rng(1)
    for end in [*rng.normal(size=(20, 3)), (0.0, 0.0, 1.0), (1.0, 0.0, 0.0)]:
        solid = beam((0.0, 0.0, 0.0), end, square)
        triangles = solid.vertices_m[solid.faces]
        normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
        assert ((normal * (triangles.mean(axis=1) - np.asarray(end) / 2)).sum(axis=1) > 0).all()


def test_cells_cover_a_rectangle_but_for_its_holes() -> None:
    holes = [(1.0, 1.0, 2.0, 3.0), (1.5, 2.0, 4.0, 2.5), (-1.0, 4.0, 0.5, 9.0)]
    found = cells((0.0, 0.0), (5.0, 5.0), holes)
    area = ((found[:, 2] - found[:, 0]).prod(axis=1)).sum()
    assert area == pytest.approx(25.0 - 2.0 - 1.0 - 0.5)


def test_implicit_surface_of_a_capsule() -> None:
    field = Field.empty((-2, -2, -3), (2, 2, 3), 0.1)
    field.add(*round_cone((0, 0, -1), (0, 0, 1), (0.8, 0.8)), 0.1)
    vertices, faces = surface(field)
    mesh = trimesh.Trimesh(vertices, faces)
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(np.pi * 0.64 * 2 + 4 / 3 * np.pi * 0.512, rel=0.02)
    t = np.clip(vertices[:, 2], -1, 1)
    gap = np.linalg.norm(vertices - np.stack([0 * t, 0 * t, t], axis=1), axis=1) - 0.8
    assert np.abs(gap).max() < 0.02
