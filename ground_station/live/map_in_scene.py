"""The structure as mapped so far, and what stands around it: ground, fence, pads, marked regions."""

from __future__ import annotations

from itertools import product

import numpy as np
import viser
from numpy.typing import NDArray

from ground_station.live import colours
from ground_station.live.colours import Rgb
from ground_station.live.glb import lines_glb, unlit_glb
from ground_station.live.model import LiveModel
from ground_station.live.sightings import Sightings
from ground_station.live.surface import BOX_CORNERS, Block, open_faces
from missions.frames import Array
from missions.live import LivePicture, LiveRegion, LiveSite, LiveState
from missions.messages import Vector

DETAIL = {"low": 5_000, "normal": 14_000, "high": 60_000}
"""Faces that are drawn at most."""
COLOURS = (*colours.PICTURES, "height")
GRID_M, GROUND = 10.0, (46, 62, 80)
EXPLORE_RANGE_M = 25.0
REGION_OPACITY = 0.16


class MapInScene:
    """The surface: sent block by block, and only the blocks that have changed."""

    def __init__(self, scene: viser.SceneApi) -> None:
        self._scene = scene
        self.detail, self.colour = "normal", "pictures"
        self._sightings = Sightings()
        self._drawn: dict[Block, tuple[bytes, viser.GlbHandle]] = {}
        self._index = np.zeros((0, 3), dtype=np.int64)
        self._origin_enu_m, self._voxel_m = np.zeros(3), 1.0

    def take(self, solid: NDArray[np.int64], model: LiveModel) -> None:
        """The map is now these voxels (n, 3), in rising order, with the pictures of a model."""
        assert model.site is not None, "a model with a map has a site"
        self._index, self._origin_enu_m, self._voxel_m = solid, np.array(model.origin_enu_m), model.voxel_m
        centers = self._origin_enu_m + (solid + 0.5) * model.voxel_m
        ranges = {"explore": EXPLORE_RANGE_M, "survey": model.site.survey_range_m}
        self._sightings.take(solid, centers, list(model.pictures), model.voxel_m, ranges)
        self.draw()

    def draw(self) -> None:
        """Send the blocks that look different from what the clients have."""
        faces = open_faces(self._index, self._colours(), self._voxel_m, DETAIL[self.detail])
        new = {block: unlit_glb(vertices, triangles, colour)
               for block, vertices, triangles, colour in faces.blocks(self._origin_enu_m)}
        for block in [b for b in self._drawn if b not in new]:
            self._drawn.pop(block)[1].remove()
        for block, glb in new.items():
            if block not in self._drawn or self._drawn[block][0] != glb:
                name = "/map/" + "_".join(map(str, block))
                handle = self._scene.add_glb(name, glb, cast_shadow=False, receive_shadow=False)
                self._drawn[block] = glb, handle

    def hit(self, start_enu_m: Array, direction_enu: Array) -> Array | None:
        """(3,) where a ray meets the map first; None where it does not."""
        low = self._origin_enu_m + self._index * self._voxel_m
        step = np.where(np.abs(direction_enu) < 1e-9, 1e-9, direction_enu)
        walls = (low - start_enu_m) / step, (low + self._voxel_m - start_enu_m) / step
        enter, leave = np.minimum(*walls).max(axis=1), np.maximum(*walls).min(axis=1)
        ways = np.where((enter <= leave) & (enter > 0.0), enter, np.inf)
        nearest = float(ways.min(initial=np.inf))
        return start_enu_m + nearest * direction_enu if np.isfinite(nearest) else None

    def seen_by(self, point_enu_m: Array) -> list[LivePicture]:
        """Pictures that show a point, the nearest first."""
        return self._sightings.seen_by(point_enu_m)

    def _colours(self) -> NDArray[np.uint8]:
        if self.colour == "height":
            return colours.by_height(self._index[:, 2].astype(np.float64))
        return colours.by_pictures(self._sightings.count[:, COLOURS.index(self.colour)], self.colour)


