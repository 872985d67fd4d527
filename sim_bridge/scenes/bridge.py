"""A suspension bridge, 62.2 x 9.9 x 22.4 m: stone piers and abutments, concrete towers, steel deck, cables, hangers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sim_bridge.scenes import textures
from sim_bridge.scenes.scene import Part
from sim_bridge.scenes.solids import Solid, box, planar_mapped, plate, quads, textured, tube

LENGTH_M, WIDTH_M, HEIGHT_M = 62.2, 9.9, 22.4
HALF_LENGTH, HALF_WIDTH = LENGTH_M / 2, WIDTH_M / 2

TOWER_X = 17.0
LEG_HALF_X, LEG_INNER_Y = 0.75, 4.05
PIER_HALF_X, PIER_TOP = 1.4, 5.6
ABUTMENT_X = 28.3
GIRDER_Y, GIRDER_HALF, GIRDER_BOTTOM = 3.0, 0.15, 7.0
SOFFIT, ROAD, KERB, PARAPET, HANDRAIL = 8.0, 8.4, 8.58, 9.1, 9.85
DECK_Y, PARAPET_Y, KERB_Y = 3.9, 3.65, 2.9
FLOOR_BEAM_X = np.arange(-26.0, 26.1, 2.0)
CABLE_Y, CABLE_TOP, CABLE_LOW, CABLE_RADIUS = 4.5, 22.0, 10.7, 0.16
ANCHOR_X, ANCHOR_Z = 29.4, 9.0
SIDES = (-1.0, 1.0)

Array = NDArray[np.float64]


def bridge(rng: np.random.Generator) -> list[Part]:
    """The bridge's parts, centred on the origin, standing on z = 0, along x."""
    return [
        textured("masonry", _masonry(), textures.stone(rng)),
        textured("concrete", [*_towers(), *_deck_concrete()], textures.concrete(rng)),
        textured("roadway", _roadway(), textures.asphalt(rng)),
        textured("steelwork", [*_girders(), *_railings()], textures.painted_steel(rng)),
        textured("cables", _cables(), textures.galvanised(rng)),
    ]


def _masonry() -> list[Solid]:
    solids = []
    for side in SIDES:
        x0, x1 = sorted((side * (TOWER_X - PIER_HALF_X), side * (TOWER_X + PIER_HALF_X)))
        solids.append(box((x0 + 0.15, -HALF_WIDTH + 0.15, 0.0), (x1 - 0.15, HALF_WIDTH - 0.15, 4.9), "-z +z"))
        solids.append(box((x0, -HALF_WIDTH, 4.9), (x1, HALF_WIDTH, PIER_TOP), "-z +z"))
        inner = (x0 + 0.15, -HALF_WIDTH + 0.15, x1 - 0.15, HALF_WIDTH - 0.15)
        solids.append(plate((x0, -HALF_WIDTH), (x1, HALF_WIDTH), 4.9, [inner], facing_up=False))
        legs = [_leg_footprint(side, y) for y in SIDES]
        solids.append(plate((x0, -HALF_WIDTH), (x1, HALF_WIDTH), PIER_TOP, legs))
        solids += _abutment(side)
    return solids


def _leg_footprint(side: float, y_side: float) -> tuple[float, float, float, float]:
    y0, y1 = sorted((y_side * LEG_INNER_Y, y_side * HALF_WIDTH))
    return side * TOWER_X - LEG_HALF_X, y0, side * TOWER_X + LEG_HALF_X, y1


