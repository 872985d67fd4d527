"""A long, thin palace front, 50.1 x 5.5 x 21.1 m: stone arcade, brick storeys with repeated windows, tiled roof."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sim_bridge.scenes import textures
from sim_bridge.scenes.scene import Part
from sim_bridge.scenes.solids import Solid, box, box_corners, cells, planar_mapped, plate, quads, textured

LENGTH_M, WIDTH_M, HEIGHT_M = 50.1, 5.5, 21.1
EAVES_X, EAVES_Y = LENGTH_M / 2, WIDTH_M / 2
WALL_X, WALL_Y = 24.75, 2.4
BAYS = 15
BAY_M = 2 * WALL_X / BAYS
COURSE_LOW, COURSE_TOP, CORNICE_LOW, CORNICE_TOP, RIDGE = 5.4, 5.7, 17.7, 18.3, 20.4
STOREYS_Z = (6.7, 10.75, 14.8)
"""Window sills."""
ARCH_HALF, SPRINGING, ARCADE_DEPTH, GALLERY_DEPTH, CEILING = 1.15, 2.9, 0.45, 1.8, 5.0
REVEAL_M = 0.25

Array = NDArray[np.float64]
Rectangle = tuple[float, float, float, float]


@dataclass(frozen=True)
class Face:
    """A vertical plane with local axes: along it to the right as seen from outside, up, and outward."""

    origin: tuple[float, float]
    along: tuple[float, float]

    def place(self, corners: ArrayLike) -> Array:
        """World corners (n, 4, 3) of local corners (n, 4, 3) in (along, up, outward)."""
        local = np.asarray(corners, dtype=np.float64)
        ax, ay = self.along
        x = self.origin[0] + local[..., 0] * ax + local[..., 2] * ay
        y = self.origin[1] + local[..., 0] * ay - local[..., 2] * ax
        return np.stack([x, y, local[..., 1]], axis=-1)


@dataclass
class Materials:
    """Corners collected by material while the building goes up."""

    stone: list[Solid] = field(default_factory=list)
    brick: list[Solid] = field(default_factory=list)
    glass: list[Solid] = field(default_factory=list)
    frame: list[Solid] = field(default_factory=list)
    plaster: list[Solid] = field(default_factory=list)
    roof: list[Solid] = field(default_factory=list)


SOUTH = Face((-WALL_X, -WALL_Y), (1.0, 0.0))
NORTH = Face((WALL_X, WALL_Y), (-1.0, 0.0))
EAST = Face((WALL_X, -WALL_Y), (0.0, 1.0))
WEST = Face((-WALL_X, WALL_Y), (0.0, -1.0))
GALLERY = Face((-WALL_X + ARCADE_DEPTH, -WALL_Y + GALLERY_DEPTH), (1.0, 0.0))


def building(rng: np.random.Generator) -> list[Part]:
    """The building's parts, centred on the origin, standing on z = 0, its arcade to the south."""
    made = Materials()
    _arcade(made)
    _ground_floor(made)
    for face, bays, width in ((SOUTH, BAYS, BAY_M), (NORTH, BAYS, BAY_M), (EAST, 2, WALL_Y), (WEST, 2, WALL_Y)):
        windows = [_window(width * (i + 0.5), sill) for sill in STOREYS_Z for i in range(bays)]
        _storey(made, face, bays * width, windows)
    made.stone += [*_course(0.12, 0.12, COURSE_LOW, COURSE_TOP, topped=True),
                   *_course(EAVES_X - WALL_X, EAVES_Y - WALL_Y, CORNICE_LOW, CORNICE_TOP, topped=False)]
    _roof(made)
    return [
        textured("stonework", made.stone, textures.stone(rng, (172, 160, 138))),
        textured("brickwork", made.brick, textures.brick(rng)),
        textured("panes", made.glass, textures.window(rng)),
        textured("joinery", made.frame, textures.painted_steel(rng, (168, 160, 140))),
        textured("plasterwork", made.plaster, textures.plaster(rng)),
        textured("roof", made.roof, textures.roof_tiles(rng)),
    ]


def _window(middle: float, sill: float, width: float = 1.3, height: float = 2.2) -> Rectangle:
    return middle - width / 2, sill, middle + width / 2, sill + height


