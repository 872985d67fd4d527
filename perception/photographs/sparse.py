"""Where photographs were taken, from what they show alone: COLMAP's mapping of matched features.

Each camera's focal length and radial distortion are found along with the poses, and two more terms of Brown's model at
the end. What does not hang together becomes several models, each in coordinates of its own.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from pathlib import Path

import cv2
import numpy as np
import pycolmap

from missions.errors import UserError
from missions.frames import Array
from perception.photographs.mapping import map_matched
from perception.photographs.pairs import candidate_pairs
from perception.photographs.photograph import Photograph, read_pixels
from perception.reconstruct.features import Features, sift
from perception.reconstruct.matching import MIN_MATCHES, ByPair, nearest_anywhere
from perception.reconstruct.resources import single_threaded_libraries

pycolmap.logging.minloglevel = 2

METHOD = 3
"""Raised whenever the result changes for the same input, so that a stored one is not taken for a new one."""
WIDTH_PX = 1600
COUNT = 3000
Tell = Callable[[str, int, int], None]
Model = pycolmap.Reconstruction


def map_photographs(photographs: Sequence[Photograph], position_enu_m: Array, folder: Path, threads: int,
                    mapper: str, tell: Tell) -> list[Model]:
    """Models of the photographs, the one with most of them first; image i + 1 is photograph i.

    position_enu_m: (n, 3) from GNSS, NaN where unknown; it only helps to choose pairs. mapper: "incremental" or
    "global". Features, matches and models are kept in folder and taken from there when the same photographs come again.
    Raises UserError when nothing hangs together.
    """
    folder.mkdir(parents=True, exist_ok=True)
    key = hashlib.sha256(json.dumps([METHOD, mapper, [(p.name, p.sha256) for p in photographs],
                                     np.round(np.nan_to_num(position_enu_m), 2).tolist()]).encode()).hexdigest()[:12]
    if not (folder / "models.json").is_file() or json.loads((folder / "models.json").read_text())["key"] != key:
        with single_threaded_libraries(), ThreadPoolExecutor(threads) as pool:
            seen = _features(photographs, folder / "features", pool, tell)
            matches = _matches(seen, position_enu_m, folder / f"matches-{key}.npz", pool, tell)
        map_matched(photographs, seen, matches, folder, mapper, threads, tell)
        (folder / "models.json").write_text(json.dumps({"key": key}), encoding="utf-8")
    models = [Model(path) for path in sorted(folder.glob("model-*"))]
    if not models:
        raise UserError(_why_nothing(len(photographs)))
    return models


def _why_nothing(pictures: int) -> str:
    return (f"{pictures} pictures: no two of them overlap enough for a model; take pictures that show the same surface "
            "from places beside each other (60 % overlap and more), sharp and with texture.")


def _features(photographs: Sequence[Photograph], folder: Path, pool: Executor, tell: Tell) -> list[Features]:
    folder.mkdir(parents=True, exist_ok=True)
    seen: list[Features] = []
    for found in pool.map(lambda p: _kept_features(p, folder), photographs):
        seen.append(found)
        tell("features", len(seen), len(photographs))
    return seen


def _kept_features(photograph: Photograph, folder: Path) -> Features:
    path = folder / f"{photograph.sha256[:16]}-{WIDTH_PX}-{COUNT}.npz"
    if not path.is_file():
        pixels = read_pixels(photograph)
        longer = max(pixels.shape[:2])
        scale = max(1.0, longer / WIDTH_PX)
        size = round(pixels.shape[1] / scale), round(pixels.shape[0] / scale)
        grey = cv2.resize(cv2.cvtColor(pixels, cv2.COLOR_BGR2GRAY), size, interpolation=cv2.INTER_AREA)
        found = sift(np.asarray(grey), COUNT, pixels.shape[1] / size[0])
        unfinished = path.with_suffix(".part")
        with unfinished.open("wb") as f:
            np.savez(f, points=found.points_px, descriptors=found.descriptors, sizes=found.sizes_px)
        unfinished.replace(path)
    with np.load(path) as kept:
        return Features(kept["points"], kept["descriptors"], kept["sizes"])


def _matches(seen: list[Features], position_enu_m: Array, path: Path, pool: Executor,
             tell: Tell) -> ByPair:
    """By pair; pairs with fewer than MIN_MATCHES are left out."""
    if path.is_file():
        with np.load(path) as kept:
            parts = np.split(kept["matches"], kept["ends"][:-1])
            return {(int(i), int(j)): part for (i, j), part in zip(kept["pairs"], parts, strict=True)}
    tell("pairs", 0, 1)
    pairs = candidate_pairs(seen, position_enu_m, pool)
    tell("pairs", 1, 1)
    found: ByPair = {}
    for done, (pair, of_pair) in enumerate(zip(pairs, pool.map(
            lambda pair: nearest_anywhere(seen[pair[0]], seen[pair[1]]), pairs), strict=True), start=1):
        if len(of_pair) >= MIN_MATCHES:
            found[pair] = of_pair
        tell("match", done, len(pairs))
    ends = np.cumsum([len(m) for m in found.values()], dtype=np.int64)
    np.savez(path, pairs=np.array(list(found), np.int64).reshape(-1, 2), ends=ends,
             matches=np.concatenate([np.zeros((0, 2), np.uint32), *found.values()]))
    return found
