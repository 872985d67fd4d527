"""Vehicles in the 3-D view: body, camera frustum with the latest picture, trail, next leg, tour."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import viser
from numpy.typing import NDArray

from ground_station.live.colours import Rgb, of_vehicle
from ground_station.live.glb import ribbons_glb, unlit_glb
from ground_station.live.trail import Trail
from missions.frames import Array, enu_from_camera, quaternion_from_matrix
from missions.live import LivePicture, LivePlan, LiveVehicle
from missions.messages import Vector

FRUSTUM_SHARE, THUMBNAIL_PX = 1.5, 192
"""Of the vehicle's size."""
BAND_SHARE = 0.05
"""How wide what was flown and what comes later are drawn, of the vehicle's size."""
TRAIL_BLOCK, BLOCKS_APART = 40, 8
"""Corners of a trail in one node that does not change any more; so many of these are joined to one, for a browser
spends some 80 kB on a node, whatever is in it."""
NO_POINTS = np.zeros((0, 2, 3), dtype=np.float32)


@dataclass(frozen=True)
class _Motion:
    """Between two updates: where from, where to."""

    from_enu_m: Array
    to_enu_m: Array


class VehicleInScene:
    """The nodes of one vehicle."""

    def __init__(self, scene: viser.SceneApi, vehicle: LiveVehicle, size_m: float) -> None:
        self._scene, self._name = scene, f"/vehicle_{vehicle.vehicle_id}"
        self.colour, self._size_m = of_vehicle(vehicle.vehicle_id), size_m
        at = np.array(vehicle.position_enu_m)
        self._motion = _Motion(at, at)
        self._root = scene.add_frame(self._name, show_axes=False, position=at)
        self._body = scene.add_glb(f"{self._name}/body", unlit_glb(*drone_mesh(self.colour, size_m)),
                                   cast_shadow=False, receive_shadow=False)
        scene.add_label(f"{self._name}/label", str(vehicle.vehicle_id), position=(0.0, 0.0, 0.8 * size_m),
                        anchor="bottom-center")
        self._frustum: viser.CameraFrustumHandle | None = None
        self._shown: tuple[int, int] | None = None
        self._trail_end: tuple[int, Vector] | None = None
        self._trail_thinned = 0
        self._blocks: dict[tuple[int, int], viser.GlbHandle] = {}
        self._trail_visible = True
        self._plan: LivePlan | None = None
        self._next_waypoint = -1
        self._leg = self._lines("leg", 4.0, _lighter(self.colour, 0.35))
        self._ahead = self._lines("plan", 2.0, _lighter(self.colour, 0.2))
        self._recent = self._lines("recent", 1.6, _darker(self.colour, 0.85))
        self._later: viser.GlbHandle | None = None
        self._tour_visible = True

    def take(self, vehicle: LiveVehicle, plan: LivePlan | None, trail: Trail) -> None:
        """A newer state."""
        self._motion = _Motion(np.array(self._root.position), np.array(vehicle.position_enu_m))
        self._body.wxyz = (math.cos(vehicle.yaw_enu_rad / 2.0), 0.0, 0.0, math.sin(vehicle.yaw_enu_rad / 2.0))
        if self._frustum is not None:
            self._frustum.wxyz = quaternion_from_matrix(
                enu_from_camera(vehicle.yaw_enu_rad, vehicle.gimbal_elevation_rad))
            self._frustum.visible = vehicle.flying
        if len(trail) and (len(trail.corners), trail.points[-1]) != self._trail_end:
            self._draw_trail(trail)
        if plan is not None and (plan is not self._plan or vehicle.next_waypoint != self._next_waypoint):
            self._draw_plan(plan, vehicle)

    def move(self, share: float) -> None:
        """So much of the way to the newest position."""
        m = self._motion
        if not np.array_equal(self._root.position, m.to_enu_m):
            self._root.position = m.from_enu_m + min(share, 1.0) * (m.to_enu_m - m.from_enu_m)

    def show_picture(self, picture: LivePicture) -> None:
        """The latest picture, in the frustum."""
        if self._shown == (picture.vehicle_id, picture.view_id):
            return
        image = thumbnail(picture)
        if image is None:
            return
        self._shown = picture.vehicle_id, picture.view_id
        camera = picture.camera
        if self._frustum is None:
            self._frustum = self._scene.add_camera_frustum(
                f"{self._name}/camera", fov=2.0 * math.atan(0.5 * camera.height_px / camera.fy_px),
                aspect=camera.width_px / camera.height_px, scale=FRUSTUM_SHARE * self._size_m,
                color=self.colour, image=image, thickness=1.5, thickness_units="screen", cast_shadow=False,
                receive_shadow=False, wxyz=quaternion_from_matrix(picture.pose.enu_from_camera))
        else:
            self._frustum.image = image

    def show_trail(self, visible: bool) -> None:
        """Show or hide where it was."""
        self._trail_visible = self._recent.visible = visible
        for node in self._blocks.values():
            node.visible = visible

    # Nodes lie under a common parent: what is at the top is a row of viser's own table in every browser.

    def _lines(self, what: str, width_px: float, colour: Rgb) -> viser.LineSegmentsHandle:
        return self._scene.add_line_segments(f"/ways{self._name}/{what}", NO_POINTS, colour, thickness=width_px,
                                             thickness_units="screen")

    def _band(self, what: str, segments: NDArray[np.float32], share: float, visible: bool) -> viser.GlbHandle:
        glb = ribbons_glb(segments, _darker(self.colour, share), BAND_SHARE * self._size_m)
        return self._scene.add_glb(f"/ways{self._name}/{what}", glb, cast_shadow=False, receive_shadow=False,
                                   visible=visible)

    def _draw_trail(self, trail: Trail) -> None:
        """The end as a line that is sent anew; whole blocks before them once, joined as they get many; all
        again where the trail has been thinned."""
        corners, thinned = trail.corners, trail.thinned != self._trail_thinned
        self._trail_end, self._trail_thinned = (len(corners), trail.points[-1]), trail.thinned
        whole = max(0, len(corners) - 1) // TRAIL_BLOCK
        joined = whole - whole % BLOCKS_APART
        ends = [*range(joined, whole + 1)] if joined == 0 else [0, *range(joined, whole + 1)]
        wanted = [(TRAIL_BLOCK * a, TRAIL_BLOCK * b) for a, b in pairwise(ends)]
        for part in [p for p in self._blocks if thinned or p not in wanted]:
            self._blocks.pop(part).remove()
        for first, last in [p for p in wanted if p not in self._blocks]:
            segments = _segments(corners[first:last + 1])
            self._blocks[first, last] = self._band(f"trail/{first}", segments, 0.85, self._trail_visible)
        self._recent.points = _segments(trail.points[whole * TRAIL_BLOCK:])

    def _draw_plan(self, plan: LivePlan, vehicle: LiveVehicle) -> None:
        """The leg from where it begins, the rest of the plan, and, once per plan, what comes later."""
        ahead = plan.waypoints_enu_m[vehicle.next_waypoint:]
        self._leg.points = _segments([vehicle.position_enu_m, *ahead[:1]])
        self._ahead.points = _segments(ahead)
        if plan is not self._plan:
            later = _segments([*plan.waypoints_enu_m[-1:], *plan.later_enu_m])
            if self._later is not None:
                self._later.remove()
            self._later = self._band("later", later, 0.7, self._tour_visible) if len(later) else None
        self._plan, self._next_waypoint = plan, vehicle.next_waypoint

    def show_tour(self, visible: bool) -> None:
        """Show or hide what it is to fly."""
        self._tour_visible = self._ahead.visible = visible
        if self._later is not None:
            self._later.visible = visible


