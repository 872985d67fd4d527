"""What a model tells of its cameras, and what pictures tell of themselves against look-alike structures."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pycolmap
import pytest
from scipy.spatial.transform import Rotation

from missions.frames import enu_from_camera
from perception.photographs.adjust import FULL_MODEL_FROM, NEAR_TOLD, refined
from perception.photographs.contradictions import strike_out
from perception.photographs.folds import doubtful_pairs, leave_out_folded
from perception.photographs.georeference import Placement
from perception.photographs.placed import leave_out_misplaced

SIZE, FOCAL, OFF, RADIAL = (1024, 768), 900.0, (9.0, -14.0), -0.05


def synthetic(pictures: int, off: tuple[float, float]) -> pycolmap.Reconstruction:
    """Pictures from all around with half a pixel of noise; their camera is off from the truth, its axis in the middle.
    """
    pycolmap.set_random_seed(1)
    width, height = SIZE
    options = pycolmap.SyntheticDatasetOptions(
        num_rigs=1, num_frames_per_rig=pictures, num_points3D=200, camera_width=width, camera_height=height,
        camera_params=[FOCAL, width / 2 + off[0], height / 2 + off[1], RADIAL])
    model = pycolmap.synthesize_dataset(options)
    pycolmap.synthesize_noise(pycolmap.SyntheticNoiseOptions(point2D_stddev=0.5), model)
    for camera in model.cameras.values():
        camera.params = [1.01 * FOCAL, width / 2, height / 2, 0.0]
    return model


@pytest.mark.parametrize("off", [OFF, (0.0, 0.0)])
def test_the_axis_is_found_where_pictures_tell_it(off: tuple[float, float]) -> None:
    (camera,) = refined(synthetic(2 * FULL_MODEL_FROM, off), {}).cameras.values()
    assert camera.mean_focal_length() == pytest.approx(FOCAL, abs=1.0)
    found = np.array([camera.principal_point_x, camera.principal_point_y]) - np.array(SIZE) / 2
    np.testing.assert_allclose(found, off, atol=3.0 if any(off) else 0.0)


def test_exif_is_believed_where_pictures_hardly_tell_the_focal_length() -> None:
    """Seen from one height, straight down, a flat site fits any focal length."""
    (told,), (alone,) = (refined(flat(), told).cameras.values() for told in ({1: FOCAL}, {}))
    assert told.mean_focal_length() == pytest.approx(FOCAL)
    assert alone.mean_focal_length() != pytest.approx(FOCAL, rel=NEAR_TOLD)


def test_pictures_are_believed_where_exif_is_of_another_lens() -> None:
    model = synthetic(2 * FULL_MODEL_FROM, (0.0, 0.0))
    for camera in model.cameras.values():
        camera.params = [1.2 * FOCAL, *camera.params[1:]]
    (found,) = refined(model, {1: 1.2 * FOCAL}).cameras.values()
    assert found.mean_focal_length() == pytest.approx(FOCAL, abs=1.0)


def flat() -> pycolmap.Reconstruction:
    """Eighteen pictures nearly straight down on a plane, as if EXIF told a focal length two fifths too long, so that
    they stand two fifths too high: their angles hardly say so."""
    rng = np.random.default_rng(1)
    true, height, half = FOCAL / 1.4, 30.0 / 1.4, np.array(SIZE) / 2
    points = np.column_stack([rng.uniform(-25, 25, (300, 2)), np.zeros(300)])
    model = pycolmap.Reconstruction()
    model.add_camera_with_trivial_rig(pycolmap.Camera.create_from_model_name(1, "SIMPLE_RADIAL", FOCAL, *SIZE))
    tracks = [pycolmap.Track() for _ in points]
    for k in range(18):
        centre = np.array([k % 6 * 6.0 - 15.0, k // 6 * 6.0 - 6.0, height])
        tilted = Rotation.from_rotvec(np.radians(rng.normal(0.0, 0.3, 3))).as_matrix() @ np.diag([1.0, -1.0, -1.0])
        local = (points - centre) @ tilted.T
        seen = true * local[:, :2] / local[:, 2:] + half + rng.normal(0.0, 0.3, (300, 2))
        inside = np.flatnonzero(np.all((seen > 0) & (seen < SIZE), axis=1))
        image = pycolmap.Image(name=str(k), camera_id=1, image_id=k + 1,
                               points2D=[pycolmap.Point2D(seen[i]) for i in inside])
        low = np.array([*centre[:2], 30.0])
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(pycolmap.Rotation3d(tilted), -tilted @ low))
        for at, i in enumerate(inside):
            tracks[i].add_element(k + 1, at)
    for point, track in zip(points, tracks, strict=True):
        if track.length() > 1:
            model.add_point3D(point, track)
    return model


def test_few_pictures_leave_the_camera_as_it_is() -> None:
    (camera,) = refined(synthetic(FULL_MODEL_FROM - 1, OFF), {}).cameras.values()
    assert camera.params[:4].tolist() == [1.01 * FOCAL, 1.01 * FOCAL, SIZE[0] / 2, SIZE[1] / 2]


def around(path: Path, wrong: int) -> list[np.ndarray]:
    """A database of twelve pictures in a ring, each verified with the next three; as many of the pairs as are wrong say
    that the pictures look the same way. Returns their attitudes."""
    attitudes = [enu_from_camera(2.0 * np.pi * k / 12, -0.3) for k in range(12)]
    pairs = [(i, (i + step) % 12) for i in range(12) for step in (1, 2, 3)]
    with pycolmap.Database.open(path) as database:
        camera = pycolmap.Camera.create_from_model_name(1, "SIMPLE_PINHOLE", FOCAL, *SIZE)
        database.write_camera(camera, use_camera_id=True)
        rig = pycolmap.Rig(rig_id=1)
        rig.add_ref_sensor(camera.sensor_id)
        database.write_rig(rig, use_rig_id=True)
        for k in range(12):
            database.write_image(pycolmap.Image(name=str(k), camera_id=1, image_id=k + 1), use_image_id=True)
        for n, (i, j) in enumerate(pairs):
            turn = np.eye(3) if n < wrong else attitudes[j].T @ attitudes[i]
            geometry = pycolmap.TwoViewGeometry()
            geometry.config = pycolmap.TwoViewGeometryConfiguration.CALIBRATED
            geometry.cam2_from_cam1 = pycolmap.Rigid3d(pycolmap.Rotation3d(turn), [1.0, 0.0, 0.0])
            geometry.inlier_matches = np.zeros((40, 2), np.uint32)
            database.write_two_view_geometry(i + 1, j + 1, geometry)
    return attitudes


@pytest.mark.parametrize(("wrong", "known", "struck"), [(6, 12, 6), (0, 12, 0), (24, 12, 0), (6, 0, 0)])
def test_pairs_that_contradict_attitudes_are_struck_out(wrong: int, known: int, struck: int, tmp_path: Path) -> None:
    """Unless attitudes contradict so many that they are not believed."""
    attitudes = around(tmp_path / "a.db", wrong)
    assert strike_out(tmp_path / "a.db", [a if k < known else None for k, a in enumerate(attitudes)]) == struck
    with pycolmap.Database.open(tmp_path / "a.db") as database:
        assert database.num_verified_image_pairs() == 36 - struck


def test_a_picture_that_hangs_by_few_points_where_gps_contradicts_is_left_out() -> None:
    model = synthetic(10, (0.0, 0.0))
    image = model.image(4)
    for k, point in enumerate(image.points2D):
        if point.has_point3D() and k % 5:
            model.delete_observation(4, k)
    assert leave_out_misplaced(model, Placement(pycolmap.Sim3d(), "GPS", 8, (2, 3))) == [3]
    assert model.num_reg_images() == 9
    assert leave_out_misplaced(model, Placement(pycolmap.Sim3d(), "GPS", 5, (0, 1, 2))) == []


def strip(seen: list[range]) -> pycolmap.Reconstruction:
    """Pictures straight down from 30 m, half a metre apart, which see those of 400 points below them."""
    points = np.column_stack([np.random.default_rng(1).uniform(-8, 8, (400, 2)), np.zeros(400)])
    model, tracks = pycolmap.Reconstruction(), [pycolmap.Track() for _ in points]
    model.add_camera_with_trivial_rig(pycolmap.Camera.create_from_model_name(1, "SIMPLE_RADIAL", FOCAL, *SIZE))
    down = np.diag([1.0, -1.0, -1.0])
    for k, which in enumerate(seen):
        image = pycolmap.Image(name=str(k), camera_id=1, image_id=k + 1,
                               points2D=[pycolmap.Point2D(np.zeros(2)) for _ in which])
        centre = np.array([0.5 * k, 0.0, 30.0])
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(pycolmap.Rotation3d(down), -down @ centre))
        for at, i in enumerate(which):
            tracks[i].add_element(k + 1, at)
    for point, track in zip(points, tracks, strict=True):
        model.add_point3D(point, track)
    return model


def test_a_picture_that_shares_little_with_its_neighbours_is_left_out() -> None:
    """It is of the other side, which looks the same."""
    model = strip([range(250), range(20, 260), range(230, 400), range(10, 240), range(230)])
    assert doubtful_pairs(model) == [(0, 2), (1, 2), (2, 3), (2, 4)]
    assert leave_out_folded(model) == [2]
    assert doubtful_pairs(model) == []


def test_sides_that_are_folded_onto_each_other_stay_and_are_told() -> None:
    model = strip([range(210), range(200), range(190, 400), range(200, 400)])
    assert leave_out_folded(model) == []
    assert doubtful_pairs(model) == [(0, 2), (0, 3), (1, 2), (1, 3)]
