"""How a vehicle measures where its survey pictures are taken from: the true pose and seeded Gaussian noise.

The flight itself follows the true poses. What reaches the ground station is the measured pose; the true one stays in
`truth/views.csv`, for the evaluation alone. Exploration pictures carry exact poses: a burst along a leg would be tied
together by visual-inertial odometry, which is not simulated, and independent noise would say the opposite.
"""

from __future__ import annotations

import math

import numpy as np

from missions.camera import Pose
from missions.frames import wrap_pi
from missions.messages import ShutterRequest
from missions.mission import CameraSpec

SURVEY = "survey"


def measured(shutter: ShutterRequest, spec: CameraSpec, seed: int) -> Pose:
    """Each coordinate is off by position_sigma_m, each of yaw, elevation and roll by attitude_sigma_deg; independent of
    every other picture and of the order in which they come."""
    if shutter.phase != SURVEY or (spec.position_sigma_m == 0.0 and spec.attitude_sigma_deg == 0.0):
        return shutter.pose
    rng = np.random.default_rng((seed, shutter.vehicle_id, shutter.t_capture_ns))
    shift = spec.position_sigma_m * rng.standard_normal(3)
    yaw, elevation, roll = math.radians(spec.attitude_sigma_deg) * rng.standard_normal(3)
    true = shutter.pose
    east, north, up = np.array(true.position_enu_m) + shift
    return Pose((float(east), float(north), float(up)), wrap_pi(true.yaw_enu_rad + float(yaw)),
                true.elevation_rad + float(elevation), true.roll_rad + float(roll))
