"""Commands that a vehicle obeys, COMMAND_LONG and COMMAND_INT alike. Every one may come twice: clients repeat them."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING

from pymavlink.dialects.v20 import common as mav

from missions.frames import yaw_enu_from_heading_deg
from planning.trajectories import Via
from vehicle.autopilot.message_requests import get_interval, request_capabilities, request_message, set_interval
from vehicle.autopilot.payload_commands import gimbal, photo, stop_photos, take_gimbal
from vehicle.autopilot.request import ACCEPTED, DENIED, REJECTED, UNSUPPORTED, Answer, Request
from vehicle.client_plan import RELATIVE_FRAMES
from vehicle.dialects import Mode
from vehicle.failsafe_table import Action
from vehicle.lease import OUR_GROUND, Sender
from vehicle.modes import DESCEND, EMERGENCY, HOLD, LAND, MISSION, RETURN, STANDBY, TAKEOFF

if TYPE_CHECKING:
    from vehicle.autopilot.face import Face


def set_mode(face: Face, r: Request, t_ns: int) -> Answer:
    """DO_SET_MODE: on the ground the choice for later, in the air at once."""
    mode = face.dialect.mode_of(face.dialect.mode_number(r.params[1], r.params[2]))
    if mode is None or not int(r.params[0]) & mav.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED:
        return UNSUPPORTED, []
    if mode == "manual":
        face.text("nobody flies this vehicle by hand: choose hold, mission, return or land", mav.MAV_SEVERITY_WARNING)
        return DENIED, []
    allowed = mode in SAFER or (face.may_go_on(r.sender, t_ns) if mode == "mission" else face.leads(r.sender, t_ns))
    if not allowed:
        return DENIED, []
    if face.craft.executor.mode == STANDBY:
        return _choose_on_ground(face, mode, t_ns)
    return _change_in_flight(face, mode, r.sender, t_ns)


def _choose_on_ground(face: Face, mode: Mode, t_ns: int) -> Answer:
    executor = face.craft.executor
    face.selected = mode
    if executor.armed and not face.dialect.starts_by_command:
        if mode == "mission":
            return _start_mission(face)
        if mode == "takeoff":
            return (ACCEPTED if executor.take_off(face.craft.takeoff_up_m, t_ns) else REJECTED), []
    return ACCEPTED, []


def _change_in_flight(face: Face, mode: Mode, sender: tuple[int, int], t_ns: int) -> Answer:
    executor = face.craft.executor
    if mode in ("hold", "guided"):
        face.selected = mode
    if mode == "mission":
        return _start_mission(face)
    if mode == "offboard":
        if not face.setpoints.begin(t_ns):
            face.text("offboard needs set-points first, at least two a second, in flight", mav.MAV_SEVERITY_WARNING)
            return DENIED, []
    elif mode == "return":
        executor.go_home(t_ns)
    elif mode == "land":
        _land_or_say(face, t_ns)
    elif mode == "hold" or executor.mode != TAKEOFF:
        return _hold_if_safer(face, sender, t_ns)
    return ACCEPTED, []


def _hold_if_safer(face: Face, sender: tuple[int, int], t_ns: int) -> Answer:
    """Who only watches may not hold a vehicle that comes home or lands."""
    executor = face.craft.executor
    doing = Action.RETURN if executor.mode in (RETURN, LAND, DESCEND, EMERGENCY) else Action.NONE
    if face.lease is not None and not face.lease.may(sender, Action.HOLD, doing, t_ns):
        face.text(f"{face.lease.holder_name} leads: only it may hold a return", mav.MAV_SEVERITY_NOTICE)
        return DENIED, []
    executor.hold(t_ns, _who_lets_go(face, sender, t_ns))
    return ACCEPTED, []


def _who_lets_go(face: Face, sender: Sender, t_ns: int) -> Sender:
    """Who may let it go on after this sender has held it: that one, if it leads or a plan was under way."""
    executor = face.craft.executor
    if face.lease is None:
        return OUR_GROUND
    if executor.mode in (TAKEOFF, MISSION) or face.lease.take(sender, t_ns):
        return sender
    return executor.paused_by or face.lease.holder(t_ns) or OUR_GROUND


def _start_mission(face: Face) -> Answer:
    if not face.craft.plan.items:
        face.text("there is no mission: upload one first", mav.MAV_SEVERITY_WARNING)
        return DENIED, []
    if not face.craft.executor.armed:
        face.text("arm before the mission is started", mav.MAV_SEVERITY_WARNING)
        return DENIED, []
    return (ACCEPTED if face.craft.executor.start() else REJECTED), []


def arm(face: Face, r: Request, t_ns: int) -> Answer:
    """COMPONENT_ARM_DISARM. In flight the propellers stay on, also when forced (21196)."""
    executor = face.craft.executor
    if r.params[0] == 0.0:
        if executor.flying:
            face.text("disarming in flight is refused, forced or not: land first", mav.MAV_SEVERITY_WARNING)
            return DENIED, []
        executor.armed = False
        return ACCEPTED, []
    if face.lease is not None and not face.leads(r.sender, t_ns):
        return DENIED, []
    if not executor.flying and face.lease is not None:
        if not executor.ready:
            face.text("arming is refused: the battery is too low", mav.MAV_SEVERITY_WARNING)
            return DENIED, []
        if face.selected == "mission" and not face.dialect.arms_in_mission:
            face.text("arming is refused in AUTO: choose GUIDED first", mav.MAV_SEVERITY_WARNING)
            return DENIED, []
    executor.armed = True
    if face.lease is not None and not executor.flying and face.selected == "mission" and face.craft.plan.items:
        return _start_mission(face)
    return ACCEPTED, []


def take_off(face: Face, r: Request, t_ns: int) -> Answer:
    """NAV_TAKEOFF. Our own ground station's is the beginning of a mission. Others hover at the altitude that they
    give (above the ellipsoid with PX4, above home with ArduPilot), or at that of the parameters."""
    executor, craft = face.craft.executor, face.craft
    if face.lease is None:
        return (ACCEPTED if executor.start() else REJECTED), []
    if executor.mode != STANDBY:
        return ACCEPTED, []
    if not executor.armed:
        face.text("arm before taking off", mav.MAV_SEVERITY_WARNING)
        return DENIED, []
    up, given = craft.takeoff_up_m, r.params[6]
    if math.isfinite(given) and given != 0.0:
        up = given - craft.site.alt_m if not face.dialect.starts_by_command else given + float(executor.pad[2])
    return (ACCEPTED if executor.take_off(up, t_ns) else REJECTED), []


def start(face: Face, r: Request, t_ns: int) -> Answer:
    """MISSION_START."""
    executor = face.craft.executor
    if face.lease is not None:
        return _start_mission(face) if face.may_go_on(r.sender, t_ns) else (DENIED, [])
    if executor.mode == HOLD and executor.paused_by not in (None, OUR_GROUND):
        face.text("held by somebody else: the plan waits until they, or a person at the ground station, let it go on",
                  mav.MAV_SEVERITY_NOTICE)
        return ACCEPTED, []
    return (ACCEPTED if executor.start() else REJECTED), []


def pause(face: Face, r: Request, t_ns: int) -> Answer:
    """DO_PAUSE_CONTINUE."""
    if face.lease is not None and not face.dialect.pauses_by_command:
        return UNSUPPORTED, []
    executor = face.craft.executor
    if r.params[0] == 0.0:
        return _hold_if_safer(face, r.sender, t_ns)
    if not face.may_go_on(r.sender, t_ns):
        return DENIED, []
    return (ACCEPTED if executor.flying and executor.start() else REJECTED), []


def loiter(face: Face, r: Request, t_ns: int) -> Answer:
    """NAV_LOITER_UNLIM: hold."""
    return _hold_if_safer(face, r.sender, t_ns)


def go_home(face: Face, r: Request, t_ns: int) -> Answer:
    """NAV_RETURN_TO_LAUNCH."""
    face.craft.executor.go_home(t_ns)
    return ACCEPTED, []


def land(face: Face, r: Request, t_ns: int) -> Answer:
    """NAV_LAND: here, if it is known to be free below, else at home."""
    _land_or_say(face, t_ns)
    return ACCEPTED, []


def _land_or_say(face: Face, t_ns: int) -> None:
    if not face.craft.executor.land(t_ns):
        face.text("what is below is not known to be free: landing at home instead", mav.MAV_SEVERITY_WARNING)


def reposition(face: Face, r: Request, t_ns: int) -> Answer:
    """DO_REPOSITION: fly to a point and stay there."""
    craft, now = face.craft, face.now
    *_, yaw_rad, lat, lon, alt = r.params
    target = now.state.position.copy()
    if math.isfinite(lat) and math.isfinite(lon):
        target[:2] = craft.site.enu_from_geodetic(lat, lon, craft.site.alt_m)[:2]
    if math.isfinite(alt):
        target[2] = alt + float(craft.executor.pad[2]) if r.frame in RELATIVE_FRAMES else alt - craft.site.alt_m
    yaw = yaw_enu_from_heading_deg(math.degrees(yaw_rad)) if math.isfinite(yaw_rad) else now.yaw_enu_rad
    reason = craft.why_not_there(target)
    if reason:
        face.text(f"not flying there: {reason}", mav.MAV_SEVERITY_WARNING)
        return DENIED, []
    return (ACCEPTED if craft.executor.goto(Via(target, yaw, now.gimbal_elevation_rad), t_ns) else REJECTED), []


def set_current(face: Face, r: Request, t_ns: int) -> Answer:
    """DO_SET_MISSION_CURRENT."""
    if not face.dialect.pauses_by_command:
        return UNSUPPORTED, []
    return (ACCEPTED if face.missions.go_on_with(int(r.params[0])) else DENIED), []


def change_speed(face: Face, r: Request, t_ns: int) -> Answer:
    """DO_CHANGE_SPEED: of all flights from now on, never faster than the airframe's."""
    if r.params[1] > 0.0:
        face.craft.set_speed(r.params[1])
    return ACCEPTED, []


