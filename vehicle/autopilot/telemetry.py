"""What a vehicle tells of itself: one function per MAVLink message, and the table of how often each is sent."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from pymavlink.dialects.v20 import common as mav

from missions.frames import heading_deg_from_yaw_enu, ned_from_enu
from missions.mavlink import AUTOPILOT_COMPONENT
from missions.messages import vector
from vehicle.autopilot.craft import MISSION, Craft
from vehicle.autopilot.obstacle_distance import obstacle_distance
from vehicle.autopilot.payload import CAMERA_COMPONENT, GIMBAL_COMPONENT, gimbal_attitude, gimbal_status
from vehicle.dialects import Dialect, Mode
from vehicle.failsafe_table import Action, Trigger
from vehicle.modes import (
    DESCEND,
    EMERGENCY,
    GUIDED,
    HOLD,
    LAND,
    OFFBOARD,
    RETURN,
    STANDBY,
    TAKEOFF,
)
from vehicle.modes import MISSION as ON_MISSION
from vehicle.simulator import Kinematics

SENSORS = (mav.MAV_SYS_STATUS_SENSOR_3D_GYRO | mav.MAV_SYS_STATUS_SENSOR_3D_ACCEL | mav.MAV_SYS_STATUS_SENSOR_3D_MAG
           | mav.MAV_SYS_STATUS_SENSOR_GPS | mav.MAV_SYS_STATUS_SENSOR_BATTERY | mav.MAV_SYS_STATUS_GEOFENCE
           | mav.MAV_SYS_STATUS_PREARM_CHECK)
UNWELL = {Trigger.POSITION_INVALID: mav.MAV_SYS_STATUS_SENSOR_GPS,
          Trigger.FENCE_BREACHED: mav.MAV_SYS_STATUS_GEOFENCE,
          Trigger.BATTERY_UNKNOWN: mav.MAV_SYS_STATUS_SENSOR_BATTERY}
LANDED = {STANDBY: mav.MAV_LANDED_STATE_ON_GROUND, TAKEOFF: mav.MAV_LANDED_STATE_TAKEOFF,
          LAND: mav.MAV_LANDED_STATE_LANDING, DESCEND: mav.MAV_LANDED_STATE_LANDING,
          EMERGENCY: mav.MAV_LANDED_STATE_LANDING}
_SHOWN: dict[str, Mode] = {TAKEOFF: "takeoff", ON_MISSION: "mission", HOLD: "hold", GUIDED: "guided",
                           OFFBOARD: "offboard", RETURN: "return", LAND: "land", DESCEND: "land", EMERGENCY: "land"}
_STAND_IN: dict[Mode, Mode] = {"takeoff": "guided", "guided": "hold", "offboard": "guided"}
"""What a dialect without a mode shows for it."""
CELLS, CELL_FULL_MV, CELL_EMPTY_MV = 2, 4200, 3500


@dataclass(frozen=True)
class Sight:
    """What is to be told: the craft at one instant, and how this face speaks."""

    craft: Craft
    dialect: Dialect
    selected: Mode
    """The mode chosen on the ground."""
    now: Kinematics
    t_ns: int
    unix_us: int

    @property
    def ms(self) -> int:
        """Milliseconds since the mission began."""
        return self.t_ns // 1_000_000

    @property
    def percent(self) -> int:
        """Charge, rounded up, so that it is never said to be empty before it is."""
        return math.ceil(self.craft.executor.battery.level_percent)


def shown_mode(executor_mode: str, idle: bool, selected: Mode, dialect: Dialect) -> int:
    """The custom_mode that stands for what the vehicle does."""
    hovering: Mode = "guided" if selected == "guided" else "hold"
    mode: Mode = selected if executor_mode == STANDBY else hovering if idle else _SHOWN[executor_mode]
    while mode not in dialect.mode_numbers:
        mode = _STAND_IN[mode]
    return dialect.mode_numbers[mode]


def heartbeat(s: Sight) -> mav.MAVLink_message:
    """HEARTBEAT of the autopilot."""
    executor = s.craft.executor
    base = mav.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | mav.MAV_MODE_FLAG_AUTO_ENABLED
    base |= mav.MAV_MODE_FLAG_SAFETY_ARMED if executor.armed else 0
    state = mav.MAV_STATE_ACTIVE if executor.flying else mav.MAV_STATE_STANDBY
    if executor.mode == EMERGENCY:
        state = mav.MAV_STATE_EMERGENCY
    elif executor.flying and (s.craft.action >= Action.HOLD
                              or executor.battery.level_percent <= executor.threshold_percent):
        state = mav.MAV_STATE_CRITICAL
    return mav.MAVLink_heartbeat_message(mav.MAV_TYPE_QUADROTOR, s.dialect.autopilot, base,
                                         shown_mode(executor.mode, executor.idle, s.selected, s.dialect), state, 3)


def sys_status(s: Sight) -> mav.MAVLink_message:
    """SYS_STATUS: sensors are well unless the failsafe sees otherwise; PREARM_CHECK says whether it may take off."""
    executor = s.craft.executor
    ready = executor.flying or executor.ready
    health = SENSORS if ready else SENSORS & ~mav.MAV_SYS_STATUS_PREARM_CHECK
    for trigger, sensor in UNWELL.items():
        health &= ~sensor if trigger in s.craft.amiss else ~0
    return mav.MAVLink_sys_status_message(SENSORS, SENSORS, health, 0, CELLS * _cell_mv(s), -1, s.percent,
                                          0, 0, 0, 0, 0, 0)


def battery_status(s: Sight) -> mav.MAVLink_message:
    """BATTERY_STATUS; the time remaining is that of hovering."""
    executor = s.craft.executor
    left_s = round(s.craft.endurance_s * executor.battery.level_percent / 100.0)
    return mav.MAVLink_battery_status_message(
        0, mav.MAV_BATTERY_FUNCTION_ALL, mav.MAV_BATTERY_TYPE_LIPO, 32767, [_cell_mv(s)] * CELLS + [65535] * 8, -1, -1,
        -1, s.percent, left_s, charge_state(s.craft), [0] * 4)


def charge_state(craft: Craft) -> int:
    """MAV_BATTERY_CHARGE_STATE."""
    executor = craft.executor
    if executor.mode == EMERGENCY:
        return int(mav.MAV_BATTERY_CHARGE_STATE_EMERGENCY)
    if craft.amiss & {Trigger.BATTERY_CRITICAL, Trigger.ENERGY_HOME}:
        return int(mav.MAV_BATTERY_CHARGE_STATE_CRITICAL)
    low = executor.battery.level_percent <= executor.threshold_percent
    return int(mav.MAV_BATTERY_CHARGE_STATE_LOW if low else mav.MAV_BATTERY_CHARGE_STATE_OK)


def fence_status(s: Sight) -> mav.MAVLink_message | None:
    """FENCE_STATUS, while the geofence makes the vehicle do something."""
    breached = Trigger.FENCE_BREACHED in s.craft.amiss
    if not breached and Trigger.FENCE_AHEAD not in s.craft.amiss:
        return None
    return mav.MAVLink_fence_status_message(int(breached), int(breached), mav.FENCE_BREACH_BOUNDARY, s.ms)


def _cell_mv(s: Sight) -> int:
    """A straight line between full and empty: the simulated battery has no cells."""
    return round(CELL_EMPTY_MV + (CELL_FULL_MV - CELL_EMPTY_MV) * s.craft.executor.battery.level_percent / 100.0)


def extended_sys_state(s: Sight) -> mav.MAVLink_message:
    """EXTENDED_SYS_STATE."""
    return mav.MAVLink_extended_sys_state_message(mav.MAV_VTOL_STATE_UNDEFINED,
                                                  LANDED.get(s.craft.executor.mode, mav.MAV_LANDED_STATE_IN_AIR))


def mission_current(s: Sight) -> mav.MAVLink_message:
    """MISSION_CURRENT. A plan counts from the home position where the dialect has it there."""
    plan, executor = s.craft.shelves[MISSION], s.craft.executor
    first = int(s.dialect.item_zero_is_home)
    if not plan.items:
        return mav.MAVLink_mission_current_message(0, 65535 if s.dialect.streams_unasked else 0,
                                                   mav.MISSION_STATE_NO_MISSION)
    states = {ON_MISSION: mav.MISSION_STATE_ACTIVE, HOLD: mav.MISSION_STATE_PAUSED, GUIDED: mav.MISSION_STATE_PAUSED}
    state = states.get(executor.mode, mav.MISSION_STATE_NOT_STARTED)
    if executor.progress.route is not None and not executor.progress.left:
        state = mav.MISSION_STATE_COMPLETE
    return mav.MAVLink_mission_current_message(plan.current + first, len(plan.items), state)


def global_position_int(s: Sight) -> mav.MAVLink_message:
    """GLOBAL_POSITION_INT."""
    velocity = [round(100.0 * float(c)) for c in ned_from_enu(s.now.state.velocity)]
    return mav.MAVLink_global_position_int_message(s.ms, *s.craft.geodetic(vector(s.now.state.position)), *velocity,
                                                   round(_heading_deg(s) * 100) % 36000)


def local_position_ned(s: Sight) -> mav.MAVLink_message:
    """LOCAL_POSITION_NED, from the mission's origin."""
    p, v = ned_from_enu(s.now.state.position), ned_from_enu(s.now.state.velocity)
    return mav.MAVLink_local_position_ned_message(s.ms, *(float(c) for c in (*p, *v)))


