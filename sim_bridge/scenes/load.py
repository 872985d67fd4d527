"""A scene from its mission section: a built-in structure by name, or a file or folder by path."""

from __future__ import annotations

import numpy as np

from missions.errors import UserError
from missions.mission import SceneSpec, SiteSpec
from sim_bridge.scenes.builtin import BUILT_IN
from sim_bridge.scenes.scene import Part, Scene, merged
from sim_bridge.scenes.surroundings import ground, growth


def load_scene(spec: SceneSpec, site: SiteSpec) -> Scene:
    """The true scene that a mission names, complete with ground and, if wanted, surroundings.

    The same spec and site give the same scene, bit by bit. Raises UserError in one sentence.
    """
    if spec.name not in BUILT_IN:
        known = ", ".join(sorted(BUILT_IN))
        raise UserError(f"scene.name: there is no built-in structure {spec.name!r}; choose one of: {known}.")
    rng = np.random.default_rng([spec.seed, sorted(BUILT_IN).index(spec.name)])
    parts = BUILT_IN[spec.name](rng)
    vertices, _ = merged(parts)
    lo, hi = vertices.min(axis=0), vertices.max(axis=0)
    return surrounded(spec, site, spec.name, parts, lo, hi)


def surrounded(spec, site, name, parts, lo, hi):
    rng = np.random.default_rng([spec.seed, 77])
    up = 0.0
    parts = [*parts, *ground(rng, lo, hi, up, spec.surroundings)]
    if spec.surroundings:
        parts += growth(rng, lo, hi, up)
    return Scene(name, parts, tuple(lo.tolist()), tuple(hi.tolist()), up, [])