def thumbnail(picture: LivePicture, width_px: int = THUMBNAIL_PX) -> NDArray[np.uint8] | None:
    """A small (h, w, 3) RGB of a picture; None where the file cannot be read here."""
    if not Path(picture.file).is_file():
        return None
    scale = cv2.IMREAD_REDUCED_COLOR_4 if picture.camera.width_px >= 4 * width_px else cv2.IMREAD_COLOR
    image = cv2.imread(picture.file, scale)
    if image is None:
        return None
    height = round(width_px * image.shape[0] / image.shape[1])
    small = cv2.resize(image, (width_px, height), interpolation=cv2.INTER_AREA)
    return np.ascontiguousarray(small[..., ::-1]).astype(np.uint8)


def drone_mesh(colour: Rgb, size_m: float) -> tuple[NDArray[np.float32], NDArray[np.uint32], NDArray[np.uint8]]:
    """A quadrotor with its nose to +x: vertices (v, 3), triangles (f, 3), colours (v, 3)."""
    vertices: list[Array] = []
    faces: list[NDArray[np.int64]] = []
    colours: list[NDArray[np.uint8]] = []

    def add(points: Array, triangles: NDArray[np.int64], rgb: Rgb) -> None:
        faces.append(triangles + sum(map(len, vertices)))
        vertices.append(points)
        colours.append(np.tile(np.array(rgb, dtype=np.uint8), (len(points), 1)))

    for x, y in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
        angles = np.linspace(0.0, 2.0 * math.pi, 13)[:-1]
        hub = 0.36 * size_m * np.array([x, y, 0.3])
        ring = hub + 0.24 * size_m * np.stack([np.cos(angles), np.sin(angles), 0.0 * angles], axis=1)
        fan = np.array([(0, 1 + n, 1 + (n + 1) % 12) for n in range(12)])
        both = np.concatenate([fan, fan[:, ::-1]])
        add(np.vstack([hub, ring]), both, _lighter(colour, 0.45) if x > 0 else colour)
    body = np.array([(i, j, k) for i in (-0.3, 0.34) for j in (-0.13, 0.13) for k in (-0.08, 0.1)]) * size_m
    quads = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
    for shade, quad in zip((0.6, 1.0, 0.75, 0.75, 0.5, 0.9), quads, strict=True):
        add(body[list(quad)], np.array([(0, 1, 2), (0, 2, 3)]), _darker((235, 240, 245), shade))
    return (np.concatenate(vertices).astype(np.float32), np.concatenate(faces).astype(np.uint32),
            np.concatenate(colours))


def _segments(points: list[Vector]) -> NDArray[np.float32]:
    """(n - 1, 2, 3) of a polyline."""
    if len(points) < 2:
        return NO_POINTS
    line = np.array(points, dtype=np.float32)
    return np.stack([line[:-1], line[1:]], axis=1)


def _lighter(colour: Rgb, share: float) -> Rgb:
    r, g, b = (round(c + share * (255 - c)) for c in colour)
    return r, g, b


def _darker(colour: Rgb, share: float) -> Rgb:
    r, g, b = (round(share * c) for c in colour)
    return r, g, b
