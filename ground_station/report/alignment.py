"""How the survey's poses were aligned, in numbers, and beside the truth where a simulation left it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from ground_station.report.run_data import RunData, ViewRow, read_views
from perception.reconstruct.aligned_poses import AlignedPose, alignment_numbers, read_poses


def alignment(data: RunData) -> dict[str, Any] | None:
    """The content of alignment.json, with the errors of the measured and of the aligned poses where the truth is known;
    None when nothing was aligned."""
    numbers = alignment_numbers(data.run.alignment)
    if numbers is None:
        return None
    true = {v.view_id: v for v in read_views(data.run.truth_views) if v.phase == "survey"}
    measured = [v for v in data.views if v.phase == "survey"]
    return {**numbers, "error_measured": _error(measured, true),
            "error_aligned": _error(read_poses(data.run.alignment), true)}


def _error(told: Sequence[ViewRow | AlignedPose], true: dict[int, ViewRow]) -> dict[str, float | None]:
    """Mean and largest distance (m) and turn (deg) between poses of the same view; null without truth."""
    pairs = [(p, true[p.view_id]) for p in told if p.view_id in true]
    if not pairs:
        return dict.fromkeys(("position_mean_m", "position_max_m", "attitude_mean_deg", "attitude_max_deg"))
    away = [float(np.linalg.norm(p.position_enu_m - t.position_enu_m)) for p, t in pairs]
    turned = np.degrees([Rotation.from_matrix(p.enu_from_camera.T @ t.enu_from_camera).magnitude() for p, t in pairs])
    return {"position_mean_m": float(np.mean(away)), "position_max_m": max(away),
            "attitude_mean_deg": float(turned.mean()), "attitude_max_deg": float(turned.max())}
