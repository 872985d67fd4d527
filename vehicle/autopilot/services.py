"""The small services beside commands and missions: parameters, mode, set-points, time, and what is not offered."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from pymavlink.dialects.v20 import common as mav

from vehicle.autopilot.parameters import answer_list, answer_read, answer_set, refuse_set

if TYPE_CHECKING:
    from vehicle.autopilot.face import Face

Sender = tuple[int, int]
FTP_NAK, FTP_UNKNOWN_COMMAND = 129, 6
LED_BY_ANOTHER = 3
"""Of CHANGE_OPERATOR_CONTROL_ACK."""


def answer_service(face: Face, message: Any, sender: Sender, t_ns: int) -> list[Any]:
    """Answers to a message that is neither a command nor of the mission protocol; none to what is not known."""
    handler = _SERVICES.get(message.get_type())
    return [] if handler is None else handler(face, message, sender, t_ns)


def _param_list(face: Face, message: Any, sender: Sender, t_ns: int) -> list[Any]:
    return answer_list(face.craft, face.dialect)


def _param_read(face: Face, message: Any, sender: Sender, t_ns: int) -> list[Any]:
    return answer_read(face.craft, face.dialect, message, sender)


def _param_set(face: Face, message: Any, sender: Sender, t_ns: int) -> list[Any]:
    if face.lease is not None and not face.lease.may_set(sender, t_ns):
        face.text(f"{face.lease.holder_name} leads this vehicle: parameters stay", mav.MAV_SEVERITY_NOTICE)
        return refuse_set(message, sender)
    answers, reason = answer_set(face.craft, face.dialect, message, sender)
    if reason:
        face.text(reason, mav.MAV_SEVERITY_WARNING)
    return answers


def _control(face: Face, message: Any, sender: Sender, t_ns: int) -> list[Any]:
    """CHANGE_OPERATOR_CONTROL: 0 asks for the lead, 1 lets go of it."""
    if face.lease is None:
        return []
    asks = message.control_request == 0
    if not asks:
        face.lease.let_go(sender)
    ack = LED_BY_ANOTHER if asks and not face.lease.take(sender, t_ns) else 0
    return [mav.MAVLink_change_operator_control_ack_message(sender[0], message.control_request, ack)]


def _setpoint(face: Face, message: Any, sender: Sender, t_ns: int) -> list[Any]:
    if face.lease is None or face.lease.take(sender, t_ns):
        reason = face.setpoints.hear(message, face.now, face.takes_setpoints, t_ns)
        if reason:
            face.text(reason, mav.MAV_SEVERITY_WARNING)
    return []


def _ping(face: Face, message: Any, sender: Sender, t_ns: int) -> list[Any]:
    asked = (message.target_system, message.target_component) == (0, 0)
    return [mav.MAVLink_ping_message(message.time_usec, message.seq, *sender)] if asked else []


def _timesync(face: Face, message: Any, sender: Sender, t_ns: int) -> list[Any]:
    return [mav.MAVLink_timesync_message(t_ns, message.ts1)] if message.tc1 == 0 else []


def _no_files(face: Face, message: Any, sender: Sender, t_ns: int) -> list[Any]:
    """There is no file system here: MAVLink FTP is refused at once, so that clients go on without it."""
    asked = bytes(message.payload)
    refusal = bytes([asked[0], asked[1], asked[2], FTP_NAK, 1, asked[3], 0, 0, 0, 0, 0, 0, FTP_UNKNOWN_COMMAND])
    return [mav.MAVLink_file_transfer_protocol_message(0, *sender, [*refusal, *([0] * (251 - len(refusal)))])]


_SERVICES: dict[str, Callable[[Face, Any, Sender, int], list[Any]]] = {
    "PARAM_REQUEST_LIST": _param_list, "PARAM_REQUEST_READ": _param_read, "PARAM_SET": _param_set,
    "SET_POSITION_TARGET_LOCAL_NED": _setpoint, "SET_POSITION_TARGET_GLOBAL_INT": _setpoint,
    "CHANGE_OPERATOR_CONTROL": _control, "PING": _ping, "TIMESYNC": _timesync, "FILE_TRANSFER_PROTOCOL": _no_files,
}
