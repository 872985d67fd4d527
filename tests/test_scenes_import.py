"""Scenes from files: export and import are inverse, faults are mended and counted, bad input is refused."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import PIL.Image
import pytest
import trimesh
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from missions.errors import UserError
from missions.mission import SiteSpec
from missions.simulation import SceneSpec
from sim_bridge.scenes.commands import main
from sim_bridge.scenes.export import export_scene
from sim_bridge.scenes.load import load_scene
from sim_bridge.scenes.scene import Part, Scene
from sim_bridge.scenes.solids import box
from sim_bridge.scenes.surroundings import GROUND, PREFIX

HERE = SiteSpec()


def assert_same(a: Scene, b: Scene) -> None:
    assert a.name == b.name
    assert a.ground_up_m == pytest.approx(b.ground_up_m, abs=1e-6)
    np.testing.assert_allclose(a.object_min_enu_m, b.object_min_enu_m, atol=1e-6)
    np.testing.assert_allclose(a.object_max_enu_m, b.object_max_enu_m, atol=1e-6)
    assert [p.name for p in a.parts] == [p.name for p in b.parts]
    for x, y in zip(a.parts, b.parts, strict=True):
        np.testing.assert_allclose(x.vertices_enu_m, y.vertices_enu_m, atol=1e-6)
        np.testing.assert_array_equal(x.faces, y.faces)
        assert (x.is_object, x.procedural, x.color_rgb) == (y.is_object, y.procedural, y.color_rgb)
        assert (x.uv is None) == (y.uv is None)
        if x.uv is not None and y.uv is not None and x.texture is not None:
            np.testing.assert_array_equal(x.uv, y.uv)
            np.testing.assert_array_equal(x.texture, y.texture)


def test_built_in_survives_export(tmp_path: Path) -> None:
    name = "statue"
    scene = load_scene(SceneSpec(name=name), HERE)
    home = export_scene(scene, tmp_path)
    assert (home / "bbox" / f"{name}_bbox_bounds.obj").is_file()
    assert str(tmp_path) not in (home / f"{name}.mtl").read_text()
    back = load_scene(SceneSpec(path=str(home)), HERE)
    assert back.notes == []
    assert_same(scene, back)


@st.composite
def parts(draw: st.DrawFn, name: str, is_object: bool) -> Part:
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    n = draw(st.integers(4, 30))
    scale = draw(st.sampled_from([1.0, 30.0, 400.0]))
    vertices = rng.uniform(-scale, scale, (n, 3)) + len(name) + ord(name[-1])
    rows = {tuple(sorted(rng.choice(n, 3, replace=False))) for _ in range(draw(st.integers(1, 40)))}
    used, index = np.unique(np.array(sorted(rows)), return_inverse=True)
    faces = index.reshape(-1, 3).astype(np.int32)
    color = tuple(int(c) for c in rng.integers(0, 256, 3))
    textured = draw(st.booleans())
    uv = rng.uniform(-9, 9, (len(used), 2)).astype(np.float32) if textured else None
    texture = rng.integers(0, 256, (draw(st.integers(1, 9)), 7, 3)).astype(np.uint8) if textured else None
    return Part(name, vertices[used], faces, uv, texture, (color[0], color[1], color[2]), is_object, not textured)


@st.composite
def scenes(draw: st.DrawFn) -> Scene:
    own = [draw(parts(f"part{i}", True)) for i in range(draw(st.integers(1, 4)))]
    vertices = np.concatenate([p.vertices_enu_m for p in own])
    lo, hi = vertices.min(axis=0), vertices.max(axis=0)
    field = box((lo[0] - 40, lo[1] - 40, lo[2] - 1), (hi[0] + 40, hi[1] + 40, lo[2] - 0.5))
    around = [Part(GROUND, field.vertices_m, field.faces, None, None, (1, 2, 3), False, True)]
    around += [draw(parts(f"{PREFIX}thing{i}", False)) for i in range(draw(st.integers(0, 2)))]
    return Scene("any-scene", [*own, *around], tuple(lo.tolist()), tuple(hi.tolist()), float(lo[2] - 0.5))


@given(scene=scenes())
@settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.too_slow])
def test_any_scene_survives_export(tmp_path_factory: pytest.TempPathFactory, scene: Scene) -> None:
    home = export_scene(scene, tmp_path_factory.mktemp("scene"))
    assert_same(scene, load_scene(SceneSpec(path=str(home)), HERE))


def write_obj(folder: Path, material: str = "", extra: str = "") -> Path:
    """A 2 x 3 x 4 m box with texture coordinates, and a material file with the given content."""
    solid = box((0, 0, 0), (2, 3, 4))
    lines = ["mtllib thing.mtl", *(f"v {x} {y} {z}" for x, y, z in solid.vertices_m),
             *(f"vt {u} {v}" for u, v in solid.uv_m), "o thing", "usemtl skin",
             *(f"f {a}/{a} {b}/{b} {c}/{c}" for a, b, c in solid.faces + 1)]
    (folder / "thing.mtl").write_text(f"newmtl skin\nKd 0.2 0.4 0.6\n{material}\n")
    path = folder / "thing.obj"
    path.write_text("\n".join(lines) + "\n" + extra)
    return path


def picture(path: Path) -> None:
    PIL.Image.fromarray(np.full((4, 4, 3), 77, np.uint8)).save(path)


def own_parts(scene: Scene) -> list[Part]:
    return [p for p in scene.parts if p.is_object]


def test_obj_gets_ground_under_it_and_surroundings(tmp_path: Path) -> None:
    picture(tmp_path / "skin.png")
    path = write_obj(tmp_path, "map_Kd skin.png")
    scene = load_scene(SceneSpec(path=str(path)), HERE)
    (part,) = own_parts(scene)
    assert part.texture is not None
    assert part.texture.shape == (4, 4, 3)
    assert scene.object_max_enu_m == (2.0, 3.0, 4.0)
    assert scene.ground_up_m == 0.0
    assert {GROUND, f"{PREFIX}crowns"} <= {p.name for p in scene.parts}
    assert scene.notes == []


def test_site_sets_box_and_ground(tmp_path: Path) -> None:
    path = write_obj(tmp_path)
    site = SiteSpec(object_min_enu_m=(-1, -1, 0.5), object_max_enu_m=(3, 4, 5), ground_up_m=-2.0)
    scene = load_scene(SceneSpec(path=str(path), surroundings=False), site)
    assert (scene.object_min_enu_m, scene.object_max_enu_m) == ((-1, -1, 0.5), (3, 4, 5))
    assert next(p for p in scene.parts if p.name == GROUND).vertices_enu_m[:, 2].max() == scene.ground_up_m == -2.0
    assert sum(len(p.faces) for p in own_parts(scene)) == 10
    assert any("2 faces outside" in note for note in scene.notes)


@pytest.mark.parametrize("reference", ["/home/somebody/tex/skin.png", r"C:\work\tex\skin.png", "../far/skin.png"])
def test_texture_on_another_disk_is_found_by_its_name(tmp_path: Path, reference: str) -> None:
    (tmp_path / "textures").mkdir()
    picture(tmp_path / "textures" / "skin.png")
    scene = load_scene(SceneSpec(path=str(write_obj(tmp_path, f"map_Kd {reference}")), surroundings=False), HERE)
    assert own_parts(scene)[0].texture is not None
    assert any("found by name" in note and "skin.png" in note for note in scene.notes)


@pytest.mark.parametrize("content", [None, b"not a picture"])
def test_missing_or_broken_texture_becomes_procedural(tmp_path: Path, content: bytes | None) -> None:
    if content is not None:
        (tmp_path / "skin.png").write_bytes(content)
    scene = load_scene(SceneSpec(path=str(write_obj(tmp_path, "map_Kd skin.png")), surroundings=False), HERE)
    (part,) = own_parts(scene)
    assert part.procedural
    assert part.color_rgb == (51, 102, 153)
    assert any("skin.png" in note for note in scene.notes)
    assert any("1 of 1 parts have no texture" in note for note in scene.notes)


def test_faulty_faces_are_dropped_and_counted(tmp_path: Path) -> None:
    extra = "v nan 0 0\nv 1 1 inf\nf 25/1 1/1 2/2\nf 26/1 1/1 2/2\nf 1/1 1/1 2/2\nf 1/1 2/2 3/3\nf 3/3 2/2 1/1\n"
    scene = load_scene(SceneSpec(path=str(write_obj(tmp_path, extra=extra)), surroundings=False), HERE)
    assert sum(len(p.faces) for p in own_parts(scene)) == 12
    assert np.isfinite(own_parts(scene)[0].vertices_enu_m).all()
    notes = " ".join(scene.notes)
    assert "2 faces with NaN" in notes
    assert "1 faces without area" in notes
    assert "2 faces that repeat" in notes


@pytest.mark.parametrize("back", ["Kd 1 1 1", "Kd 1 1 1\nmap_Kd back.png"])
def test_of_two_materials_on_one_face_the_outer_one_stays(tmp_path: Path, back: str) -> None:
    picture(tmp_path / "skin.png")
    picture(tmp_path / "back.png")
    extra = "usemtl back\nf 3/3 2/2 1/1\nf 4/4 3/3 1/1\n"
    path = write_obj(tmp_path, f"map_Kd skin.png\nnewmtl back\n{back}", extra)
    scene = load_scene(SceneSpec(path=str(path), surroundings=False), HERE)
    assert [(p.name, len(p.faces), p.procedural) for p in own_parts(scene)] == [("thing", 12, False)]
    assert scene.notes == ["dropped 2 faces that repeat another one"]


def test_transforms_and_units_of_a_glb(tmp_path: Path) -> None:
    world = trimesh.Scene()
    mesh = trimesh.creation.box((1000, 2000, 3000))
    for x in (0.0, 5000.0):
        world.add_geometry(mesh, transform=trimesh.transformations.translation_matrix((x, 0, 1500)))
    mirror = np.diag([-1.0, 1.0, 1.0, 1.0])
    mirror[:3, 3] = (10000, 0, 1500)
    world.add_geometry(mesh, transform=mirror)
    world.export(tmp_path / "three.glb")
    scene = load_scene(SceneSpec(path=str(tmp_path / "three.glb"), units_per_metre=1000.0, surroundings=False), HERE)
    np.testing.assert_allclose(scene.object_min_enu_m, (-0.5, -1, 0), atol=1e-6)
    np.testing.assert_allclose(scene.object_max_enu_m, (10.5, 1, 3), atol=1e-6)
    volumes = [trimesh.Trimesh(p.vertices_enu_m, p.faces).volume for p in own_parts(scene)]
    np.testing.assert_allclose(volumes, 6.0, rtol=1e-6)


@pytest.mark.parametrize("suffix", ["ply", "stl"])
def test_untextured_formats_are_procedural(tmp_path: Path, suffix: str) -> None:
    trimesh.creation.box((2, 3, 4)).export(tmp_path / f"box.{suffix}")
    scene = load_scene(SceneSpec(path=str(tmp_path / f"box.{suffix}"), surroundings=False), HERE)
    assert [p.procedural for p in own_parts(scene)] == [True]
    assert scene.ground_up_m == -2.0
    assert any("procedural" in note for note in scene.notes)


def test_own_surroundings_inside_a_stated_box(tmp_path: Path) -> None:
    """A thesis scene: one OBJ with terrain, and the object's box beside it."""
    home = tmp_path / "site"
    (home / "bbox").mkdir(parents=True)
    tower = trimesh.creation.box((4, 4, 10), transform=trimesh.transformations.translation_matrix((0, 0, 5.01)))
    terrain = trimesh.creation.box((200, 200, 1), transform=trimesh.transformations.translation_matrix((0, 0, -0.5)))
    trimesh.util.concatenate([tower, terrain]).export(home / "site_rgb.obj")
    bounds = trimesh.creation.box((4, 4, 10), transform=trimesh.transformations.translation_matrix((0, 0, 5.01)))
    bounds.export(home / "bbox" / "site_bbox_bounds.obj")
    scene = load_scene(SceneSpec(path=str(home), surroundings=False), HERE)
    assert sum(len(p.faces) for p in own_parts(scene)) == 12
    assert [len(p.faces) for p in scene.parts if not p.is_object] == [12]
    assert scene.ground_up_m == pytest.approx(0.01)


