"""Foxglove's messages out of arrays: poses, lines, boxes, in frame `site`, the mission's ENU frame."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from foxglove import messages as fox

from missions.frames import Array

SITE = "site"
LINE_PX = 2.0
FENCE_COLOUR, OBJECT_COLOUR = (0.84, 0.15, 0.16), (0.5, 0.5, 0.5)
VEHICLE_COLOURS = ((0.12, 0.47, 0.71), (1.0, 0.5, 0.05), (0.17, 0.63, 0.17), (0.58, 0.4, 0.74), (0.55, 0.34, 0.29))
Colour = tuple[float, float, float]


@dataclass(frozen=True)
class Event:
    """One of Foxglove's messages, or a dict for JSON, on a topic at simulated time t_s."""

    t_s: float
    topic: str
    message: Any


class Stamps:
    """Simulated seconds as Foxglove's timestamps."""

    def __init__(self, epoch_s: float) -> None:
        """epoch_s: simulated time zero, in seconds since 1970."""
        self._epoch_ns = round(epoch_s * 1e9)

    def ns(self, t_s: float) -> int:
        """Nanoseconds since 1970."""
        return self._epoch_ns + round(t_s * 1e9)

    def __call__(self, t_s: float) -> fox.Timestamp:
        """The same as a message."""
        return fox.Timestamp(*divmod(self.ns(t_s), 1_000_000_000))


def colour_of(vehicle_id: int) -> Colour:
    """The same colour for everything of a vehicle."""
    return VEHICLE_COLOURS[(vehicle_id - 1) % len(VEHICLE_COLOURS)]


def pose(position_enu_m: Array, quaternion_wxyz: Array) -> fox.Pose:
    """A pose in frame `site`."""
    x, y, z = map(float, position_enu_m)
    return fox.Pose(position=fox.Vector3(x=x, y=y, z=z), orientation=quaternion(quaternion_wxyz))


def quaternion(quaternion_wxyz: Array) -> fox.Quaternion:
    """A rotation."""
    w, x, y, z = map(float, quaternion_wxyz)
    return fox.Quaternion(x=x, y=y, z=z, w=w)


def transform(stamp: fox.Timestamp, child: str, position_enu_m: Array, quaternion_wxyz: Array) -> fox.FrameTransform:
    """Where frame `child` is in frame `site`."""
    x, y, z = map(float, position_enu_m)
    return fox.FrameTransform(timestamp=stamp, parent_frame_id=SITE, child_frame_id=child,
                              translation=fox.Vector3(x=x, y=y, z=z), rotation=quaternion(quaternion_wxyz))


def line(stamp: fox.Timestamp, name: str, points_enu_m: Array, colour: Colour, opacity: float = 1.0) -> fox.SceneUpdate:
    """A line through points (n, 3) that stays until another of this name comes."""
    return _lines(stamp, name, points_enu_m, colour, opacity, fox.LinePrimitiveLineType.LineStrip)


def box(stamp: fox.Timestamp, name: str, lower_enu_m: Array, upper_enu_m: Array, colour: Colour) -> fox.SceneUpdate:
    """The twelve edges of a box."""
    corners = np.array(np.meshgrid(*zip(lower_enu_m, upper_enu_m, strict=True), indexing="ij")).reshape(3, 8).T
    edges = [(a, a | bit) for bit in (1, 2, 4) for a in range(8) if not a & bit]
    return _lines(stamp, name, corners[np.array(edges).ravel()], colour, 1.0, fox.LinePrimitiveLineType.LineList)


def _lines(stamp: fox.Timestamp, name: str, points_enu_m: Array, colour: Colour, opacity: float,
           kind: fox.LinePrimitiveLineType) -> fox.SceneUpdate:
    r, g, b = colour
    points = [fox.Point3(x=float(x), y=float(y), z=float(z)) for x, y, z in points_enu_m]
    primitive = fox.LinePrimitive(type=kind, thickness=LINE_PX, scale_invariant=True, points=points,
                                  color=fox.Color(r=r, g=g, b=b, a=opacity))
    return fox.SceneUpdate(entities=[fox.SceneEntity(timestamp=stamp, frame_id=SITE, id=name, lines=[primitive])])
