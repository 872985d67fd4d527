"""Textured model, orthophoto and surface model of a scene of which everything is known."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import open3d as o3d
import pytest
import tifffile
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import map_coordinates

from missions.camera import Camera, Pose
from missions.errors import UserError
from missions.frames import Site
from perception.depth.sky import sky_and_gaps, sky_mask
from perception.products.atlas import Textured, shelves, textured
from perception.products.best_pictures import NONE, best_pictures, candidates
from perception.products.geotiff import write_dsm, write_orthophoto
from perception.products.mesh import read_mesh, write_mesh
from perception.products.model import ModelSettings, textured_model
from perception.products.model_files import GLB, OBJ, read_model, write_model
from perception.products.picture_of_model import picture_of, seen_along
from perception.products.rasters import NO_HEIGHT, Raster, seen_from_above
from perception.products.surface import Surface
from perception.reconstruct.pictures import SurveyPicture
from perception.reconstruct.projection import projection
from perception.reconstruct.resources import in_order
from tests.reconstruct_scene import CAMERA, Rectangle, looking_at, photograph, survey, wall_and_box

pytestmark = pytest.mark.xdist_group("products")

SITE = Site(52.2205, 6.8861, 40.0)
CELL_M = 0.1


def tessellated(rectangles: list[Rectangle]) -> Surface:
    """Triangles of CELL_M that face outwards, in grey."""
    vertices, triangles = [], []
    for r in rectangles:
        n, m = (round(float(np.linalg.norm(edge)) / CELL_M) for edge in (r.a, r.b))
        outwards = r.normal if r.seed in (2, 4, 5) or (r.seed == 1 and r.normal[1] < 0) else -r.normal
        outwards = outwards if r.seed != 1 else np.array([0.0, -1.0, 0.0])
        i, j = np.meshgrid(np.arange(n + 1), np.arange(m + 1), indexing="ij")
        first = sum(len(v) for v in vertices)
        vertices.append((r.corner + (i / n)[..., None] * r.a + (j / m)[..., None] * r.b).reshape(-1, 3))
        at = (first + i[:-1, :-1] * (m + 1) + j[:-1, :-1]).ravel()
        quads = np.concatenate([np.stack([at, at + m + 1, at + m + 2], 1), np.stack([at, at + m + 2, at + 1], 1)])
        triangles.append(quads if np.dot(np.cross(r.a, r.b), outwards) > 0 else quads[:, ::-1])
    corners = np.concatenate(vertices)
    return Surface(corners, np.full(corners.shape, 128, np.uint8), np.concatenate(triangles).astype(np.int64))


@pytest.fixture(scope="session")
def pictures(tmp_path_factory: pytest.TempPathFactory) -> list[SurveyPicture]:
    return survey(tmp_path_factory.mktemp("pictures"))


@pytest.fixture(scope="session")
def model(pictures: list[SurveyPicture]) -> Textured:
    return textured_model(tessellated(wall_and_box()), pictures, ModelSettings(threads=2, spacing_m=CELL_M))[0]


def straight_ahead(model: Textured, x: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Colours and distances that rays from 10 m before the wall meet."""
    start = np.stack([x.ravel(), np.full(x.size, -10.0), z.ravel()], axis=1)
    colours, distance = seen_along(model, start, np.array([0.0, 1.0, 0.0]))
    return colours.reshape(*x.shape, 3), distance.reshape(x.shape)


def true_colours(surface: Rectangle, points: np.ndarray) -> np.ndarray:
    """(n, 3) RGB of the scene's own texture."""
    s = (points - surface.corner) @ (surface.a / np.linalg.norm(surface.a)) * 100
    r = (points - surface.corner) @ (surface.b / np.linalg.norm(surface.b)) * 100
    return np.stack([map_coordinates(surface.texture[..., k], [r, s], order=1) for k in (2, 1, 0)], axis=1)


def test_the_texture_is_that_of_the_scene(model: Textured) -> None:
    x, z = np.meshgrid(np.arange(-3.0, 3.0, 0.02), np.arange(1.2, 4.8, 0.02))
    colours, distance = straight_ahead(model, x, z)
    for surface, depth in ((wall_and_box()[0], 10.0), (wall_and_box()[1], 9.0)):
        on = np.abs(distance - depth) < 0.01
        points = np.stack([x[on], np.full(on.sum(), depth - 10.0), z[on]], axis=1)
        truth = true_colours(surface, points)
        assert on.sum() > 5000
        assert np.corrcoef(colours[on].ravel(), truth.ravel())[0, 1] > 0.9
        assert np.median(np.abs(colours[on] - truth)) < 9.0


