"""The pictures: geometry to a twentieth of a pixel, light and shadow, the same bytes every time, on both backends."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Literal

import cv2
import moderngl
import numpy as np
import pytest

from missions.camera import Camera, Pose
from missions.errors import UserError
from missions.mission import CameraSpec
from missions.simulation import RenderSpec
from sim_bridge.render import Renderer, benchmark, encode_jpeg, geometry, make_renderer
from sim_bridge.render.egl import EglRenderer, EglUnavailableError
from sim_bridge.render.light import make_light
from sim_bridge.render.raycast import RaycastRenderer
from sim_bridge.scenes.scene import Part, Scene

pytestmark = pytest.mark.xdist_group("render")

CAMERA = Camera(456, 256, 300.0, 300.0, 240.0, 121.0)
POSE = Pose((3.0, -11.0, 6.0), math.radians(105.0), math.radians(-18.0))
NOISELESS = CameraSpec(noise_dn=0.0)


def part(name: str, corners: np.ndarray, color: tuple[int, int, int], texture: np.ndarray | None = None) -> Part:
    """One quad; its corners run around it, the first at uv (0, 0)."""
    uv = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32) if texture is not None else None
    return Part(name, np.asarray(corners, float), np.array([[0, 1, 2], [0, 2, 3]], np.int32), uv, texture, color,
                name != "ground", texture is None)


def small_scene() -> Scene:
    """A textured wall of 8 x 5 m on a ground plane."""
    texture = np.full((256, 256, 3), (190, 120, 90), np.uint8)
    texture[::16, :], texture[:, ::32] = 215, 215
    wall = part("wall", np.array([[-4, 0, 0], [4, 0, 0], [4, 0, 5], [-4, 0, 5]]), (255, 255, 255), texture)
    side = 60.0
    ground = part("ground", side * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]), (110, 120, 80))
    return Scene("small", [wall, ground], (-4.0, -0.1, 0.0), (4.0, 0.1, 5.0), 0.0)


def make(backend: Literal["egl", "raycast"], scene: Scene, camera_spec: CameraSpec = NOISELESS,
         sun_azimuth_deg: float = 215.0) -> Renderer:
    spec = RenderSpec(backend=backend, sun_azimuth_deg=sun_azimuth_deg)
    try:
        return make_renderer(scene, spec, camera_spec, seed=3)
    except UserError as e:
        pytest.skip(f"no EGL on this machine: {e}")


def egl_works() -> bool:
    try:
        make_renderer(small_scene(), RenderSpec(backend="egl"), NOISELESS, seed=3).close()
    except UserError:
        return False
    return True


def digest(backend: Literal["egl", "raycast"]) -> str:
    """SHA-256 of a noisy picture with an obstacle in it; also called in a process of its own."""
    renderer = make(backend, small_scene(), CameraSpec(noise_dn=1.5))
    rgb = renderer.render(CAMERA, POSE, [((1.0, -3.0, 1.0), (1.0, 1.0, 2.0))], noise_key=77)
    renderer.close()
    return hashlib.sha256(rgb.tobytes()).hexdigest()


@pytest.fixture(scope="module", params=["egl", "raycast"])
def renderer(request: pytest.FixtureRequest) -> Iterator[Renderer]:
    made = make(request.param, small_scene())
    yield made
    made.close()


def marker_scene(camera: Camera, pixels: np.ndarray, depths_m: np.ndarray) -> tuple[Scene, np.ndarray]:
    """Red quads parallel to the picture plane in front of a black one; also their centres, ENU.

    They are turned by 17 degrees, so that their edges cut through the sampling grid at many places.
    """
    r = POSE.enu_from_camera
    slopes = (pixels - [camera.cx_px, camera.cy_px]) / [camera.fx_px, camera.fy_px]
    rays = np.column_stack([slopes, np.ones(len(pixels))])
    centers = np.array(POSE.position_enu_m) + (rays * depths_m[:, None]) @ r.T
    quad = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    turn = cv2.Rodrigues(np.array([0.0, 0.0, 0.3]))[0]
    halves = 10.0 * depths_m / camera.fx_px
    parts = [part(f"m{i}", c + (half * quad) @ turn.T @ r.T, (255, 0, 0))
             for i, (c, half) in enumerate(zip(centers, halves, strict=True))]
    behind = np.array(POSE.position_enu_m) + (np.array([0, 0, 200]) + 900 * quad) @ r.T
    parts.append(part("ground", behind, (0, 0, 0)))
    return Scene("markers", parts, (-5.0, -5.0, 0.0), (5.0, 5.0, 5.0), 0.0), centers


@pytest.mark.parametrize(("backend", "camera"), [
    ("egl", CAMERA), ("egl", Camera(1920, 1080, 1223.0, 1223.0, 1001.3, 530.7)), ("raycast", CAMERA)])
def test_known_points_appear_where_the_camera_model_says(
        backend: Literal["egl", "raycast"], camera: Camera, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without grain, and with the sun behind the markers, the centroid of their colour is their centre."""
    monkeypatch.setattr(geometry, "GRAIN_PROCEDURAL", 0.0)
    rng = np.random.default_rng(5)
    grid = np.stack(np.meshgrid(np.linspace(0.1, 0.9, 6), np.linspace(0.12, 0.88, 4)), axis=-1).reshape(-1, 2)
    pixels = grid * [camera.width_px, camera.height_px] + rng.uniform(-2, 2, grid.shape)
    scene, centers = marker_scene(camera, pixels, rng.uniform(1.5, 120.0, len(pixels)))
    renderer = make(backend, scene, sun_azimuth_deg=15.0)
    red = renderer.render(camera, POSE, [], 0)[..., 0].astype(float)
    renderer.close()
    seen = camera.matrix @ (POSE.camera_from_enu @ np.column_stack([centers, np.ones(len(centers))]).T)[:3]
    expected = (seen[:2] / seen[2]).T
    errors_px = np.array([centroid(red, u, v) - [u, v] for u, v in expected])
    assert np.abs(errors_px.mean(axis=0)).max() < 0.02
    assert np.linalg.norm(errors_px, axis=1).max() < 0.05


