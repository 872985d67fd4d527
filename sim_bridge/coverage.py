"""True coverage of the object by exploration pictures, and the most that any reachable view could have covered.

As in MACARONS (Guedon et al., CVPR 2023), coverage is judged by what the pictures could see of the true surface, not by
what was made of them: it measures the choice of views alone.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from missions.camera import Camera
from missions.frames import Array, enu_from_camera
from missions.messages import PictureMeta
from missions.mission import ExploreSpec
from sim_bridge.truth import BEFORE_FLIGHT_NS, Mask, Truth

Indices = NDArray[np.int64]

TOLERANCE_M = 0.02


class Coverage:
    """Which reference points on the object exploration has seen."""

    def __init__(self, truth: Truth, points_enu_m: Array, range_m: float) -> None:
        """points_enu_m (n, 3): spread evenly over the object's exposed surface; beyond range_m nothing is seen."""
        self._truth, self._points, self._range_m = truth, points_enu_m, range_m
        self._seen = np.zeros(len(points_enu_m), dtype=bool)
        self._reachable = np.zeros(len(points_enu_m), dtype=bool)
        self.per_view: list[float] = []
        self.view_ids: list[int] = []

    def add(self, picture: PictureMeta) -> None:
        """Count what an exploration picture sees, from its true pose."""
        unseen = np.flatnonzero(~self._seen)
        eye = np.array(picture.pose.position_enu_m)
        views = picture.pose.enu_from_camera[None]
        self._seen[self._seen_from(eye, views, picture.camera, unseen, picture.t_capture_ns)] = True
        self.per_view.append(float(self._seen.mean()))
        self.view_ids.append(picture.view_id)

    def reach(self, positions_enu_m: Array, explore: ExploreSpec, camera: Camera) -> None:
        """Find what views from these positions (n, 3), in all of the mission's directions, can see together. Boxes
        that appear in flight do not count."""
        views = np.stack([enu_from_camera(2.0 * math.pi * k / explore.azimuths, math.radians(elevation))
                          for elevation in explore.elevations_deg for k in range(explore.azimuths)])
        for position in positions_enu_m:
            candidates = np.flatnonzero(~self._reachable)
            self._reachable[self._seen_from(position, views, camera, candidates, BEFORE_FLIGHT_NS)] = True

    @property
    def ceiling(self) -> float:
        """The share that reachable views can see. What was seen was reachable, also between the lattice's positions."""
        return float((self._reachable | self._seen).mean())

    def summary(self) -> dict[str, object]:
        """The numbers for referee.json; shares are 0-1."""
        final = self.per_view[-1] if self.per_view else 0.0
        auc = float(np.mean(self.per_view)) if self.per_view else 0.0
        return {"final": final, "ceiling": self.ceiling, "auc": auc, "per_view": self.per_view,
                "view_ids": self.view_ids}

    def _seen_from(self, eye_enu_m: Array, enu_from_cameras: Array, camera: Camera, candidates: Indices,
                   t_ns: int) -> Indices:
        """Those candidates, indices of points, that any of some views (k, 3, 3) from one position sees."""
        away = self._points[candidates] - eye_enu_m
        near = np.einsum("ij,ij->i", away, away) <= self._range_m**2
        candidates, away = candidates[near], away[near]
        visible = self._truth.visible(eye_enu_m, self._points[candidates], TOLERANCE_M, t_ns)
        candidates, away = candidates[visible], away[visible]
        framed = np.zeros(len(away), dtype=bool)
        for view in enu_from_cameras:
            framed |= in_frame(away @ view, camera)
        return candidates[framed]


def in_frame(points_camera: Array, camera: Camera) -> Mask:
    """(n,) whether points (n, 3) in camera axes fall into the picture."""
    x, y, z = points_camera.T
    u, v = camera.fx_px * x + camera.cx_px * z, camera.fy_px * y + camera.cy_px * z
    result: Mask = (z > 0) & (u >= 0) & (u <= camera.width_px * z) & (v >= 0) & (v <= camera.height_px * z)
    return result