def _storey(made: Materials, face: Face, length: float, windows: Sequence[Rectangle]) -> None:
    trims = [trim for window in windows for trim in _trims(window)]
    wall = cells((0.0, COURSE_TOP), (length, CORNICE_LOW), [*windows, *trims])
    made.brick.append(quads(face.place(_at_depth(wall, 0.0))))
    for trim in trims:
        made.stone.append(_local_box(face, trim, 0.0, 0.14, "-z"))
    for window in windows:
        _recess(made, face, window)


def _trims(window: Rectangle) -> list[Rectangle]:
    """Sill and lintel of a window."""
    u0, v0, u1, v1 = window
    return [(u0 - 0.15, v0 - 0.15, u1 + 0.15, v0), (u0 - 0.15, v1, u1 + 0.15, v1 + 0.25)]


def _recess(made: Materials, face: Face, opening: Rectangle) -> None:
    """Reveals, pane and glazing bars of an opening."""
    u0, v0, u1, v1 = opening
    made.stone.append(quads(face.place(_reveals(opening, REVEAL_M))))
    um, vm = (u0 + u1) / 2, v0 + 0.62 * (v1 - v0)
    post, edge = 0.05, 0.08
    bars = {(um - post, v0, um + post, v1): "-y +y -z", (u0, v0, u0 + edge, v1): "-x -y +y -z",
            (u1 - edge, v0, u1, v1): "+x -y +y -z", (u0 + edge, vm - post, um - post, vm + post): "-x +x -z",
            (um + post, vm - post, u1 - edge, vm + post): "-x +x -z"}
    made.glass.append(quads(face.place(_at_depth(cells((u0, v0), (u1, v1), bars), -REVEAL_M))))
    made.frame += [_local_box(face, bar, -REVEAL_M, -REVEAL_M + 0.07, omit) for bar, omit in bars.items()]


def _reveals(opening: Rectangle, depth: float) -> list[list[tuple[float, float, float]]]:
    u0, v0, u1, v1 = opening
    a, b = -depth, 0.0
    return [
        [(u0, v0, a), (u0, v1, a), (u0, v1, b), (u0, v0, b)],
        [(u1, v0, b), (u1, v1, b), (u1, v1, a), (u1, v0, a)],
        [(u0, v0, a), (u0, v0, b), (u1, v0, b), (u1, v0, a)],
        [(u1, v1, a), (u1, v1, b), (u0, v1, b), (u0, v1, a)],
    ]


def _arcade(made: Materials) -> None:
    """The arched wall, outside and inside, the arches' soffits, and the gallery behind."""
    arches = [BAY_M * (i + 0.5) for i in range(BAYS)]
    holes = [(m - ARCH_HALF, 0.0, m + ARCH_HALF, COURSE_LOW) for m in arches]
    piers = cells((0.0, 0.0), (2 * WALL_X, COURSE_LOW), holes)
    made.stone.append(quads(SOUTH.place(_at_depth(piers, 0.0))))
    inner = cells((ARCADE_DEPTH, 0.0), (2 * WALL_X - ARCADE_DEPTH, CEILING),
                  [(u0, v0, u1, CEILING) for u0, v0, u1, _ in holes])
    made.plaster.append(quads(SOUTH.place(_at_depth(inner, -ARCADE_DEPTH)[:, ::-1])))
    for middle in arches:
        made.stone.append(quads(SOUTH.place(_spandrel(middle, COURSE_LOW, 0.0))))
        made.plaster.append(quads(SOUTH.place(_spandrel(middle, CEILING, -ARCADE_DEPTH)[:, ::-1])))
        made.stone.append(quads(SOUTH.place(_intrados(middle))))
    south, north = -WALL_Y + ARCADE_DEPTH, -WALL_Y + GALLERY_DEPTH
    east = WALL_X - ARCADE_DEPTH
    made.plaster.append(plate((-east, south), (east, north), CEILING, facing_up=False))
    made.plaster += [box((east, south, 0.0), (east, north, CEILING), "+x +y -y +z -z"),
                     box((-east, south, 0.0), (-east, north, CEILING), "-x +y -y +z -z")]


def _arch_curve(middle: float) -> Array:
    """(n, 2) intrados from the left springing over the crown to the right."""
    angle = np.linspace(np.pi, 0.0, 17)
    return np.stack([middle + ARCH_HALF * np.cos(angle), SPRINGING + ARCH_HALF * np.sin(angle)], axis=1)


