"""COLMAP's mapping of matched photographs: from features and matches to models, in coordinates of their own."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
import pycolmap

from perception.photographs.adjust import FULL_MODEL_FROM, refined
from perception.photographs.confirmed import leave_out_unconfirmed
from perception.photographs.contradictions import strike_out
from perception.photographs.known_lens import KnownLens, judge_again
from perception.photographs.photograph import Photograph, camera_groups
from perception.reconstruct.features import Features
from perception.reconstruct.matching import MIN_MATCHES, SEED, Matches

LEAST_MODEL = 3
ENOUGH = 0.6
"""Where no model has as many of the pictures, mapping is tried the other way too."""
GOOD_PX = 0.9
"""So it is where points lie farther from where they are seen: EXIF may be wrong by a factor."""
GUESSED_FOCAL_SHARE = 0.85
"""Of the longer side, where nothing is known: most drones and phones lie near it."""

SURE_NEAR, LEAST_SURE = 4.0, 12
"""Where the lens is known, a picture is placed by points that are near by so many times what pairs allow (COLMAP: by
30 points within 12 px)."""

Tell = Callable[[str, int, int], None]
Model = pycolmap.Reconstruction
OfPair = Mapping[tuple[int, int], Matches]


def map_matched(photographs: Sequence[Photograph], seen: Sequence[Features], matches: OfPair, folder: Path, mapper: str,
                threads: int, tell: Tell) -> None:
    """Writes folder/model-000, model-001, ..., the largest first; image i + 1 is photograph i."""
    for old in [*folder.glob("model-*"), folder / "mapping"]:
        shutil.rmtree(old, ignore_errors=True)
    database, pairs = folder / "database.db", folder / "pairs.txt"
    database.unlink(missing_ok=True)
    _write_database(database, photographs, seen, matches)
    pairs.write_text("".join(f"{_image_name(i)} {_image_name(j)}\n" for i, j in matches), encoding="ascii")
    if not matches:
        return
    tell("verify", 0, 1)
    options = pycolmap.TwoViewGeometryOptions(min_num_inliers=MIN_MATCHES, compute_relative_pose=True)
    options.ransac.random_seed = SEED
    pycolmap.verify_matches(database, pairs, options)
    strike_out(database, [p.enu_from_stored for p in photographs])
    tell("verify", 1, 1)
    told = told_focal_px(photographs)
    found = _mapped_either_way(database, folder / "mapping", len(photographs), mapper, bool(told), threads, tell)
    models = [refined(model, told) for model in _with_own_pictures(found)]
    models = _mapped_through_known_lens(database, folder / "mapping", photographs, models, mapper, threads, tell)
    for k, model in enumerate(models):
        path = folder / f"model-{k:03d}"
        path.mkdir()
        model.write(path)
    shutil.rmtree(folder / "mapping", ignore_errors=True)


def _mapped_through_known_lens(database: Path, out: Path, photographs: Sequence[Photograph], models: list[Model],
                               mapper: str, threads: int, tell: Tell) -> list[Model]:
    """Models of the pairs that are left when they are judged through the lens that the largest model tells; the same
    models where it tells none."""
    lens = KnownLens.of(models[0], FULL_MODEL_FROM) if models else None
    if lens is None or not judge_again(database, lens, threads):
        return models
    strike_out(database, [p.enu_from_stored for p in photographs])
    told = told_focal_px(photographs)
    held = len({*lens.cameras, *told}) == len(camera_groups(photographs))
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir()
    found = _mapped(database, out, len(photographs), mapper, held, threads, tell, lens)
    if _largest(found)[0] < len(photographs) and len(lens.cameras) == len(camera_groups(photographs)):
        found = max(found, _joined(database, out, len(photographs), held, threads, tell, lens),
                    key=lambda models: _largest(models)[0])
    return [refined(model, told) for model in _with_own_pictures(found)]


def _joined(database: Path, out: Path, pictures: int, held: bool, threads: int, tell: Tell,
            lens: KnownLens) -> list[Model]:
    """Mapped globally: that closes rings which break where pictures share little, but gives pictures a place that have
    none. What their pairs do not confirm is left out."""
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir()
    found = _mapped(database, out, pictures, "global", held, threads, tell)
    for model in found:
        leave_out_unconfirmed(model, database, lens.near_px)
    return [m for m in found if m.num_reg_images() >= LEAST_MODEL]


def _mapped_either_way(database: Path, out: Path, pictures: int, mapper: str, told: bool, threads: int,
                       tell: Tell) -> list[Model]:
    """With focal lengths held while the model grows, or found along: above a flat site what is found along runs away,
    what EXIF tells may be of another lens. The way that is more likely first, the other where too little came of it.
    """
    best: list[Model] = []
    for held in (told, not told):
        out.mkdir()
        found = _mapped(database, out, pictures, mapper, held, threads, tell)
        best = max(best, found, key=_largest)
        if any(m.num_reg_images() >= ENOUGH * pictures and m.compute_mean_reprojection_error() < GOOD_PX
               for m in found):
            break
        shutil.rmtree(out)
    return best


def _largest(models: Sequence[Model]) -> tuple[int, int]:
    """Pictures and observations of the largest model."""
    return max(((m.num_reg_images(), m.compute_num_observations()) for m in models), default=(0, 0))


def _mapped(database: Path, out: Path, pictures: int, mapper: str, held: bool, threads: int, tell: Tell,
            lens: KnownLens | None = None) -> list[Model]:
    """held: whether focal lengths stay. lens: cameras that stay as they are, incrementally."""
    tell("map", 0, pictures)
    if mapper == "global":
        options = pycolmap.GlobalPipelineOptions(num_threads=threads, random_seed=SEED, min_model_size=LEAST_MODEL)
        options.mapper.bundle_adjustment.refine_focal_length = not held
        models = pycolmap.global_mapping(database, out, out, options)
    else:
        incremental = pycolmap.IncrementalPipelineOptions(
            num_threads=threads, random_seed=SEED, min_model_size=LEAST_MODEL, extract_colors=False,
            ba_refine_focal_length=not held)
        incremental.mapper.abs_pose_refine_focal_length = not held
        if lens is not None:
            incremental.constant_cameras = set(lens.cameras)
            incremental.mapper.abs_pose_max_error = SURE_NEAR * lens.near_px
            incremental.mapper.abs_pose_min_num_inliers = LEAST_SURE
        registered = 2

        def one_more() -> None:
            nonlocal registered
            registered = min(registered + 1, pictures)
            tell("map", registered, pictures)

        models = pycolmap.incremental_mapping(database, out, out, incremental, next_image_callback=one_more)
    tell("map", pictures, pictures)
    return [m for m in models.values() if m.num_reg_images() >= LEAST_MODEL]


def _with_own_pictures(models: list[Model]) -> list[Model]:
    """Largest first, without those that show nearly nothing but what larger ones show already."""
    taken: set[int] = set()
    kept = []
    for model in sorted(models, key=lambda m: -m.num_reg_images()):
        own = set(model.reg_image_ids()) - taken
        if len(own) >= LEAST_MODEL:
            kept.append(model)
            taken |= own
    return kept


def _image_name(i: int) -> str:
    return f"{i:06d}"


def told_focal_px(photographs: Sequence[Photograph]) -> dict[int, float]:
    """By camera, where a photograph tells it or COLMAP knows the camera."""
    cameras = [_first_camera(photographs[members[0]], camera_id)
               for camera_id, members in enumerate(camera_groups(photographs).values(), start=1)]
    return {c.camera_id: c.mean_focal_length() for c in cameras if c.has_prior_focal_length}


def _write_database(path: Path, photographs: Sequence[Photograph], seen: Sequence[Features],
                    matches: OfPair) -> None:
    """Image, frame and rig of photograph i have number i + 1; names are numbers, whatever files are called."""
    with pycolmap.Database.open(path) as database:
        for camera_id, members in enumerate(camera_groups(photographs).values(), start=1):
            database.write_camera(_first_camera(photographs[members[0]], camera_id), use_camera_id=True)
            rig = pycolmap.Rig(rig_id=camera_id)
            rig.add_ref_sensor(pycolmap.sensor_t(pycolmap.SensorType.CAMERA, camera_id))
            database.write_rig(rig, use_rig_id=True)
            for i in members:
                image = pycolmap.Image(name=_image_name(i), camera_id=camera_id, image_id=i + 1)
                frame = pycolmap.Frame(frame_id=i + 1, rig_id=camera_id)
                frame.add_data_id(image.data_id)
                database.write_image(image, use_image_id=True)
                database.write_frame(frame, use_frame_id=True)
                database.write_keypoints(i + 1, np.ascontiguousarray(seen[i].points_px))
        for (i, j), of_pair in matches.items():
            database.write_matches(i + 1, j + 1, of_pair)


def _first_camera(photograph: Photograph, camera_id: int) -> pycolmap.Camera:
    """What is known before mapping: the photograph's own word, COLMAP's table of sensors, or a guess."""
    width, height = photograph.size_px
    metadata = photograph.metadata
    assert metadata is not None
    focal, known = metadata.focal_px, metadata.focal_px is not None
    if focal is None and metadata.model:
        told = pycolmap.Bitmap.read(photograph.path, as_rgb=False)
        told_px = told.exif_focal_length() if told is not None else None
        focal, known = (told_px, True) if told_px else (None, False)
    camera = pycolmap.Camera.create_from_model_name(
        camera_id, "SIMPLE_RADIAL", focal or GUESSED_FOCAL_SHARE * max(width, height), width, height)
    camera.has_prior_focal_length = known
    return camera