def test_what_is_behind_the_box_is_not_painted_with_it(model: Textured, pictures: list[SurveyPicture]) -> None:
    surface = tessellated(wall_and_box())
    chosen = best_pictures(surface, candidates(surface, pictures))
    centre = surface.centres_enu_m
    hidden = (np.abs(centre[:, 1]) < 1e-6) & (np.abs(centre[:, 0]) < 0.3) & (np.abs(centre[:, 2] - 3.0) < 0.3)
    assert hidden.sum() > 20
    assert np.all(chosen[hidden] == NONE)
    assert np.all(chosen[(np.abs(centre[:, 1] + 1.0) < 1e-6)] != NONE)


def test_a_darker_picture_leaves_no_seam(pictures: list[SurveyPicture], tmp_path: Path) -> None:
    """Half of the wall is taken from a picture that was exposed for two thirds of the time."""
    surface = tessellated(wall_and_box()[:1])
    surface = surface.select(np.abs(surface.centres_enu_m[:, 0]) < 2.0)
    surface = surface.select(np.abs(surface.centres_enu_m[:, 2] - 3.0) < 1.5)
    dark = replace(pictures[4], path=tmp_path / "dark.png")
    plain = photograph(wall_and_box()[:1], looking_at((0.0, -5.0, 3.0), (0.0, 0.0, 3.0)))
    light = replace(pictures[4], path=tmp_path / "light.png")
    cv2.imwrite(str(light.path), plain)
    cv2.imwrite(str(dark.path), np.rint(plain * 0.67).astype(np.uint8))
    chosen = (surface.centres_enu_m[:, 0] > 0.0).astype(np.int32)
    made, cut = textured(surface, [light, dark], chosen, 2048)
    assert (cut.pieces, cut.unseen) == (2, 0.0)
    x, z = np.meshgrid(np.arange(-1.4, 1.4, 0.02), np.arange(2.0, 4.0, 0.02))
    colours, _ = straight_ahead(made, x, z)
    assert abs(np.log(colours[x < -0.1].mean() / colours[x > 0.1].mean())) < 0.1, "0.4 without levelling"


def test_sky_is_no_surface(tmp_path: Path) -> None:
    """A wall that the pictures show to be half as wide as the mesh has it."""
    surface = tessellated(wall_and_box()[:1])
    half = [replace_corner(wall_and_box()[0])]
    pictures = []
    for k, x in enumerate((-3.5, -2.5, -1.5, -0.5)):
        pose = looking_at((x, -5.0, 1.0), (0.0, 0.0, 3.0))
        seen = photograph(half, pose, seed=k)
        seen[np.all(np.abs(seen.astype(int) - 200) < 12, axis=2)] = (235, 190, 150)
        path = tmp_path / f"{k}.png"
        cv2.imwrite(str(path), seen)
        pictures.append(SurveyPicture(k, path, CAMERA, pose.enu_from_camera, np.array(pose.position_enu_m)))
    found = candidates(surface, pictures)
    x, z = surface.centres_enu_m[:, 0], surface.centres_enu_m[:, 2]
    seen = (np.abs(x) < 2.5) & (z > 2.5) & (z < 4.0)
    assert found.solid[seen & (x < -0.1)].all()
    assert not found.solid[seen & (x > 0.3)].any()


def replace_corner(wall: Rectangle) -> Rectangle:
    return Rectangle(wall.corner, 0.5 * wall.a, wall.b, wall.seed)


def test_sky_between_bars_is_sky_and_a_blue_wall_is_not() -> None:
    camera, pose = Camera.from_diagonal_fov(160, 120, 84.0), Pose((0.0, 0.0, 2.0), 0.0, 0.6)
    picture = np.full((120, 160, 3), (110, 160, 220), np.uint8)
    picture[50:90, 30:130] = 60
    picture[60:80, 45:75] = (110, 160, 220)
    picture[60:80, 85:115] = (90, 110, 150)
    open_sky, gaps = sky_mask(picture, camera, pose), sky_and_gaps(picture, camera, pose)
    assert open_sky[20, 80]
    assert not open_sky[70, 60]
    assert gaps[70, 60]
    assert not gaps[70, 100]
    assert np.all(gaps[open_sky])