def _abutment(side: float) -> list[Solid]:
    x0, x1 = sorted((side * ABUTMENT_X, side * HALF_LENGTH))
    a0, a1 = sorted((side * (ANCHOR_X - 0.5), side * (ANCHOR_X + 0.9)))
    deck = (x0, -DECK_Y, x1, DECK_Y)
    anchors = [(a0, min(y * 4.1, y * 4.9), a1, max(y * 4.1, y * 4.9)) for y in SIDES]
    blocks = [box((ax0, ay0, SOFFIT), (ax1, ay1, ANCHOR_Z + 0.3), "-z") for ax0, ay0, ax1, ay1 in anchors]
    return [box((x0, -HALF_WIDTH, 0.0), (x1, HALF_WIDTH, SOFFIT), "-z +z"),
            plate((x0, -HALF_WIDTH), (x1, HALF_WIDTH), SOFFIT, [deck, *anchors]), *blocks]


def _towers() -> list[Solid]:
    solids = []
    for side in SIDES:
        x = side * TOWER_X
        for y_side in SIDES:
            y0, y1 = sorted((y_side * LEG_INNER_Y, y_side * HALF_WIDTH))
            solids.append(box((x - LEG_HALF_X, y0, PIER_TOP), (x + LEG_HALF_X, y1, 21.4), "-z +z"))
            solids.append(box((x - 0.95, y0, 21.4), (x + 0.95, y1, HEIGHT_M), "-z"))
            solids.append(plate((x - 0.95, y0), (x + 0.95, y1), 21.4, [_leg_footprint(side, y_side)],
                                facing_up=False))
        for low, high, half in ((5.9, 6.9, 0.6), (14.6, 15.8, 0.5), (19.6, 20.8, 0.5)):
            solids.append(box((x - half, -LEG_INNER_Y, low), (x + half, LEG_INNER_Y, high), "-y +y"))
        solids += [_bearing(x, y_side) for y_side in SIDES]
        solids += _haunches(x)
    return solids


def _bearing(x: float, y_side: float) -> Solid:
    y = y_side * GIRDER_Y
    return box((x - 0.3, y - GIRDER_HALF, 6.9), (x + 0.3, y + GIRDER_HALF, GIRDER_BOTTOM), "-z +z")


def _haunches(x: float) -> list[Solid]:
    """Triangular brackets in the corners of the portal over the road."""
    reach, top, half = 1.3, 14.6, 0.35
    solids = []
    for s in SIDES:
        wall, tip = s * LEG_INNER_Y, s * (LEG_INNER_Y - reach)
        low = top - reach
        slope = [(x - half, wall, low), (x + half, wall, low), (x + half, tip, top), (x - half, tip, top)]
        solids.append(quads([slope[::int(-s)]]))
        for e in SIDES:
            cheek = np.array([(x + e * half, wall, low), (x + e * half, wall, top), (x + e * half, tip, top)])
            solids.append(planar_mapped(cheek, np.array([[0, 1, 2][::int(e * s)]], np.int32)))
    return solids


def _deck_concrete() -> list[Solid]:
    girders = [(-ABUTMENT_X, s * GIRDER_Y - GIRDER_HALF, ABUTMENT_X, s * GIRDER_Y + GIRDER_HALF) for s in SIDES]
    beams = [(x - 0.15, -DECK_Y, x + 0.15, DECK_Y) for x in FLOOR_BEAM_X]
    solids = [plate((-ABUTMENT_X, -DECK_Y), (ABUTMENT_X, DECK_Y), SOFFIT, girders + beams, facing_up=False)]
    ends = [(-HALF_LENGTH, "-x"), (HALF_LENGTH, "+x")]
    every = {"-x", "+x", "-y", "+y", "-z", "+z"}
    for x, face in ends:
        solids.append(box((x, -DECK_Y, SOFFIT), (x, DECK_Y, ROAD), " ".join(every - {face})))
    for s in SIDES:
        kerb = sorted((s * KERB_Y, s * PARAPET_Y))
        wall = sorted((s * PARAPET_Y, s * DECK_Y))
        inner, outer = ("-y", "+y") if s > 0 else ("+y", "-y")
        solids += [
            box((-HALF_LENGTH, kerb[0], ROAD), (HALF_LENGTH, kerb[1], KERB), f"-z {outer}"),
            box((-HALF_LENGTH, wall[0], KERB), (HALF_LENGTH, wall[1], PARAPET), "-z"),
            box((-HALF_LENGTH, wall[0], SOFFIT), (HALF_LENGTH, wall[1], KERB), f"-z +z {inner}"),
        ]
    return solids