def enable_fence(face: Face, r: Request, t_ns: int) -> Answer:
    """DO_FENCE_ENABLE: of the uploaded fence; the mission's own geofence stays."""
    face.craft.fence_enabled = r.params[0] != 0.0
    return ACCEPTED, []


def reboot(face: Face, r: Request, t_ns: int) -> Answer:
    """PREFLIGHT_REBOOT_SHUTDOWN: refused in flight; on the ground there is nothing to reboot."""
    return (DENIED if face.craft.executor.flying else UNSUPPORTED), []


COMMANDS: dict[int, Callable[[Face, Request, int], Answer]] = {
    mav.MAV_CMD_DO_SET_MODE: set_mode, mav.MAV_CMD_COMPONENT_ARM_DISARM: arm, mav.MAV_CMD_NAV_TAKEOFF: take_off,
    mav.MAV_CMD_MISSION_START: start, mav.MAV_CMD_DO_PAUSE_CONTINUE: pause, mav.MAV_CMD_NAV_LOITER_UNLIM: loiter,
    mav.MAV_CMD_NAV_RETURN_TO_LAUNCH: go_home, mav.MAV_CMD_NAV_LAND: land, mav.MAV_CMD_DO_REPOSITION: reposition,
    mav.MAV_CMD_DO_SET_MISSION_CURRENT: set_current, mav.MAV_CMD_DO_CHANGE_SPEED: change_speed,
    mav.MAV_CMD_DO_FENCE_ENABLE: enable_fence, mav.MAV_CMD_IMAGE_START_CAPTURE: photo,
    mav.MAV_CMD_IMAGE_STOP_CAPTURE: stop_photos, mav.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW: gimbal,
    mav.MAV_CMD_DO_GIMBAL_MANAGER_CONFIGURE: take_gimbal, mav.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN: reboot,
    mav.MAV_CMD_REQUEST_MESSAGE: request_message,
    mav.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES: request_capabilities,
    mav.MAV_CMD_SET_MESSAGE_INTERVAL: set_interval, mav.MAV_CMD_GET_MESSAGE_INTERVAL: get_interval,
}
NEEDS_LEASE = frozenset({
    mav.MAV_CMD_NAV_TAKEOFF, mav.MAV_CMD_DO_REPOSITION, mav.MAV_CMD_DO_SET_MISSION_CURRENT,
    mav.MAV_CMD_DO_CHANGE_SPEED, mav.MAV_CMD_DO_FENCE_ENABLE, mav.MAV_CMD_IMAGE_START_CAPTURE,
    mav.MAV_CMD_IMAGE_STOP_CAPTURE, mav.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW,
    mav.MAV_CMD_DO_GIMBAL_MANAGER_CONFIGURE})
"""Commands for whoever leads; the others only make things safer, or ask. Arming and modes look at it themselves."""
SAFER: frozenset[Mode] = frozenset({"hold", "return", "land"})