def centroid(red: np.ndarray, u: float, v: float) -> np.ndarray:
    """Centroid, in pixels, of the colour around a pixel position."""
    rows, columns = slice(int(v) - 15, int(v) + 16), slice(int(u) - 15, int(u) + 16)
    window = red[rows, columns]
    x, y = np.arange(columns.start, columns.stop) + 0.5, np.arange(rows.start, rows.stop) + 0.5
    return np.array([window.sum(axis=0) @ x, window.sum(axis=1) @ y]) / window.sum()


def test_another_process_makes_the_same_bytes() -> None:
    backends = ["raycast", "egl"] if egl_works() else ["raycast"]
    code = f"from tests.test_render import digest; print(*[digest(b) for b in {backends!r}])"
    there = subprocess.run([sys.executable, "-c", code], cwd=Path(__file__).parents[1], capture_output=True, text=True,
                           check=True)
    assert there.stdout.split() == [digest(backend) for backend in backends]


def test_obstacles_come_and_go_without_a_trace(renderer: Renderer) -> None:
    box = ((1.5, -3.0, 2.5), (1.0, 1.0, 1.0))
    before = renderer.render(CAMERA, POSE, [], 1)
    during = renderer.render(CAMERA, POSE, [box], 1)
    after = renderer.render(CAMERA, POSE, [], 1)
    assert np.array_equal(before, after)
    changed = np.any(before != during, axis=-1)
    center = CAMERA.matrix @ (POSE.camera_from_enu @ [*box[0], 1.0])[:3]
    u, v = (center[:2] / center[2]).astype(int)
    assert changed[v - 5:v + 5, u - 5:u + 5].mean() > 0.95
    red, green, blue = during[changed].T.astype(int)
    assert np.mean((red > 1.8 * green) & (red > 1.8 * blue)) > 0.1


def test_shadow_lies_where_the_sun_is_hidden(renderer: Renderer) -> None:
    """Sun at azimuth 215: the wall's shadow falls on the ground north of it, and none south of it."""
    above = Pose((0.0, 0.0, 30.0), math.radians(90.0), math.radians(-90.0))
    gray = renderer.render(CAMERA, above, [], 0).mean(axis=-1)
    at = {name: CAMERA.matrix @ (above.camera_from_enu @ [*point, 1.0])[:3]
          for name, point in (("north", (1.0, 2.0, 0.0)), ("south", (1.0, -2.0, 0.0)))}
    level = {}
    for name, (x, y, z) in at.items():
        level[name] = gray[int(y / z) - 3:int(y / z) + 4, int(x / z) - 3:int(x / z) + 4].mean()
    assert level["north"] < 0.75 * level["south"]


def test_lit_ground_has_no_shadow_speckles(renderer: Renderer) -> None:
    """Grazing view of plain ground: dark outliers would be shadow-map acne."""
    away = Pose((0.0, -8.0, 1.5), math.radians(-90.0), math.radians(-12.0))
    ground = renderer.render(CAMERA, away, [], 0).mean(axis=-1)[150:]
    assert ground.min() > 0.4 * np.median(ground)