@given(st.lists(st.tuples(st.integers(1, 60), st.integers(1, 60)), min_size=1, max_size=40))
def test_rectangles_on_shelves_overlap_nowhere(sizes: list[tuple[int, int]]) -> None:
    size = np.array(sizes)
    places = shelves(size, 128)
    if places is None:
        assert size.prod(axis=1).sum() > 128 * 128 / 4
        return
    taken = np.zeros((128, 128), int)
    for (x, y), (w, h) in zip(places, size, strict=True):
        assert x + w <= 128
        assert y + h <= 128
        taken[y:y + h, x:x + w] += 1
    assert taken.max() == 1


def test_a_texture_that_is_too_small_is_refused(pictures: list[SurveyPicture]) -> None:
    with pytest.raises(UserError, match=r"reconstruct\.texture_px 8: too small"):
        textured_model(tessellated(wall_and_box()), pictures, ModelSettings(texture_px=8))


def test_a_surface_that_no_picture_shows_has_the_clouds_colour(pictures: list[SurveyPicture]) -> None:
    surface = tessellated(wall_and_box()[:1])
    away = replace(surface, vertices_enu_m=surface.vertices_enu_m - 50.0 * np.eye(3)[1])
    made, cut = textured_model(away, pictures, ModelSettings())
    assert (cut.pieces, cut.unseen) == (0, 1.0)
    start = np.array([[0.0, -60.0, 3.0]])
    np.testing.assert_array_equal(seen_along(made, start, np.array([0.0, 1.0, 0.0]))[0], [[128, 128, 128]])


def test_threads_make_no_difference(model: Textured, pictures: list[SurveyPicture]) -> None:
    again, _ = textured_model(tessellated(wall_and_box()), pictures, ModelSettings(threads=1, spacing_m=CELL_M))
    np.testing.assert_array_equal(again.image, model.image)
    np.testing.assert_array_equal(again.corner_px, model.corner_px)


def test_work_ahead_is_bounded_and_in_order() -> None:
    asked: list[int] = []
    with ThreadPoolExecutor(2) as pool:
        made = in_order(pool, lambda i: (asked.append(i), 10 * i)[1], range(9), 3)
        assert next(made) == 0
        assert len(asked) <= 4
        assert list(made) == [10, 20, 30, 40, 50, 60, 70, 80]


