"""The true world as geometry: rays and distances against the scene's triangles (Embree) and the boxes of the moment.

Nothing here is ever shown to the ground station or to a vehicle; the referee judges by it.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from missions.camera import Camera, Pose
from missions.clock import SECOND_NS
from missions.frames import Array
from missions.simulation import ObstacleSpec
from missions.triangles import without_slivers
from sim_bridge.open3d_core import o3d

Floats32 = NDArray[np.float32]
Mask = NDArray[np.bool_]

BEFORE_FLIGHT_NS = -1
"""A time at which no obstacle has appeared yet."""
THREADS = 1
"""The other processes of a mission want the remaining cores."""


class Truth:
    """Ray and distance queries. Directions need not be unit vectors: results are in multiples of their length."""

    def __init__(self, vertices_enu_m: Array, faces: NDArray[np.int32], obstacles: Sequence[ObstacleSpec] = ()) -> None:
        """vertices_enu_m (n, 3), faces (m, 3) of the whole scene; obstacles as in the mission file."""
        self._scene = o3d.t.geometry.RaycastingScene(nthreads=THREADS)
        self._scene.add_triangles(_tensor(vertices_enu_m, np.float32), _tensor(faces, np.uint32))
        self._triangles_enu_m = np.asarray(vertices_enu_m, np.float64)[faces]
        self._obstacles = list(obstacles)
        self._center = np.array([o.center_enu_m for o in obstacles]).reshape(-1, 3)
        self._half = 0.5 * np.array([o.size_m for o in obstacles]).reshape(-1, 3)
        self._appears_ns = np.array([o.appears_at_s for o in obstacles]) * SECOND_NS
        self._disappears_ns = np.array([o.disappears_at_s for o in obstacles]) * SECOND_NS

    def obstacles_at(self, t_ns: int) -> list[ObstacleSpec]:
        """The boxes that are in the world at this time."""
        return [o for o, there in zip(self._obstacles, self._present(np.array([t_ns]))[0], strict=True) if there]

    def cast(self, origins_enu_m: Array, directions_enu: Array, max_m: float, t_ns: int) -> Array:
        """(n,) distance along each ray of (n, 3) to the first surface; inf beyond max_m."""
        rays = _rays(origins_enu_m, directions_enu)
        answer = self._scene.cast_rays(_tensor(rays, np.float32), nthreads=THREADS)
        hit = answer["t_hit"].numpy().astype(np.float64)
        for k in np.flatnonzero(self._present(np.array([t_ns]))[0]):
            hit = np.minimum(hit, _box_entry(rays, self._center[k], self._half[k]))
        return np.where(hit <= max_m, hit, np.inf)

    def visible(self, eye_enu_m: Array, points_enu_m: Array, tolerance_m: float, t_ns: int) -> Mask:
        """(n,) whether nothing lies between eye (3,) and points (n, 3), but for the last tolerance_m before each."""
        away = points_enu_m - eye_enu_m
        length = np.linalg.norm(away, axis=1, keepdims=True)
        reach = away * np.clip(1.0 - tolerance_m / np.maximum(length, 1e-9), 0.0, None)
        rays = _rays(np.broadcast_to(eye_enu_m, points_enu_m.shape), reach)
        answer = self._scene.test_occlusions(_tensor(rays, np.float32), tnear=0.0, tfar=1.0, nthreads=THREADS)
        hidden: Mask = answer.numpy()
        for k in np.flatnonzero(self._present(np.array([t_ns]))[0]):
            hidden = hidden | (_box_entry(rays, self._center[k], self._half[k]) <= 1.0)
        return ~hidden

    def distance(self, points_enu_m: Array, t_ns: NDArray[np.int64]) -> Array:
        """(n,) distance of points (n, 3) to the nearest surface at times (n,); 0 inside a box."""
        answer = self._near.compute_distance(_tensor(points_enu_m, np.float32), nthreads=THREADS)
        result: Array = answer.numpy().astype(np.float64)
        present = self._present(t_ns)
        for k in range(len(self._obstacles)):
            outside = np.maximum(np.abs(points_enu_m - self._center[k]) - self._half[k], 0.0)
            result = np.where(present[:, k], np.minimum(result, np.linalg.norm(outside, axis=1)), result)
        return result

    def inside(self, points_enu_m: Array) -> Mask:
        """(n,) whether points (n, 3) lie within closed parts of the scene (majority of three ray parities)."""
        answer = self._scene.compute_occupancy(_tensor(points_enu_m, np.float32), nthreads=THREADS, nsamples=3)
        result: Mask = answer.numpy() > 0.5
        return result

    def depth(self, camera: Camera, pose: Pose, t_ns: int) -> Array:
        """(height, width) true depth along the optical axis through the pixel centres; inf where there is only sky."""
        directions = camera.rays_camera().reshape(-1, 3) @ pose.enu_from_camera.T
        origins = np.broadcast_to(np.array(pose.position_enu_m), directions.shape)
        return self.cast(origins, directions, np.inf, t_ns).reshape(camera.height_px, camera.width_px)

    @cached_property
    def _near(self) -> Any:
        """For distances, which nobody's clock waits for when a bridge takes another's place."""
        near = o3d.t.geometry.RaycastingScene(nthreads=THREADS)
        pieces, _ = without_slivers(self._triangles_enu_m)
        near.add_triangles(_tensor(pieces.reshape(-1, 3), np.float32),
                           _tensor(np.arange(3 * len(pieces)).reshape(-1, 3), np.uint32))
        return near

    def _present(self, t_ns: NDArray[np.int64]) -> Mask:
        t = t_ns[:, None]
        result: Mask = (self._appears_ns <= t) & (t < self._disappears_ns)
        return result


def _tensor(array: NDArray[Any], dtype: type) -> Any:
    return o3d.core.Tensor.from_numpy(np.ascontiguousarray(array, dtype=dtype))


def _rays(origins: Array, directions: Array) -> Floats32:
    return np.concatenate([origins, directions], axis=1, dtype=np.float32)


def _box_entry(rays: Floats32, center: Array, half: Array) -> Array:
    """(n,) ray parameter where rays enter a box (slab method); 0 from within, inf where they miss it."""
    origin, direction = rays[:, :3].astype(np.float64), rays[:, 3:].astype(np.float64)
    with np.errstate(divide="ignore", invalid="ignore"):
        a, b = (center - half - origin) / direction, (center + half - origin) / direction
    near, far = np.fmin(a, b).max(axis=1), np.fmax(a, b).min(axis=1)
    return np.where((near <= far) & (far >= 0.0), np.maximum(near, 0.0), np.inf)
