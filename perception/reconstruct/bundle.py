"""Bundle adjustment in COLMAP, held by what the vehicle measured: position and attitude of every picture.

COLMAP knows priors of positions alone. An attitude is given to it as the positions of three arms: cameras that stand
ARM_M before, beside and below the picture's own, rigidly joined to it as in a rig. So far out the arms' positions say
much about how the picture was turned and next to nothing about where it stood.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import pycolmap

from missions.camera import Camera
from missions.frames import Array
from missions.lens import distorted, pixels
from missions.mission import CameraSpec
from perception.reconstruct.control_points import ControlPoint, Found, find, similarity
from perception.reconstruct.features import Features
from perception.reconstruct.matching import SEED, ByPair, Matches
from perception.reconstruct.optics import Optics
from perception.reconstruct.pictures import SurveyPicture

pycolmap.logging.minloglevel = 2

ARM_M = 100.0
ARMS = ARM_M * np.eye(3)
"""(3, 3) where the arms stand, camera axes."""
ARM_TARGET = ARM_M * np.ones(3)
"""All arms look at this point: COLMAP leaves out a camera that sees nothing."""
ARM_CENTRE_PX = 500.0
LAST_ROUNDS_PX = (4.0, 2.0)
"""Observations farther off than this are dropped, after a first round that allows for the noise of the poses."""
SEEN_SIGMA_PX = 0.5
"""How exactly points are seen, a few wrong ones among them. COLMAP takes it for one pixel, so priors are widened."""
LOSS_PX = 0.5
DIRECT_UP_TO = 100_000
"""Images. COLMAP solves more than 1,000 by iterations, which takes three times as long; the arms are images as well,
without poses of their own."""
ITERATIONS = 15
TOLERANCE = 1e-5
LEAST_POSITION_M = 1e-3
LEAST_ATTITUDE_RAD = 1e-4


@dataclass(frozen=True)
class Accuracy:
    """Standard deviations of the measured poses, per axis."""

    position_m: float
    attitude_rad: float

    @classmethod
    def of(cls, camera: CameraSpec) -> Accuracy:
        """What a mission file says of its survey's poses."""
        return cls(camera.position_sigma_m, math.radians(camera.attitude_sigma_deg))

    def pixels(self, camera: Camera, distance_m: float) -> float:
        """How far a point at this distance moves in the picture, one standard deviation."""
        return camera.fx_px * math.hypot(self.attitude_rad, self.position_m / distance_m)


@dataclass(frozen=True)
class Adjusted:
    """What bundle adjustment found. Observations are rows (picture, point) with the pixel that was seen."""

    enu_from_camera: Array
    """(n, 3, 3)"""
    position_enu_m: Array
    """(n, 3)"""
    points_enu_m: Array
    """(p, 3)"""
    picture_of: np.typing.NDArray[np.int64]
    """(o,)"""
    point_of: np.typing.NDArray[np.int64]
    """(o,)"""
    feature_of: np.typing.NDArray[np.int64]
    """(o,) which of the picture's features"""
    seen_px: Array
    """(o, 2)"""
    optics: Optics
    carried: pycolmap.Sim3d | None = None
    """From where the measured poses put everything to where the control points are."""
    control: tuple[Found, ...] = ()

    def error_px(self) -> Array:
        """(o,) reprojection errors."""
        away = self.points_enu_m[self.point_of] - self.position_enu_m[self.picture_of]
        local = np.einsum("oji,oj->oi", self.enu_from_camera[self.picture_of], away)
        ahead = pixels(distorted(local[:, :2] / local[:, 2:], self.optics.lens), self.optics.camera)
        return np.asarray(np.linalg.norm(ahead - self.seen_px, axis=1))


def adjust(pictures: list[SurveyPicture], seen: list[Features], matches: ByPair,
           accuracy: Accuracy, first_px: float, optics: Optics, calibrate: bool = False,
           control: list[ControlPoint] | None = None) -> Adjusted:
    """Triangulate at the measured poses, adjust, and again with tighter limits; deterministic.

    matches: by pair of pictures. first_px: limit of the first round. calibrate: focal length and distortion are found
    along with the poses; optics is where they begin. control: points that the result is carried to as a whole, and
    found in then. A picture without matches keeps its pose.
    """
    linked = sorted({i for pair in matches for i in pair})
    if not linked:
        return _result(pycolmap.Reconstruction(), pictures, linked, optics)
    database = _database(pictures, seen, matches, linked, optics.colmap(calibrate))
    cache = pycolmap.DatabaseCache.create(database, pycolmap.DatabaseCacheOptions())
    mapper, model = pycolmap.IncrementalMapper(cache), pycolmap.Reconstruction()
    model.load(cache)
    for i in linked:
        p, frame = pictures[i], model.frame(i + 1)
        frame.set_cam_from_world(1, _rigid(p.enu_from_camera.T, p.position_enu_m))
        model.register_frame(frame.frame_id)
    mapper.begin_reconstruction(model)
    for limit in (first_px, *(px for px in LAST_ROUNDS_PX if px < first_px)):
        _triangulate(mapper, model, optics.camera, limit)
        _solve(model, pictures, linked, accuracy, calibrate)
        mapper.filter_points(_mapper_options(limit))
    carried = similarity(find(control or [], model))
    if carried is not None:
        model.transform(carried)
    kept = pictures if carried is None else carried_by(carried, pictures)
    result = replace(_result(model, kept, linked, Optics.of(model.camera(1))), carried=carried,
                     control=tuple(find(control or [], model)))
    mapper.end_reconstruction(False)
    return result


