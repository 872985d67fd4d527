"""A scene from its mission section: a built-in structure or a member of a family by name, or a file or folder."""

from __future__ import annotations

import zlib
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from missions.errors import UserError
from missions.mission import SiteSpec
from missions.scene_names import check_scene_name, parse_family
from missions.simulation import SceneSpec
from sim_bridge.scenes.builtin import BUILT_IN
from sim_bridge.scenes.families.registry import member_parts
from sim_bridge.scenes.importer import Box, Imported, import_parts
from sim_bridge.scenes.repair import selected
from sim_bridge.scenes.scene import Part, Scene, merged
from sim_bridge.scenes.surroundings import GROUND, PREFIX, ground, growth

SMALLEST_M, LARGEST_M = 0.5, 2000.0
OWN_GROUND_REACH_M = 10.0
"""A file whose surroundings reach this far beyond the object on all sides brings its own ground."""

Array = NDArray[np.float64]


def load_scene(spec: SceneSpec, site: SiteSpec) -> Scene:
    """The true scene that a mission names, complete with ground and, if wanted, surroundings.

    The object's box is the site's, else that of bbox/*_bounds.obj, else the mesh's. What lies outside a given box is
    not part of the object. The same spec and site give the same scene, bit by bit. Raises UserError in one sentence.
    """
    source = import_parts(Path(spec.path), spec.units_per_metre, spec.up) if spec.path else _named(spec)
    where = spec.path or f"scene.name = {spec.name!r}"
    given = _site_bounds(site) or source.bounds
    parts, notes = source.parts, list(source.notes)
    if given is not None:
        parts, moved = _split(parts, given)
        if moved:
            notes.append(f"{moved} faces outside the object's box count as surroundings")
    own = [p for p in parts if p.is_object]
    if not own:
        raise UserError(f"{where}: no triangle lies in the object's box; correct site.object_min_enu_m and "
                        "site.object_max_enu_m, or leave them out.")
    lo, hi = given or _bounds(own)
    _check_size(where, lo, hi)
    up = _ground_up_m(parts, site, lo)
    parts = [*parts, *_around(spec, parts, lo, hi, up)]
    return Scene(source.name, parts, _triple(lo), _triple(hi), up, notes)


def _named(spec: SceneSpec) -> Imported:
    check_scene_name(spec.name)
    drawn = parse_family(spec.name)
    if drawn is not None:
        return Imported(drawn.name, member_parts(drawn), None, [])
    rng = np.random.default_rng([spec.seed, zlib.crc32(spec.name.encode())])
    return Imported(spec.name, BUILT_IN[spec.name](rng), None, [])


def _seed(spec: SceneSpec) -> int:
    """What the surroundings are drawn from: the whole name of a family's scene, else the mission's seed."""
    drawn = None if spec.path else parse_family(spec.name)
    return spec.seed if drawn is None else zlib.crc32(drawn.name.encode())


def _site_bounds(site: SiteSpec) -> Box | None:
    if site.object_min_enu_m is None or site.object_max_enu_m is None:
        return None
    return np.array(site.object_min_enu_m), np.array(site.object_max_enu_m)


def _bounds(parts: list[Part]) -> Box:
    vertices, _ = merged(parts)
    return vertices.min(axis=0), vertices.max(axis=0)


def _split(parts: list[Part], box: Box) -> tuple[list[Part], int]:
    """The parts with faces whose middle lies outside the box split off as surroundings, and how many faces that is."""
    kept: list[Part] = []
    moved = 0
    for part in parts:
        middle = part.vertices_enu_m[part.faces].mean(axis=1)
        outside = ((middle < box[0] - 1e-6) | (middle > box[1] + 1e-6)).any(axis=1)
        if not part.is_object or not outside.any():
            kept.append(part)
            continue
        moved += int(outside.sum())
        if not outside.all():
            kept.append(selected(part, ~outside))
        kept.append(replace(selected(part, outside), name=PREFIX + part.name, is_object=False))
    return kept, moved


def _check_size(where: str, lo: Array, hi: Array) -> None:
    size = hi - lo
    told = " x ".join(f"{s:.4g}" for s in size)
    if not SMALLEST_M <= size.max() <= LARGEST_M:
        raise UserError(f"{where}: the object measures {told} m, not between {SMALLEST_M} m and {LARGEST_M:.0f} m; set "
                        "scene.units_per_metre (1000 for a model in millimetres).")
    if size.min() <= 0.0:
        raise UserError(f"{where}: the object's box of {told} m has no volume; give site.object_min_enu_m and "
                        "site.object_max_enu_m.")


def _ground_up_m(parts: list[Part], site: SiteSpec, lo: Array) -> float:
    for part in parts:
        if part.name == GROUND:
            return float(part.vertices_enu_m[:, 2].max())
    return float(lo[2]) if site.ground_up_m is None else site.ground_up_m


def _around(spec: SceneSpec, parts: list[Part], lo: Array, hi: Array, up: float) -> list[Part]:
    """Ground and growth, unless the scene brings its own."""
    others = [p for p in parts if not p.is_object]
    if others:
        low, high = _bounds(others)
        reach = min(*(lo[:2] - low[:2]), *(high[:2] - hi[:2]))
        if reach >= OWN_GROUND_REACH_M:
            return []
    rng = np.random.default_rng([_seed(spec), zlib.crc32(b"surroundings")])
    made = ground(rng, lo, hi, up, spec.surroundings)
    return made + growth(rng, lo, hi, up) if spec.surroundings else made


def _triple(point: Array) -> tuple[float, float, float]:
    x, y, z = (float(c) for c in point)
    return x, y, z