def _roadway() -> list[Solid]:
    return [plate((-HALF_LENGTH, -KERB_Y), (HALF_LENGTH, KERB_Y), ROAD)]


def _girders() -> list[Solid]:
    solids = []
    inner, tip = GIRDER_Y - GIRDER_HALF, 4.72
    for s in SIDES:
        y = s * GIRDER_Y
        solids.append(box((-ABUTMENT_X, y - GIRDER_HALF, GIRDER_BOTTOM), (ABUTMENT_X, y + GIRDER_HALF, SOFFIT),
                          "-x +x +z"))
    for x in FLOOR_BEAM_X:
        solids.append(box((x - 0.15, -inner, 7.45), (x + 0.15, inner, SOFFIT), "-y +y +z"))
        for s in SIDES:
            y0, y1 = sorted((s * (GIRDER_Y + GIRDER_HALF), s * DECK_Y))
            solids.append(box((x - 0.15, y0, 7.45), (x + 0.15, y1, SOFFIT), "-y +y +z"))
            y0, y1 = sorted((s * DECK_Y, s * tip))
            solids.append(box((x - 0.15, y0, 7.45), (x + 0.15, y1, SOFFIT), "-y" if s > 0 else "+y"))
    return solids


def _railings() -> list[Solid]:
    solids = []
    y_rail = (PARAPET_Y + DECK_Y) / 2
    for s in SIDES:
        y = s * y_rail
        for x in np.linspace(-HALF_LENGTH + 0.1, HALF_LENGTH - 0.1, 42):
            solids.append(box((x - 0.04, y - 0.04, PARAPET), (x + 0.04, y + 0.04, HANDRAIL), "-z"))
        for z, radius in ((HANDRAIL, 0.045), (9.48, 0.03)):
            path = np.array([(x, y, z) for x in np.linspace(-HALF_LENGTH, HALF_LENGTH, 43)])
            solids.append(tube(path, radius, 6, capped=True))
    return solids


def cable_height_m(x: float | Array) -> Array:
    """Height of the main cables over x: a parabola in the main span, slightly sagging chords beside it."""
    reach = np.abs(np.asarray(x, dtype=np.float64))
    main = CABLE_LOW + (CABLE_TOP - CABLE_LOW) * (reach / TOWER_X) ** 2
    t = (reach - TOWER_X) / (ANCHOR_X - TOWER_X)
    side = CABLE_TOP + (ANCHOR_Z - CABLE_TOP) * t - 2.4 * t * (1.0 - t)
    return np.asarray(np.where(reach <= TOWER_X, main, side))


def _cables() -> list[Solid]:
    solids = []
    near, far = TOWER_X - LEG_HALF_X, TOWER_X + LEG_HALF_X
    side = np.linspace(far, ANCHOR_X - 0.4, 25)
    spans = (np.linspace(-near, near, 65), side, -side[::-1])
    hung = [float(x) for x in FLOOR_BEAM_X if abs(abs(x) - TOWER_X) > 1.5 and cable_height_m(float(x)) > 10.0]
    for y in (-CABLE_Y, CABLE_Y):
        for xs in spans:
            solids.append(tube(np.stack([xs, np.full_like(xs, y), cable_height_m(xs)], axis=1), CABLE_RADIUS, 12))
        for x in hung:
            z = float(cable_height_m(x))
            solids.append(tube([(x, y, SOFFIT), (x, y, z)], 0.035, 6))
            clamp = np.array([x - 0.14, x, x + 0.14])
            band = np.stack([clamp, np.full_like(clamp, y), cable_height_m(clamp)], axis=1)
            solids.append(tube(band, CABLE_RADIUS + 0.05, 12, capped=True))
    return solids
