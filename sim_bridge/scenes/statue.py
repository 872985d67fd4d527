"""A winged figure on a pedestal, 43.6 x 9.5 x 51.1 m: one smooth surface of melted limbs, weathered copper."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from sim_bridge.scenes import textures
from sim_bridge.scenes.implicit import Field, Limb, Volume, relaxed, round_cone, surface
from sim_bridge.scenes.scene import Part
from sim_bridge.scenes.solids import Solid, box, planar_mapped, plate, textured

LENGTH_M, WIDTH_M, HEIGHT_M = 43.6, 9.5, 51.1
PEDESTAL_M = 9.0
STEP_M = 0.32
HEM_X, HEM_Y, WAIST = 4.4, 3.3, 30.0
"""Half-axes of the robe on the pedestal; height of the belt."""

Array = NDArray[np.float64]


def statue(rng: np.random.Generator) -> list[Part]:
    """The statue's parts, centred on the origin, standing on z = 0, facing south."""
    return [textured("figure", [_figure()], textures.patina(rng)),
            textured("pedestal", _pedestal(), textures.stone(rng, (176, 166, 148)))]


def _figure() -> Solid:
    """The figure's surface, stretched by the last decimetres to the exact overall size."""
    field = Field.empty((-23.0, -4.7, PEDESTAL_M - 2 * STEP_M), (23.0, 4.7, 52.5), STEP_M)
    field.add(_robe, (-5.5, -4.5, PEDESTAL_M - 1.0), (5.5, 4.5, WAIST + 1.0), 0.6)
    for limb in (*_body(), *_arms()):
        field.add(*limb, 1.0)
    for limb in (*_details(), *_wing(-1.0), *_wing(1.0)):
        field.add(*limb, 0.45)
    vertices, faces = surface(field)
    vertices = relaxed(vertices, faces, rounds=10)
    vertices[:, 0] *= LENGTH_M / 2 / np.where(vertices[:, 0] > 0, vertices[:, 0].max(), -vertices[:, 0].min())
    rise = vertices[:, 2] - PEDESTAL_M
    vertices[:, 2] = PEDESTAL_M + rise * (HEIGHT_M - PEDESTAL_M) / rise.max()
    return planar_mapped(vertices, faces)


def _robe(x: Volume, y: Volume, z: Volume) -> Volume:
    """A skirt that narrows to the belt, with folds that run down and deepen towards the hem."""
    t = np.clip((z - PEDESTAL_M) / (WAIST - PEDESTAL_M), 0.0, 1.0)
    narrow = 1.0 - 0.5 * t ** 0.8
    angle = np.arctan2(y * (HEM_X / HEM_Y), x)
    waves = np.sin(11 * angle + 1.5 * np.sin(0.21 * z)) + 0.5 * np.sin(23 * angle - 0.3 * z)
    fold = 0.26 * (1.0 - 0.75 * t) * waves
    radial = (np.sqrt((x / HEM_X) ** 2 + (y / HEM_Y) ** 2) - narrow) * np.float32(HEM_Y)
    return np.asarray(np.maximum(radial - fold, z - WAIST), dtype=np.float32)


def _body() -> list[Limb]:
    return [
        round_cone((0.0, 0.0, 29.0), (0.0, -0.2, 36.0), (2.3, 3.0), 1.25),
        round_cone((-2.6, 0.1, 37.4), (2.6, 0.1, 37.4), (1.5, 1.5)),
        round_cone((0.0, -0.1, 37.5), (0.0, -0.3, 41.0), (1.25, 1.1)),
        round_cone((0.0, -0.4, 42.2), (0.0, -0.5, 43.6), (1.8, 2.0)),
        round_cone((0.0, 1.0, 43.0), (0.0, 1.7, 38.6), (1.7, 0.9)),
    ]