def _spandrel(middle: float, top: float, depth: float) -> Array:
    curve = _arch_curve(middle)
    left, right = curve[:-1], curve[1:]
    above = [np.stack([side[:, 0], np.full(len(side), top)], axis=1) for side in (right, left)]
    return _at_depth(np.stack([left, right, *above], axis=1), depth)


def _intrados(middle: float) -> Array:
    """The underside of an arch and its two jambs, facing into the opening."""
    curve = _arch_curve(middle)
    foot = [np.array([[middle - ARCH_HALF, 0.0]]), np.array([[middle + ARCH_HALF, 0.0]])]
    path = np.concatenate([foot[0], curve, foot[1]])
    left, right = path[:-1], path[1:]
    front, back = np.zeros((len(left), 1)), np.full((len(left), 1), -ARCADE_DEPTH)
    return np.stack([np.hstack([left, front]), np.hstack([left, back]), np.hstack([right, back]),
                     np.hstack([right, front])], axis=1)


def _ground_floor(made: Materials) -> None:
    """The gallery's back wall with doors, and the other three sides of the ground floor."""
    gallery = [_window(BAY_M * (i + 0.5) - ARCADE_DEPTH, 0.0, 1.4, 2.9) for i in range(BAYS)]
    wall = cells((0.0, 0.0), (2 * (WALL_X - ARCADE_DEPTH), CEILING), gallery)
    made.plaster.append(quads(GALLERY.place(_at_depth(wall, 0.0))))
    north = [_window(BAY_M * (i + 0.5), 0.0 if i == BAYS // 2 else 1.3, 1.5, 3.6 if i == BAYS // 2 else 2.2)
             for i in range(BAYS)]
    made.stone.append(quads(NORTH.place(_at_depth(cells((0.0, 0.0), (2 * WALL_X, COURSE_LOW), north), 0.0))))
    for face in (EAST, WEST):
        made.stone.append(quads(face.place(_at_depth(cells((0.0, 0.0), (2 * WALL_Y, COURSE_LOW)), 0.0))))
    for face, openings in ((GALLERY, gallery), (NORTH, north)):
        for opening in openings:
            _recess(made, face, opening)


def _course(out_x: float, out_y: float, low: float, top: float, *, topped: bool) -> list[Solid]:
    """A moulding around the walls: its face, underside and, unless a roof lies on it, its top."""
    lo, hi = (-WALL_X - out_x, -WALL_Y - out_y), (WALL_X + out_x, WALL_Y + out_y)
    walls = (-WALL_X, -WALL_Y, WALL_X, WALL_Y)
    solids = [box((*lo, low), (*hi, top), "-z +z"), plate(lo, hi, low, [walls], facing_up=False)]
    return [*solids, plate(lo, hi, top, [walls])] if topped else solids


def _roof(made: Materials) -> None:
    x, y = EAVES_X, EAVES_Y
    made.roof.append(quads([
        [(-x, -y, CORNICE_TOP), (x, -y, CORNICE_TOP), (x, 0.0, RIDGE), (-x, 0.0, RIDGE)],
        [(x, y, CORNICE_TOP), (-x, y, CORNICE_TOP), (-x, 0.0, RIDGE), (x, 0.0, RIDGE)],
    ]))
    gables = np.array([(x, -y, CORNICE_TOP), (x, y, CORNICE_TOP), (x, 0.0, RIDGE),
                       (-x, y, CORNICE_TOP), (-x, -y, CORNICE_TOP), (-x, 0.0, RIDGE)])
    made.brick.append(planar_mapped(gables, np.array([[0, 1, 2], [3, 4, 5]], np.int32)))
    for chimney in (-18.2, -6.6, 5.0, 16.6):
        made.brick.append(box((chimney, 0.3, 19.3), (chimney + 1.1, 1.1, HEIGHT_M - 0.2), "-z +z"))
        made.stone.append(box((chimney - 0.08, 0.22, HEIGHT_M - 0.2), (chimney + 1.18, 1.18, HEIGHT_M)))


def _at_depth(flat: Array, outward: float) -> Array:
    return np.concatenate([flat, np.full((*flat.shape[:2], 1), outward)], axis=2)


def _local_box(face: Face, rectangle: Rectangle, low: float, high: float, omit: str) -> Solid:
    u0, v0, u1, v1 = rectangle
    return quads(face.place(box_corners((u0, v0, low), (u1, v1, high), omit)))