@pytest.fixture(scope="session")
def written(model: Textured, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("model")
    write_model(model, folder)
    return folder


def test_obj_shows_the_same_in_open3d(model: Textured, written: Path) -> None:
    mesh = o3d.io.read_triangle_mesh(str(written / OBJ), enable_post_processing=False)
    np.testing.assert_allclose(np.asarray(mesh.vertices)[np.asarray(mesh.triangles)],
                               model.surface.corners_enu_m, atol=6e-5)
    np.testing.assert_array_equal(np.asarray(mesh.textures[-1])[::-1], model.image)
    px = np.asarray(mesh.triangle_uvs).reshape(-1, 3, 2) * model.image.shape[0]
    px[..., 1] = model.image.shape[0] - px[..., 1]
    np.testing.assert_allclose(px, model.corner_px, atol=0.1)


def test_glb_has_its_texture_within_and_y_up(model: Textured, written: Path) -> None:
    mesh = next(iter(trimesh.load_scene(written / GLB, process=False).geometry.values()))
    assert len(mesh.faces) == len(model.surface)
    np.testing.assert_allclose(mesh.bounds, [[-5.0, 0.0, 0.0], [5.0, 6.0, 1.0]], atol=1e-5)
    assert mesh.visual.material.baseColorTexture.size == model.image.shape[1::-1]


def test_model_is_read_back_as_it_looks(model: Textured, written: Path) -> None:
    again = read_model(written)
    before, after = (picture_of(m, 1.2, -0.4, 320).astype(int) for m in (model, again))
    assert before.shape == after.shape
    assert np.mean(np.abs(before - after).max(axis=2) > 3) < 0.002
    with pytest.raises(UserError, match="no textured model; run 'swarmscan reconstruct'"):
        read_model(written / "nothing")


def test_mesh_file_keeps_colours(tmp_path: Path) -> None:
    surface = tessellated(wall_and_box())
    surface = replace(surface, colours=np.random.default_rng(1).integers(0, 256, surface.colours.shape, np.uint8))
    write_mesh(surface, tmp_path / "mesh.ply")
    again = read_mesh(tmp_path / "mesh.ply")
    np.testing.assert_array_equal(again.triangles, surface.triangles)
    np.testing.assert_array_equal(again.colours, surface.colours)
    np.testing.assert_allclose(again.vertices_enu_m, surface.vertices_enu_m, atol=1e-9)


GSD_M = 0.05


def flat_roof() -> Textured:
    """A roof of 6 x 4 m, 3 m up, on ground of 12 x 8 m 1 m up; red to the East, green to the North, 5 cm a texel."""
    x, y, _ = np.eye(3)
    ground = Rectangle(np.array([-6.0, -4.0, 1.0]), 12 * x, 8 * y, 7)
    roof = Rectangle(np.array([-1.0, -1.0, 3.0]), 6 * x, 4 * y, 8)
    surface = tessellated([ground, roof])
    surface = replace(surface, triangles=surface.triangles[:, ::-1])
    corners = surface.corners_enu_m[..., :2] - [-6.0, -4.0]
    image = np.zeros((160, 240, 3), np.uint8)
    image[..., 0], image[..., 1] = np.arange(240)[None, :], np.arange(160)[::-1, None]
    px = np.stack([corners[..., 0] * 20.0, 160.0 - corners[..., 1] * 20.0], axis=-1)
    return Textured(surface, image, px.astype(np.float32))


@pytest.fixture(scope="session")
def raster() -> Raster:
    return seen_from_above(flat_roof(), projection(SITE), GSD_M)


def grid_cells(raster: Raster, places_enu_m: list[tuple[float, float]]) -> np.ndarray:
    """(n, 2) row and column of places, by PROJ alone."""
    grid = raster.projection.grid_from_enu(np.array([[*p, 0.0] for p in places_enu_m]))
    return np.column_stack([(raster.top_m - grid[:, 1]) / GSD_M, (grid[:, 0] - raster.left_m) / GSD_M]).astype(int)


def test_places_and_heights_are_those_of_the_ground(raster: Raster) -> None:
    inside = [(-5.0, -3.0), (-2.0, 3.5), (3.0, 3.6), (5.5, -3.5)]
    for row, column in grid_cells(raster, inside):
        assert raster.height_m[row, column] == pytest.approx(41.0, abs=1e-3)
    for row, column in grid_cells(raster, [(0.0, 0.0), (4.5, 2.5), (-0.9, -0.9)]):
        assert raster.height_m[row, column] == pytest.approx(43.0, abs=1e-3)
    for (east, north), (row, column) in zip(inside, grid_cells(raster, inside), strict=True):
        np.testing.assert_allclose(raster.colours[row, column, :2], [(east + 6) * 20, (north + 4) * 20], atol=2.5)
    seen = raster.colours[..., 3] == 255
    np.testing.assert_array_equal(seen, raster.height_m != NO_HEIGHT)
    assert seen.sum() * GSD_M**2 == pytest.approx(96.0 * raster.projection.scale**2, rel=0.01)


def test_tiles_leave_no_border(raster: Raster, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("perception.products.rasters.TILE_CELLS", 37)
    again = seen_from_above(flat_roof(), projection(SITE), GSD_M)
    assert np.mean(again.height_m != raster.height_m) < 1e-3, "but for rays along edges"
    assert np.mean(again.colours != raster.colours) < 1e-3


def test_geotiff_says_where_it_is(raster: Raster, tmp_path: Path) -> None:
    write_orthophoto(raster, tmp_path / "orthophoto.tif")
    write_dsm(raster, tmp_path / "dsm.tif")
    for name, values in (("orthophoto", raster.colours), ("dsm", raster.height_m)):
        with tifffile.TiffFile(tmp_path / f"{name}.tif") as file:
            page = file.pages[0]
            told = page.geotiff_tags
            np.testing.assert_array_equal(page.asarray(), values)
        assert int(told["ProjectedCSTypeGeoKey"]) == 32632
        assert int(told["GTRasterTypeGeoKey"]) == 1
        assert told["ModelPixelScale"][:2] == pytest.approx([GSD_M, GSD_M])
        assert told["ModelTiepoint"] == pytest.approx([0, 0, 0, raster.left_m, raster.top_m, 0])
    assert cv2.imread(str(tmp_path / "dsm.tif"), cv2.IMREAD_UNCHANGED).dtype == np.float32


def test_too_fine_a_grid_is_refused() -> None:
    with pytest.raises(UserError, match=r"--gsd 0\.0001: .* cells are too many; give at least 0\.0"):
        seen_from_above(flat_roof(), projection(SITE), 0.0001)