def attitude(s: Sight) -> mav.MAVLink_message:
    """ATTITUDE: the kinematic body never tilts."""
    return mav.MAVLink_attitude_message(s.ms, 0.0, 0.0, _yaw_ned_rad(s), 0.0, 0.0, 0.0)


def attitude_quaternion(s: Sight) -> mav.MAVLink_message:
    """ATTITUDE_QUATERNION, likewise."""
    half = 0.5 * _yaw_ned_rad(s)
    return mav.MAVLink_attitude_quaternion_message(s.ms, math.cos(half), 0.0, 0.0, math.sin(half), 0.0, 0.0, 0.0)


def gps_raw_int(s: Sight) -> mav.MAVLink_message:
    """GPS_RAW_INT of the simulated receiver: an RTK fix."""
    lat, lon, alt, _ = s.craft.geodetic(vector(s.now.state.position))
    vx, vy, _ = (float(c) for c in ned_from_enu(s.now.state.velocity))
    course = round(100.0 * math.degrees(math.atan2(vy, vx))) % 36000
    return mav.MAVLink_gps_raw_int_message(s.t_ns // 1000, mav.GPS_FIX_TYPE_RTK_FIXED, lat, lon, alt, 60, 80,
                                           round(100.0 * math.hypot(vx, vy)), course, 18)


