"""What a multirotor draws from its battery while it moves: rotor theory, fitted to a published multirotor.

Thrust carries weight, inertia and drag: T = m (a - g) + D with D = 1/2 rho f |u| u at airspeed u = velocity - wind.
With n the direction of thrust, u_n = u . n the flow through the rotors' disks and u_p the flow along them, and
kappa = T / W the load against hovering without payload,

    P = P_base + P_profile (kappa^(3/2) + 3 kappa^(1/2) u_p^2 / U_tip^2) + (T u_n + 1.1 T v) / efficiency

where the induced velocity v solves v sqrt(u_p^2 + (u_n + v)^2) = T / (2 rho A). T u_n holds what drag, climbing and
speeding up take, and what descending and braking give back. Nothing flows back into the battery.

Sources: Zeng, Xu and Zhang, "Energy minimization for wireless communication with rotary-wing UAV", IEEE Transactions on
Wireless Communications 18(4), 2019 (blade profile, induced and parasite power with the load kappa; 1 + k = 1.1); Liu,
Sengupta and Kurek, "A power consumption model for multi-rotor small unmanned aircraft systems", ICUAS 2017 (profile
power by T^(3/2) and V^2 T^(1/2), climb inside the induced term). Both follow Glauert's momentum theory, solved here for
any direction of flow. Descents faster than the induced velocity of hovering (vortex ring state) have no solution there:
they are given the induced velocity of that descent.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.optimize import root

from missions.errors import UserError
from missions.frames import Array
from missions.mission import AirframeSpec

GRAVITY_M_S2 = 9.80665
AIR_KG_M3 = 1.225
INDUCED_FACTOR = 1.1
TIP_SPEED_M_S = 70.0
"""Of a 6 inch propeller at 8800 rpm. Not published; at 11 m/s it adds 8 % of profile power, which the fit makes up."""
NEWTON_STEPS = 12


@dataclass(frozen=True)
class PowerModel:
    """The constants of one multirotor; profile power, efficiency and drag come from `fit`."""

    mass_kg: float
    rated_mass_kg: float
    """Without payload."""
    disk_m2: float
    base_w: float
    profile_w: float
    """Of the rotors hovering without payload."""
    efficiency: float
    """Of battery, motors and rotors together, but for the profile power."""
    drag_m2: float
    """Drag coefficient times area."""
    tip_speed_m_s: float = TIP_SPEED_M_S
    """Of the rotors hovering without payload."""

    def power_w(self, velocity_enu_m_s: Array, acceleration_enu_m_s2: Array, wind_enu_m_s: Array) -> Array:
        """Watts (...) out of the battery at velocities and accelerations (..., 3) over ground in a steady wind (3,)."""
        air = np.asarray(velocity_enu_m_s, dtype=np.float64) - wind_enu_m_s
        drag = 0.5 * AIR_KG_M3 * self.drag_m2 * np.linalg.norm(air, axis=-1, keepdims=True) * air
        thrust = self.mass_kg * np.asarray(acceleration_enu_m_s2, dtype=np.float64) + drag
        thrust[..., 2] += self.mass_kg * GRAVITY_M_S2
        force = np.linalg.norm(thrust, axis=-1)
        through = np.einsum("...i,...i->...", air, thrust) / np.maximum(force, 1e-9)
        along2 = np.maximum(np.einsum("...i,...i->...", air, air) - through * through, 0.0)
        load = force / (self.rated_mass_kg * GRAVITY_M_S2)
        profile = self.profile_w * np.sqrt(load) * (load + 3.0 * along2 / self.tip_speed_m_s**2)
        induced = INDUCED_FACTOR * induced_m_s(force / (2.0 * AIR_KG_M3 * self.disk_m2), through, along2)
        return np.asarray(self.base_w + profile + np.maximum(force * (through + induced), 0.0) / self.efficiency)

    def cruise_w(self, airspeed_m_s: Array | float) -> Array:
        """Watts (...) in level flight in still air at constant speeds (...)."""
        speed = np.asarray(airspeed_m_s, dtype=np.float64)
        return self.power_w(speed[..., None] * np.array([1.0, 0.0, 0.0]), np.zeros(3), np.zeros(3))


def induced_m_s(hover2: Array, through_m_s: Array, along2: Array) -> Array:
    """(...) velocity that the rotors add to the air: v^2 (along^2 + (through + v)^2) = hover2^2.

    hover2: square of the induced velocity at this thrust without any flow; along2: square of the flow along the disks.
    Newton's method from above, a fixed number of steps.
    """
    hover = np.sqrt(hover2)
    through = np.maximum(through_m_s, -hover)
    v = hover + np.maximum(-through, 0.0)
    for _ in range(NEWTON_STEPS):
        rest = along2 + (through + v) ** 2
        slope = 2.0 * v * (rest + v * (through + v))
        v = v - (v * v * rest - hover2 * hover2) / np.maximum(slope, 1e-12)
    return np.asarray(v)


@lru_cache(maxsize=16)
def fit(airframe: AirframeSpec) -> PowerModel:
    """The model in which hovering, the longest and the farthest flight last exactly as long as published.

    Three figures give three constants: profile power, efficiency and drag area. Raises UserError when no model of this
    kind meets the figures.
    """
    disk = airframe.rotors * math.pi * (airframe.rotor_diameter_m / 2.0) ** 2
    speeds, watts = published(airframe)
    share = max(watts[0] - airframe.base_load_w, 0.0)
    start = PowerModel(airframe.mass_kg, airframe.mass_kg, disk, airframe.base_load_w, 0.5 * share, 0.6,
                       0.025 * airframe.mass_kg ** (2.0 / 3.0))
    scale = np.array([start.profile_w, start.efficiency, start.drag_m2])

    def model(x: Array) -> PowerModel:
        profile, efficiency, drag = (float(c) for c in scale * x)
        return replace(start, profile_w=profile, efficiency=efficiency, drag_m2=drag)

    found = root(lambda x: model(x).cruise_w(speeds) / watts - 1.0, np.ones(3), tol=1e-12) if share > 0.0 else None
    if found is None or np.abs(found.fun).max() > 1e-6 or np.any(found.x <= 0.0) or scale[1] * found.x[1] > 1.0:
        raise UserError("airframe: no power model meets hover_min, endurance_min and range_km together; correct the "
                        "figures or lower airframe.base_load_w.")
    return replace(model(found.x), mass_kg=airframe.mass_kg + airframe.payload_kg)


def published(airframe: AirframeSpec) -> tuple[Array, Array]:
    """Speeds (3,) m/s of hovering, the longest and the farthest flight, and the mean power (3,) W that empties the
    battery in their time."""
    hours = np.array([airframe.hover_min / 60.0, airframe.endurance_min / 60.0,
                      airframe.range_km / (3.6 * airframe.range_m_s)])
    return np.array([0.0, airframe.endurance_m_s, airframe.range_m_s]), airframe.battery_wh / hours