class Surroundings:
    """Ground, pads, the object's box, the fence and the regions, as lines."""

    def __init__(self, scene: viser.SceneApi, site: LiveSite) -> None:
        self._scene = scene
        low, high = np.array(site.fence_lower_enu_m), np.array(site.fence_upper_enu_m)
        self._lines("/ground", _ground(low, high, site.ground_up_m), GROUND)
        self._lines("/object", box_edges(site.object_lower_enu_m, site.object_upper_enu_m), colours.BOX)
        for k, pad in enumerate(site.pads_enu_m):
            x, y, _ = pad
            size, up = 0.9, site.ground_up_m + 0.05
            self._lines(f"/pad_{k + 1}", box_edges((x - size, y - size, up), (x + size, y + size, up)),
                        colours.of_vehicle(k + 1))
        self._fence: tuple[Vector, Vector] | None = None
        self._regions: dict[int, list[viser.SceneNodeHandle]] = {}

    def take(self, state: LiveState) -> None:
        """A newer state."""
        fence = state.fence_lower_enu_m, state.fence_upper_enu_m
        if fence != self._fence:
            self._fence = fence
            self._lines("/fence", box_edges(*fence), colours.FENCE)
        present = {r.region_id: r for r in state.regions}
        for gone in self._regions.keys() - present.keys():
            for node in self._regions.pop(gone):
                node.remove()
        for region_id in present.keys() - self._regions.keys():
            self._regions[region_id] = self._region(present[region_id])

    def _region(self, region: LiveRegion) -> list[viser.SceneNodeHandle]:
        colour = colours.IMPORTANT if region.kind == "important" else colours.FORBIDDEN
        name = f"/region_{region.region_id}"
        solid = self._scene.add_glb(f"{name}_box", _box_glb(region, colour), cast_shadow=False, receive_shadow=False)
        edges = self._scene.add_line_segments(f"{name}_edges", box_edges(region.lower_enu_m, region.upper_enu_m),
                                              colour, thickness=2.5, thickness_units="screen")
        return [solid, edges]

    def _lines(self, name: str, segments: NDArray[np.float32], colour: Rgb) -> None:
        self._scene.add_glb(name, lines_glb(segments, colour), cast_shadow=False, receive_shadow=False)


def box_edges(lower: Vector, upper: Vector) -> NDArray[np.float32]:
    """(12, 2, 3) the edges of a box."""
    corners = np.array(list(product((0, 1), repeat=3)))
    pairs = [(i, j) for i in range(8) for j in range(i) if np.abs(corners[i] - corners[j]).sum() == 1]
    low, high = np.array(lower), np.array(upper)
    return np.asarray(low + corners[np.array(pairs)] * (high - low), dtype=np.float32)


def _box_glb(region: LiveRegion, colour: Rgb) -> bytes:
    """A box that one can look through."""
    low, high = np.array(region.lower_enu_m), np.array(region.upper_enu_m)
    corners = (low + BOX_CORNERS.reshape(-1, 3) * (high - low)).astype(np.float32)
    first = 4 * np.arange(6, dtype=np.uint32)[:, None]
    faces = np.concatenate([first + np.array([0, 1, 2], np.uint32), first + np.array([0, 2, 3], np.uint32)])
    return unlit_glb(corners, faces, np.tile(np.array(colour, np.uint8), (len(corners), 1)), REGION_OPACITY)


def _ground(lower: Array, upper: Array, up_m: float) -> NDArray[np.float32]:
    """A square grid of lines over the fence's floor."""
    xs, ys = (np.arange(np.ceil(lower[a] / GRID_M) * GRID_M, upper[a], GRID_M) for a in (0, 1))
    lines = [((x, lower[1], up_m), (x, upper[1], up_m)) for x in xs] + [
        ((lower[0], y, up_m), (upper[0], y, up_m)) for y in ys]
    return np.array(lines, dtype=np.float32).reshape(-1, 2, 3)