def vfr_hud(s: Sight) -> mav.MAVLink_message:
    """VFR_HUD."""
    speed = float(math.hypot(*s.now.state.velocity[:2]))
    alt = s.craft.geodetic(vector(s.now.state.position))[2] / 1000.0
    return mav.MAVLink_vfr_hud_message(speed, speed, round(_heading_deg(s)) % 360, 50 * s.craft.executor.flying, alt,
                                       float(s.now.state.velocity[2]))


def altitude(s: Sight) -> mav.MAVLink_message:
    """ALTITUDE: above the site's ellipsoid and above home; nothing is known of the terrain."""
    alt, above = (mm / 1000.0 for mm in s.craft.geodetic(vector(s.now.state.position))[2:])
    nan = float("nan")
    return mav.MAVLink_altitude_message(s.t_ns // 1000, alt, alt, float(s.now.state.position[2]), above, nan, nan)


def system_time(s: Sight) -> mav.MAVLink_message:
    """SYSTEM_TIME: the mission's clock."""
    return mav.MAVLink_system_time_message(s.unix_us, s.ms)


def home_position(s: Sight) -> mav.MAVLink_message:
    """HOME_POSITION: the own pad."""
    pad = s.craft.executor.pad
    lat, lon, alt, _ = s.craft.home
    north, east, down = (float(c) for c in ned_from_enu(pad))
    return mav.MAVLink_home_position_message(lat, lon, alt, north, east, down, [1.0, 0.0, 0.0, 0.0], 0.0, 0.0, 0.0)


def autopilot_version(s: Sight) -> mav.MAVLink_message:
    """AUTOPILOT_VERSION."""
    can = (mav.MAV_PROTOCOL_CAPABILITY_MISSION_INT | mav.MAV_PROTOCOL_CAPABILITY_MAVLINK2
           | mav.MAV_PROTOCOL_CAPABILITY_COMMAND_INT | mav.MAV_PROTOCOL_CAPABILITY_MISSION_FENCE
           | mav.MAV_PROTOCOL_CAPABILITY_MISSION_RALLY | mav.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_LOCAL_NED
           | mav.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_GLOBAL_INT)
    can |= (mav.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE if s.dialect.bytewise_parameters
            else mav.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_C_CAST)
    nothing = [0] * 8
    return mav.MAVLink_autopilot_version_message(can, 0, 0, 0, 0, nothing, nothing, nothing, 0, 0, s.craft.system)


def gps_global_origin(s: Sight) -> mav.MAVLink_message:
    """GPS_GLOBAL_ORIGIN: the mission's."""
    lat, lon, alt, _ = s.craft.geodetic((0.0, 0.0, 0.0))
    return mav.MAVLink_gps_global_origin_message(lat, lon, alt)


def component_heartbeat(kind: int) -> Callable[[Sight], mav.MAVLink_message]:
    """HEARTBEAT of a component beside the autopilot."""
    return lambda s: mav.MAVLink_heartbeat_message(kind, mav.MAV_AUTOPILOT_INVALID, 0, 0, mav.MAV_STATE_ACTIVE, 3)


@dataclass(frozen=True)
class Stream:
    """A message that is sent by itself: of which component, how often, and whether our own ground station gets it."""

    component: int
    build: Callable[[Sight], mav.MAVLink_message | None]
    every_s: float
    number: int
    ours: bool = False


A, C, G = AUTOPILOT_COMPONENT, CAMERA_COMPONENT, GIMBAL_COMPONENT
STREAMS = (
    Stream(A, heartbeat, 1.0, mav.MAVLINK_MSG_ID_HEARTBEAT, True),
    Stream(A, sys_status, 1.0, mav.MAVLINK_MSG_ID_SYS_STATUS, True),
    Stream(A, battery_status, 1.0, mav.MAVLINK_MSG_ID_BATTERY_STATUS, True),
    Stream(A, extended_sys_state, 0.5, mav.MAVLINK_MSG_ID_EXTENDED_SYS_STATE, True),
    Stream(A, mission_current, 0.5, mav.MAVLINK_MSG_ID_MISSION_CURRENT, True),
    Stream(A, global_position_int, 0.2, mav.MAVLINK_MSG_ID_GLOBAL_POSITION_INT, True),
    Stream(A, local_position_ned, 0.2, mav.MAVLINK_MSG_ID_LOCAL_POSITION_NED, True),
    Stream(A, attitude, 0.2, mav.MAVLINK_MSG_ID_ATTITUDE, True),
    Stream(A, attitude_quaternion, 0.2, mav.MAVLINK_MSG_ID_ATTITUDE_QUATERNION),
    Stream(A, gps_raw_int, 0.5, mav.MAVLINK_MSG_ID_GPS_RAW_INT),
    Stream(A, vfr_hud, 0.5, mav.MAVLINK_MSG_ID_VFR_HUD),
    Stream(A, altitude, 0.5, mav.MAVLINK_MSG_ID_ALTITUDE),
    Stream(A, home_position, 1.0, mav.MAVLINK_MSG_ID_HOME_POSITION),
    Stream(A, fence_status, 1.0, mav.MAVLINK_MSG_ID_FENCE_STATUS),
    Stream(A, system_time, 1.0, mav.MAVLINK_MSG_ID_SYSTEM_TIME),
    Stream(A, lambda s: obstacle_distance(s.craft.scan, s.now.yaw_enu_rad), 0.5,
           mav.MAVLINK_MSG_ID_OBSTACLE_DISTANCE),
    Stream(C, component_heartbeat(mav.MAV_TYPE_CAMERA), 1.0, mav.MAVLINK_MSG_ID_HEARTBEAT),
    Stream(G, component_heartbeat(mav.MAV_TYPE_GIMBAL), 1.0, mav.MAVLINK_MSG_ID_HEARTBEAT),
    Stream(G, lambda s: gimbal_attitude(s.now, s.ms), 0.2, mav.MAVLINK_MSG_ID_GIMBAL_DEVICE_ATTITUDE_STATUS),
    Stream(G, lambda s: gimbal_status(s.ms), 1.0, mav.MAVLINK_MSG_ID_GIMBAL_MANAGER_STATUS),
)


def _heading_deg(s: Sight) -> float:
    return heading_deg_from_yaw_enu(s.now.yaw_enu_rad)


def _yaw_ned_rad(s: Sight) -> float:
    return math.remainder(math.radians(_heading_deg(s)), math.tau)