def _details() -> list[Limb]:
    """Nose, the rays of the diadem, the torch's flame, the tablet."""
    rays = np.linspace(0.1, np.pi - 0.1, 7)
    return [
        round_cone((0.0, -2.3, 43.4), (0.0, -2.75, 42.6), (0.3, 0.4)),
        *(round_cone((1.6 * np.cos(a), -0.4, 44.2 + 0.9 * np.sin(a)), (3.7 * np.cos(a), -0.6, 44.6 + 3.2 * np.sin(a)),
                     (0.45, 0.3)) for a in rays),
        round_cone((-5.6, -1.2, 48.6), (-5.6, -1.2, 50.8), (1.15, 0.4)),
        round_cone((3.7, -2.4, 29.0), (2.0, -2.9, 33.4), (1.35, 1.35), 2.6),
    ]


def _arms() -> list[Limb]:
    """The right arm raises a torch, the left one holds a tablet against the hip."""
    return [
        round_cone((-3.4, 0.0, 37.6), (-5.8, -0.9, 41.4), (1.25, 1.0)),
        round_cone((-5.8, -0.9, 41.4), (-5.6, -1.2, 46.2), (1.0, 0.75)),
        round_cone((-5.6, -1.2, 45.4), (-5.6, -1.2, 48.6), (0.55, 0.95)),
        round_cone((3.4, 0.0, 37.4), (4.6, -1.0, 33.4), (1.25, 1.0)),
        round_cone((4.6, -1.0, 33.4), (2.6, -2.6, 31.0), (0.95, 0.7)),
    ]


def _wing(side: float) -> list[Limb]:
    """An arm of the wing, and feathers that fan out below it in two layers."""
    arm = np.array([(1.5, 1.9, 36.0), (5.5, 2.6, 40.6), (10.5, 2.6, 43.4), (15.5, 2.1, 43.6), (19.6, 1.5, 41.4)])
    arm[:, 0] *= side
    limbs = [round_cone(a, b, (1.15 - 0.15 * i, 1.0 - 0.15 * i)) for i, (a, b) in
             enumerate(pairwise(arm))]
    for i, t in enumerate(np.linspace(0.03, 1.0, 15)):
        root = np.array([np.interp(t * 4, range(5), arm[:, k]) for k in range(3)])
        splay = np.radians(-84.0 + 84.0 * t ** 1.2)
        reach = 12.5 - 7.0 * t
        tip = root + np.array([side * reach * np.cos(splay) * 0.75, 0.9 * (i % 2) - 0.5, reach * np.sin(splay)])
        tip[0] = side * min(abs(tip[0]), 20.9)
        limbs.append(round_cone(root, tip, (0.95, 0.75), 1.7))
        short = root + 0.5 * (tip - root) + np.array([0.0, -0.75, 0.0])
        limbs.append(round_cone(root - np.array([0.0, 0.35, 0.0]), short, (0.85, 0.6), 1.5))
    return limbs


def _pedestal() -> list[Solid]:
    """Three steps; the top is open where the robe stands on it."""
    blocks = ((6.5, WIDTH_M / 2, 0.0, 1.3), (5.6, 4.1, 1.3, 8.0), (6.1, 4.6, 8.0, PEDESTAL_M))
    solids = [box((-x, -y, z0), (x, y, z1), "-z +z") for x, y, z0, z1 in blocks]
    (x0, y0, *_), (x1, y1, *_), (x2, y2, *_) = blocks
    dado = (-x1, -y1, x1, y1)
    return [*solids, plate((-x0, -y0), (x0, y0), 1.3, [dado]),
            plate((-x2, -y2), (x2, y2), 8.0, [dado], facing_up=False),
            plate((-x2, -y2), (x2, y2), PEDESTAL_M, _footprint())]


def _footprint() -> list[tuple[float, float, float, float]]:
    """Strips that lie under the robe whatever its folds do."""
    edges = np.linspace(-0.8 * HEM_Y, 0.8 * HEM_Y, 13)
    far = np.maximum(np.abs(edges[:-1]), np.abs(edges[1:]))
    half = 0.82 * HEM_X * np.sqrt(1.0 - (far / (0.82 * HEM_Y)) ** 2)
    return [(-x, y0, x, y1) for x, y0, y1 in zip(half, edges[:-1], edges[1:], strict=True)]
