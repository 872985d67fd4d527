"""The last bundle adjustment of a model: all pictures, and as much of each camera as its pictures tell."""

from __future__ import annotations

import copy
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import pycolmap

FULL_MODEL_FROM = 10
"""A camera with as many pictures gets tangential and a second radial term of distortion, focal length and axis."""
NEAR_TOLD = 0.08
"""A focal length that differs less from what EXIF tells is believed: there it is rounded to millimetres."""
MUCH_BETTER = 0.7
"""So is another one that leaves less than this share of the loss: EXIF may be of another lens."""
LEAST_GAIN = 0.003
"""Of the loss, for an axis beside the middle to be believed."""
FARTHEST_SHARE = 0.04
"""Of the picture's longer side: farther from the middle no camera has it."""

Model = pycolmap.Reconstruction


@dataclass(frozen=True)
class Freedom:
    """What of a camera is found, beside its distortion."""

    focal: bool
    axis: bool


def refined(model: Model, told_focal_px: Mapping[int, float], held: Sequence[int] = ()) -> Model:
    """The model after bundle adjustment, with Brown's full model for cameras that have enough pictures. It may be
    another one than was given.

    told_focal_px: by camera, where photographs tell it. held: ids of points that stay, and with them where the model
    lies. Seen straight from above, a flat site tells neither focal length nor axis: one trades off with heights, the
    other with tangential distortion. Each is freed in turn, and what that gives is taken where it is likely.
    """
    for camera in model.cameras.values():
        if camera.model_name == "SIMPLE_RADIAL":
            f, cx, cy, k = camera.params
            camera.model = pycolmap.CameraModelId.OPENCV
            camera.params = [f, f, cx, cy, k, 0.0, 0.0, 0.0]
    found, loss, focal = _with_focal(model, told_focal_px, held)
    tried = copy.deepcopy(found)
    gained = _adjust(tried, held, Freedom(focal, axis=True)) < (1.0 - LEAST_GAIN) * loss
    if gained and all(_credible(camera) for camera in tried.cameras.values()):
        found = tried
    found.update_point_3d_errors()
    return found


def _with_focal(model: Model, told_focal_px: Mapping[int, float], held: Sequence[int]) -> tuple[Model, float, bool]:
    """With the focal lengths of the pictures, where the model did not grow with those of EXIF or where they stay near
    or explain much more; the model, its loss, and whether it is these."""
    free = copy.deepcopy(model)
    loss = _adjust(free, held, Freedom(focal=True, axis=False))
    if _near(free, told_focal_px) or not _near(model, told_focal_px):
        return free, loss, True
    loss_told = _adjust(model, held, Freedom(focal=False, axis=False))
    if loss < MUCH_BETTER * loss_told:
        return free, loss, True
    return model, loss_told, False


def _near(model: Model, told_focal_px: Mapping[int, float]) -> bool:
    return all(abs(model.camera(camera_id).mean_focal_length() / told - 1.0) < NEAR_TOLD
               for camera_id, told in told_focal_px.items() if model.exists_camera(camera_id))


def _adjust(model: Model, held: Sequence[int], freedom: Freedom) -> float:
    """Returns the loss that remains."""
    count = Counter(model.image(image_id).camera_id for image_id in model.reg_image_ids())
    options = pycolmap.BundleAdjustmentOptions(print_summary=False, refine_focal_length=freedom.focal,
                                               refine_principal_point=freedom.axis)
    options.ceres.loss_function_type = pycolmap.LossFunctionType.CAUCHY
    options.ceres.solver_options.max_num_iterations = 60
    config = pycolmap.BundleAdjustmentConfig()
    for image_id in sorted(model.reg_image_ids()):
        config.add_image(image_id)
    for camera_id in model.cameras:
        if count[camera_id] < FULL_MODEL_FROM:
            config.set_constant_cam_intrinsics(camera_id)
    for point_id in held:
        config.add_constant_point(point_id)
    if not held:
        config.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
    solved: Any = pycolmap.create_default_bundle_adjuster(options, config, model).solve()
    return float(solved.ceres_summary.final_cost)


def _credible(camera: pycolmap.Camera) -> bool:
    farthest = FARTHEST_SHARE * max(camera.width, camera.height)
    return (abs(camera.principal_point_x - camera.width / 2.0) < farthest
            and abs(camera.principal_point_y - camera.height / 2.0) < farthest)