def test_sky_is_at_infinity_and_not_uniform(renderer: Renderer) -> None:
    up = Pose((0.0, 0.0, 10.0), 0.3, math.radians(50.0))
    moved = Pose((40.0, -9.0, 70.0), 0.3, math.radians(50.0))
    sky = renderer.render(CAMERA, up, [], 0)
    assert np.array_equal(sky, renderer.render(CAMERA, moved, [], 0))
    assert sky.std(axis=(0, 1)).max() > 4


def pond() -> Scene:
    """Water as far as one sees, at height 0."""
    side = 300.0 * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    water = dataclasses.replace(part("water", side, (60, 80, 70)), water=True)
    return Scene("pond", [water], (-4.0, -4.0, -1.0), (4.0, 4.0, 5.0), 0.0)


@pytest.mark.parametrize("backend", ["egl", "raycast"])
def test_waves_of_two_pictures_have_nothing_in_common(backend: Literal["egl", "raycast"]) -> None:
    low = Pose((0.0, 0.0, 3.0), 0.5, math.radians(-25.0))
    renderer = make(backend, pond())
    first, again, other = (renderer.render(CAMERA, low, [], key).astype(float)[60:].mean(axis=-1) for key in (1, 1, 2))
    renderer.close()
    assert np.array_equal(first, again)
    fine, fine_other = (gray - cv2.blur(gray, (15, 15)) for gray in (first, other))
    assert fine.std() > 1.0
    assert abs(np.corrcoef(fine.ravel(), fine_other.ravel())[0, 1]) < 0.1


def test_water_mirrors_the_sky_the_more_the_flatter_it_is_looked_at() -> None:
    sky = {}
    for backend in ("egl", "raycast"):
        renderer = make(backend, pond())
        level = Pose((0.0, 0.0, 3.0), 0.5, 0.0)
        rgb = renderer.render(CAMERA, level, [], 0).astype(float)
        renderer.close()
        sky[backend] = rgb[130:].mean(axis=1)
        above, far, near = (rgb[rows].mean(axis=(0, 1)) for rows in (slice(90, 100), slice(130, 140), slice(246, 256)))
        assert np.abs(far - above).max() < np.abs(near - above).max() / 2
    assert np.abs(sky["egl"] - sky["raycast"]).mean() < 4.0


def test_renderers_side_by_side_do_not_disturb_each_other() -> None:
    box = ((1.5, -3.0, 2.5), (1.0, 1.0, 1.0))
    first = make("egl", small_scene())
    alone = first.render(CAMERA, POSE, [box], 0)
    second = make("egl", marker_scene(CAMERA, np.array([[200.0, 100.0]]), np.array([9.0]))[0])
    second.render(CAMERA, POSE, [box], 0)
    assert np.array_equal(first.render(CAMERA, POSE, [box], 0), alone)
    second.close()
    assert np.array_equal(first.render(CAMERA, POSE, [box], 0), alone)
    first.close()


def test_both_backends_see_the_same() -> None:
    pictures = []
    for backend in ("egl", "raycast"):
        renderer = make(backend, small_scene())
        pictures.append(renderer.render(CAMERA, POSE, [((1.0, -3.0, 1.0), (1.0, 1.0, 2.0))], 0).astype(int))
        renderer.close()
    difference = np.abs(pictures[0] - pictures[1])
    assert difference.mean() < 3.0
    assert np.mean(difference.max(axis=-1) > 25) < 0.02


@pytest.mark.parametrize("backend", ["egl", "raycast"])
def test_texture_stands_upright_and_winding_does_not_matter(backend: Literal["egl", "raycast"]) -> None:
    texture = np.zeros((64, 64, 3), np.uint8)
    texture[:32, :, 0], texture[32:, :, 2] = 220, 220
    corners = np.array([[-4, 0, 0], [4, 0, 0], [4, 0, 5], [-4, 0, 5]])
    front = part("wall", corners, (255, 255, 255), texture)
    back = dataclasses.replace(front, faces=front.faces[:, ::-1].copy())
    box = (-4.0, -0.1, 0.0), (4.0, 0.1, 5.0), 0.0
    pictures = []
    for wall in (front, back):
        renderer = make(backend, Scene("flag", [wall], *box))
        pictures.append(renderer.render(CAMERA, Pose((0.0, -6.0, 2.5), math.pi / 2, 0.0), [], 0).astype(int))
        renderer.close()
    upper, lower = pictures[0][60, 200], pictures[0][180, 200]
    assert upper[0] > 3 * upper[2]
    assert lower[2] > 3 * lower[0]
    assert np.abs(pictures[0] - pictures[1]).max() <= 1


