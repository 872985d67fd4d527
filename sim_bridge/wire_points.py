"""Places on a scene's wires, and places in the object's box with nothing near: the truth of `swarmscan bench wires`."""

from __future__ import annotations

import numpy as np

from missions.frames import Array
from sim_bridge.scenes.scene import Scene, merged
from sim_bridge.truth import BEFORE_FLIGHT_NS, Truth

WIRE_PARTS = ("cable", "conductors")
"""Names of the parts that are wires and ropes."""
POINTS = 1500
ASIDE_M = 0.12
"""Places on wires are off by up to so much along each axis, as places that votes are asked about are."""
EMPTY_M = 1.0


def wire_points(scene: Scene, rng: np.random.Generator) -> Array:
    """(n, 3) places on wires above the ground, by their length; none where the scene has no wires."""
    vertices, faces = merged(part for part in scene.parts if part.name in WIRE_PARTS)
    if not len(faces):
        return np.zeros((0, 3))
    corners = vertices[faces]
    length_m = np.linalg.norm(np.ptp(corners, axis=1), axis=1)
    some = rng.choice(len(faces), POINTS, p=length_m / length_m.sum())
    points = np.einsum("nc,nck->nk", rng.dirichlet((1.0, 1.0, 1.0), POINTS), corners[some])
    points = points[points[:, 2] > scene.ground_up_m + EMPTY_M]
    result: Array = points + rng.uniform(-ASIDE_M, ASIDE_M, points.shape)
    return result


def empty_points(scene: Scene, world: Truth, rng: np.random.Generator) -> Array:
    """(n, 3) places in the object's box, farther than EMPTY_M from everything."""
    points = rng.uniform(scene.object_min_enu_m, scene.object_max_enu_m, (3 * POINTS, 3))
    far = world.distance(points, np.full(len(points), BEFORE_FLIGHT_NS)) > EMPTY_M
    result: Array = points[far & ~world.inside(points)]
    return result