def carried_by(sim: pycolmap.Sim3d, pictures: list[SurveyPicture]) -> list[SurveyPicture]:
    """The pictures where a similarity puts them."""
    rotation, matrix = sim.rotation.matrix(), sim.matrix()
    return [replace(p, enu_from_camera=rotation @ p.enu_from_camera,
                    position_enu_m=matrix[:, :3] @ p.position_enu_m + matrix[:, 3]) for p in pictures]


def _database(pictures: list[SurveyPicture], seen: list[Features], matches: ByPair,
              linked: list[int], camera: pycolmap.Camera) -> pycolmap.Database:
    """Picture i is image, frame and camera position i + 1; its arms are images of the same frame."""
    database = pycolmap.Database.open(":memory:")
    cameras = [camera, *(_arm_camera(k) for k in range(len(ARMS)))]
    rig = pycolmap.Rig(rig_id=1)
    rig.add_ref_sensor(cameras[0].sensor_id)
    for camera, arm in zip(cameras[1:], ARMS, strict=True):
        rig.add_sensor(camera.sensor_id, _rigid(_looking_at_target(arm), arm))
    for camera in cameras:
        database.write_camera(camera, use_camera_id=True)
    database.write_rig(rig, use_rig_id=True)
    for i in linked:
        images = [pycolmap.Image(name=f"{i}-{k}", camera_id=k + 1, image_id=_image_id(i, k, len(pictures)))
                  for k in range(len(cameras))]
        frame = pycolmap.Frame(frame_id=i + 1, rig_id=1)
        for image in images:
            frame.add_data_id(image.data_id)
            database.write_image(image, use_image_id=True)
        database.write_frame(frame, use_frame_id=True)
        database.write_keypoints(i + 1, np.ascontiguousarray(seen[i].points_px))
        for image in images[1:]:
            database.write_keypoints(image.image_id, np.full((1, 2), ARM_CENTRE_PX, np.float32))
        for a, b in ((1, 2), (2, 3), (1, 3)):
            _write_matches(database, images[a].image_id, images[b].image_id, np.zeros((1, 2), np.uint32))
    for (i, j), pairs in matches.items():
        _write_matches(database, i + 1, j + 1, pairs)
    return database


def _write_matches(database: pycolmap.Database, a: int, b: int, pairs: Matches) -> None:
    geometry = pycolmap.TwoViewGeometry()
    geometry.config = pycolmap.TwoViewGeometryConfiguration.CALIBRATED
    geometry.inlier_matches = pairs
    database.write_two_view_geometry(a, b, geometry)


def _image_id(picture: int, camera: int, pictures: int) -> int:
    return picture + 1 + camera * pictures


def _arm_camera(k: int) -> pycolmap.Camera:
    size = round(2.0 * ARM_CENTRE_PX)
    return pycolmap.Camera(camera_id=k + 2, model="PINHOLE", width=size, height=size, params=[ARM_CENTRE_PX] * 4)


def _looking_at_target(arm: Array) -> Array:
    """(3, 3) arm_from_camera rotation."""
    z = (ARM_TARGET - arm) / np.linalg.norm(ARM_TARGET - arm)
    x = np.cross(arm / ARM_M, z)
    return np.array([x, np.cross(z, x), z])


def _rigid(rotation: Array, centre: Array) -> pycolmap.Rigid3d:
    """The transform that turns by (3, 3) rotation about a centre (3,) that becomes the origin."""
    return pycolmap.Rigid3d(pycolmap.Rotation3d(rotation), -rotation @ centre)


def _mapper_options(limit_px: float) -> pycolmap.IncrementalMapperOptions:
    return pycolmap.IncrementalMapperOptions(filter_max_reproj_error=limit_px, num_threads=1, random_seed=SEED)