def test_a_centimetre_in_front_hides_what_is_behind(monkeypatch: pytest.MonkeyPatch) -> None:
    """At 40 m, where cables hang; a coarse depth buffer would let the wall behind flicker through."""
    monkeypatch.setattr(geometry, "GRAIN_PROCEDURAL", 0.0)
    corners = np.array([[-30, 0, -20], [30, 0, -20], [30, 0, 20], [-30, 0, 20]], float)
    walls = [part("front", corners - [0, 0.01, 0], (0, 200, 0)), part("back", corners, (200, 0, 0))]
    renderer = make("egl", Scene("sheets", walls, (-30.0, -1.0, -20.0), (30.0, 1.0, 20.0), -20.0))
    rgb = renderer.render(CAMERA, Pose((0.0, -40.0, 0.0), math.radians(80.0), 0.1), [], 0)[80:180, 150:300]
    renderer.close()
    assert rgb[..., 0].max() == 0


def test_sensor_noise_has_the_size_asked_for_and_depends_on_the_picture() -> None:
    scene, sigma = small_scene(), 2.0
    clean = make("raycast", scene).render(CAMERA, POSE, [], 0).astype(int)
    noisy = make("raycast", scene, CameraSpec(noise_dn=sigma))
    first, second = (noisy.render(CAMERA, POSE, [], key).astype(int) for key in (1, 2))
    unclipped = (clean > 10) & (clean < 245)
    assert np.std((first - clean)[unclipped]) == pytest.approx(math.hypot(sigma, math.sqrt(1 / 12)), rel=0.03)
    assert abs(np.mean((first - clean)[unclipped])) < 0.05
    correlation = np.corrcoef((first - clean)[unclipped], (second - clean)[unclipped])[0, 1]
    assert abs(correlation) < 0.02


def test_jpeg_keeps_colours_and_detail(renderer: Renderer) -> None:
    rgb = renderer.render(CAMERA, POSE, [], 0)
    decoded = cv2.imdecode(np.frombuffer(encode_jpeg(rgb, 95), np.uint8), cv2.IMREAD_COLOR_RGB)
    assert cv2.PSNR(rgb, decoded) > 34


def test_without_egl_pictures_are_ray_cast_unless_egl_is_demanded(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*args: object, **kwargs: object) -> None:
        raise RuntimeError("eglGetDisplay failed")

    monkeypatch.setattr(moderngl, "create_context", refuse)
    with pytest.raises(EglUnavailableError, match="eglGetDisplay"):
        EglRenderer(small_scene(), make_light(RenderSpec(), 1), NOISELESS, 1)
    assert isinstance(make_renderer(small_scene(), RenderSpec(), NOISELESS, 1), RaycastRenderer)
    with pytest.raises(UserError, match=r"render\.backend"):
        make_renderer(small_scene(), RenderSpec(backend="egl"), NOISELESS, 1)


def test_textures_are_halved_until_they_fit(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(geometry, "MAX_TEXTURE_PX", 64)
    monkeypatch.setattr(geometry, "TEXTURE_BUDGET_TEXELS", 3 * 32 * 32)
    large = [np.full((128, 64, 3), i, np.uint8) for i in range(4)]
    small = np.full((8, 4, 3), 9, np.uint8)
    limited = geometry.limit_textures([*large, small, large[0]])
    assert sum(t.shape[0] * t.shape[1] for t in limited.values()) <= 3 * 32 * 32
    assert all(limited[id(t)].shape[:2] == (32, 16) for t in large)
    assert limited[id(small)] is small


def test_parts_with_one_picture_are_drawn_together() -> None:
    a, b = np.zeros((4, 4, 3), np.uint8), np.ones((4, 4, 3), np.uint8)
    quad = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    parts = [part("p", quad + np.array([i, 0, 0]), (1, 2, 3), t) for i, t in enumerate((a, None, b, a, None))]
    flat = geometry.geometry_of(parts)
    assert [batch.face_count for batch in flat.batches] == [4, 4, 2]
    assert [batch.texture is not None and int(batch.texture[0, 0, 0]) for batch in flat.batches] == [False, 0, 1]
    assert sorted(flat.positions_enu_m[flat.faces[4:8, 0], 0].tolist()) == [0.0, 0.0, 3.0, 3.0]


def test_benchmark_reports_every_size_beside_the_thesis(
        monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    bridge = dataclasses.replace(small_scene(), name="bridge")
    monkeypatch.setattr(benchmark, "SIZES", ((456, 256), (1920, 1080)))
    monkeypatch.setattr(benchmark, "load_scene", lambda spec, site: bridge)
    assert benchmark.main(["--scenes", "bridge", "--frames", "1", "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)["rows"]
    assert [row["width_px"] for row in rows] == [456, 1920]
    assert [row["thesis_seconds"] for row in rows] == [None, pytest.approx(0.894, rel=1e-3)]
    assert all(row["seconds_median"] >= row["seconds_best"] > 0 and row["jpeg_kib"] > 5 for row in rows)
