"""Messages that are asked for, once or at a rate."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from pymavlink.dialects.v20 import common as mav

from vehicle.autopilot.craft import Craft
from vehicle.autopilot.payload import (
    CAMERA_COMPONENT,
    GIMBAL_COMPONENT,
    camera_information,
    camera_settings,
    capture_status,
    gimbal_device_information,
    gimbal_manager_information,
    image_captured,
    storage_information,
)
from vehicle.autopilot.request import ACCEPTED, DENIED, UNSUPPORTED, Answer, Request
from vehicle.autopilot.telemetry import STREAMS, autopilot_version, gps_global_origin, home_position

if TYPE_CHECKING:
    from vehicle.autopilot.face import Face


def request_message(face: Face, r: Request, t_ns: int) -> Answer:
    """REQUEST_MESSAGE, by component."""
    build = ANSWERS.get((r.component or mav.MAV_COMP_ID_AUTOPILOT1, int(r.params[0])))
    answer = None if build is None else build(face, r, t_ns)
    return (UNSUPPORTED, []) if answer is None else (ACCEPTED, [answer])


def request_capabilities(face: Face, r: Request, t_ns: int) -> Answer:
    """REQUEST_AUTOPILOT_CAPABILITIES, which REQUEST_MESSAGE has replaced."""
    return ACCEPTED, [autopilot_version(face.sight(face.now, t_ns))]


def set_interval(face: Face, r: Request, t_ns: int) -> Answer:
    """SET_MESSAGE_INTERVAL."""
    component = r.component or mav.MAV_COMP_ID_AUTOPILOT1
    return (ACCEPTED if face.set_interval(int(r.params[0]), component, int(r.params[1])) else DENIED), []


def get_interval(face: Face, r: Request, t_ns: int) -> Answer:
    """GET_MESSAGE_INTERVAL."""
    interval = face.interval_us(int(r.params[0]), r.component or mav.MAV_COMP_ID_AUTOPILOT1)
    return ACCEPTED, [mav.MAVLink_message_interval_message(int(r.params[0]), 0 if interval is None else interval)]


def _image(face: Face, r: Request, t_ns: int) -> Any:
    index = int(r.params[1])
    return image_captured(face.craft, index, face.epoch_us) if 0 <= index < len(face.craft.images) else None


def _streamed(component: int, number: int) -> Callable[[Face, Request, int], Any]:
    stream = next(s for s in STREAMS if (s.component, s.number) == (component, number))
    return lambda face, r, t_ns: stream.build(face.sight(face.now, t_ns))


def _of_craft(build: Callable[[Craft, int], Any]) -> Callable[[Face, Request, int], Any]:
    return lambda face, r, t_ns: build(face.craft, t_ns // 1_000_000)


_AUTOPILOT = mav.MAV_COMP_ID_AUTOPILOT1
ANSWERS: dict[tuple[int, int], Callable[[Face, Request, int], Any]] = {
    **{(s.component, s.number): _streamed(s.component, s.number) for s in STREAMS},
    (_AUTOPILOT, mav.MAVLINK_MSG_ID_HOME_POSITION): lambda f, r, t: home_position(f.sight(f.now, t)),
    (_AUTOPILOT, mav.MAVLINK_MSG_ID_AUTOPILOT_VERSION): lambda f, r, t: autopilot_version(f.sight(f.now, t)),
    (_AUTOPILOT, mav.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN): lambda f, r, t: gps_global_origin(f.sight(f.now, t)),
    (_AUTOPILOT, mav.MAVLINK_MSG_ID_CAMERA_IMAGE_CAPTURED): _image,
    (CAMERA_COMPONENT, mav.MAVLINK_MSG_ID_CAMERA_IMAGE_CAPTURED): _image,
    (CAMERA_COMPONENT, mav.MAVLINK_MSG_ID_CAMERA_INFORMATION): _of_craft(
        lambda craft, ms: camera_information(craft.survey_camera, ms)),
    (CAMERA_COMPONENT, mav.MAVLINK_MSG_ID_CAMERA_SETTINGS): _of_craft(lambda craft, ms: camera_settings(ms)),
    (CAMERA_COMPONENT, mav.MAVLINK_MSG_ID_STORAGE_INFORMATION): _of_craft(storage_information),
    (CAMERA_COMPONENT, mav.MAVLINK_MSG_ID_CAMERA_CAPTURE_STATUS): _of_craft(capture_status),
    (GIMBAL_COMPONENT, mav.MAVLINK_MSG_ID_GIMBAL_MANAGER_INFORMATION): _of_craft(
        lambda craft, ms: gimbal_manager_information(ms)),
    (GIMBAL_COMPONENT, mav.MAVLINK_MSG_ID_GIMBAL_DEVICE_INFORMATION): _of_craft(
        lambda craft, ms: gimbal_device_information(ms)),
}