def _triangulate(mapper: pycolmap.IncrementalMapper, model: pycolmap.Reconstruction, camera: Camera,
                 limit_px: float) -> None:
    angle_deg = math.degrees(2.0 * limit_px / camera.fx_px)
    options = pycolmap.IncrementalTriangulatorOptions(
        create_max_angle_error=angle_deg, continue_max_angle_error=angle_deg, re_max_angle_error=angle_deg,
        merge_max_reproj_error=limit_px, complete_max_reproj_error=limit_px, ignore_two_view_tracks=False,
        random_seed=SEED)
    if model.num_points3D():
        mapper.retriangulate(options)
    else:
        for image_id in sorted(model.reg_image_ids()):
            mapper.triangulate_image(options, image_id)
    mapper.complete_and_merge_tracks(options)
    mapper.filter_points(_mapper_options(limit_px))


def _solve(model: pycolmap.Reconstruction, pictures: list[SurveyPicture], linked: list[int],
           accuracy: Accuracy, calibrate: bool) -> None:
    """One bundle adjustment of all poses and points, and of the camera if asked for; its principal point stays, which
    tangential distortion makes up for. One thread: more would sum in any order."""
    options = pycolmap.BundleAdjustmentOptions(
        refine_focal_length=calibrate, refine_extra_params=calibrate, refine_principal_point=False,
        refine_sensor_from_rig=False, print_summary=False)
    options.ceres.loss_function_type = pycolmap.LossFunctionType.CAUCHY
    options.ceres.loss_function_scale = LOSS_PX
    options.ceres.max_num_images_direct_sparse_cpu_solver = DIRECT_UP_TO
    solver = options.ceres.solver_options
    solver.max_num_iterations, solver.function_tolerance, solver.num_threads = ITERATIONS, TOLERANCE, 1
    config = pycolmap.BundleAdjustmentConfig()
    for image_id in sorted(model.reg_image_ids()):
        config.add_image(image_id)
    for k in range(len(ARMS)):
        config.set_constant_cam_intrinsics(_arm_camera(k).camera_id)
    prior_options = pycolmap.PosePriorBundleAdjustmentOptions()
    prior_options.alignment_ransac.random_seed = SEED
    priors = _priors(model, pictures, linked, accuracy)
    pycolmap.create_pose_prior_bundle_adjuster(options, prior_options, config, priors, model).solve()


def _priors(model: pycolmap.Reconstruction, pictures: list[SurveyPicture], linked: list[int],
            accuracy: Accuracy) -> list[pycolmap.PosePrior]:
    """Where the picture and its arms were measured to be. A turn about any axis moves two of the three arms."""
    own = max(accuracy.position_m, LEAST_POSITION_M) / SEEN_SIGMA_PX
    arm = math.sqrt(2.0) * ARM_M * max(accuracy.attitude_rad, LEAST_ATTITUDE_RAD) / SEEN_SIGMA_PX
    priors = []
    for i in linked:
        for k, offset in enumerate((np.zeros(3), *ARMS)):
            prior = pycolmap.PosePrior()
            prior.position = pictures[i].position_enu_m + pictures[i].enu_from_camera @ offset
            prior.position_covariance = np.eye(3) * (arm if k else own) ** 2
            prior.coordinate_system = pycolmap.PosePriorCoordinateSystem.CARTESIAN
            prior.corr_data_id = model.image(_image_id(i, k, len(pictures))).data_id
            priors.append(prior)
    return priors


def _result(model: pycolmap.Reconstruction, pictures: list[SurveyPicture], linked: list[int],
            optics: Optics) -> Adjusted:
    """Poses and the points that pictures see; the arms are left behind."""
    rotation = np.array([p.enu_from_camera for p in pictures])
    position = np.array([p.position_enu_m for p in pictures])
    for i in linked:
        world_from_camera = model.image(i + 1).cam_from_world().inverse()
        rotation[i], position[i] = world_from_camera.rotation.matrix(), world_from_camera.translation
    points, picture_of, point_of, feature_of, seen = [], [], [], [], []
    for _, point in sorted(model.points3D.items()):
        elements = [e for e in point.track.elements if e.image_id <= len(pictures)]
        if elements:
            points.append(point.xyz)
            for e in elements:
                picture_of.append(e.image_id - 1)
                point_of.append(len(points) - 1)
                feature_of.append(e.point2D_idx)
                seen.append(model.image(e.image_id).point2D(e.point2D_idx).xy)
    return Adjusted(rotation, position, np.array(points).reshape(-1, 3), np.array(picture_of, dtype=np.int64),
                    np.array(point_of, dtype=np.int64), np.array(feature_of, dtype=np.int64),
                    np.array(seen).reshape(-1, 2), optics)