def test_bad_input_is_refused_in_a_sentence(tmp_path: Path) -> None:
    write_obj(tmp_path)
    (tmp_path / "bad.glb").write_bytes(b"glTF but not really")
    (tmp_path / "empty.obj").write_text("# nothing\n")
    (tmp_path / "noise.txt").write_text("x")
    trimesh.creation.box((0.003, 0.002, 0.001)).export(tmp_path / "tiny.stl")
    trimesh.creation.box((9000, 2, 1)).export(tmp_path / "huge.stl")
    flat = tmp_path / "flat"
    (flat / "bbox").mkdir(parents=True)
    write_obj(flat)
    (flat / "bbox" / "thing_bounds.obj").write_text("v 0 0 0\nv 1 0 0\nv 1 1 0\nf 1 2 3\n")
    (tmp_path / "void").mkdir()
    away = SiteSpec(object_min_enu_m=(50, 50, 50), object_max_enu_m=(60, 60, 60))
    for name, site, words in (
        ("bad.glb", HERE, "cannot be read"), ("empty.obj", HERE, "no usable triangle"),
        ("noise.txt", HERE, "cannot read .txt"), ("tiny.stl", HERE, "0.003 x 0.002 x 0.001 m.*units_per_metre"),
        ("huge.stl", HERE, "9000 x 2 x 1 m.*units_per_metre"), ("flat", HERE, "no size"), ("void", HERE, "no OBJ"),
        ("absent.obj", HERE, "no such file"), ("thing.obj", away, "object_min_enu_m"),
    ):
        with pytest.raises(UserError, match=words) as caught:
            load_scene(SceneSpec(path=str(tmp_path / name), surroundings=False), site)
        assert name in str(caught.value)
        assert "\n" not in str(caught.value)


def test_commands(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = str(write_obj(tmp_path))
    assert main(["check", path, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["size_m"] == [2, 3, 4]
    assert found["object_triangles"] == 12
    assert main(["check", path]) == 0
    assert "procedural" in capsys.readouterr().out
    assert main(["check", str(tmp_path / "none.obj")]) == 2
    assert "no such file" in capsys.readouterr().err
    assert main(["export", "castle", str(tmp_path)]) == 2
    assert "no built-in structure" in capsys.readouterr().err
    assert main(["--json"]) == 0
    rows = json.loads(capsys.readouterr().out)["scenes"]
    assert [row["name"] for row in rows] == ["bridge", "building", "powerline", "statue"]
    assert all(row["triangles"] >= 20_000 for row in rows)
