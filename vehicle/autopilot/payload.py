"""Camera and gimbal as MAVLink components beside the autopilot: what they say of themselves."""

from __future__ import annotations

import math

from pymavlink.dialects.v20 import common as mav

from missions.camera import Camera
from missions.frames import heading_deg_from_yaw_enu
from missions.messages import PictureMeta
from vehicle.autopilot.craft import Craft
from vehicle.simulator import Kinematics

CAMERA_COMPONENT, GIMBAL_COMPONENT = mav.MAV_COMP_ID_CAMERA, mav.MAV_COMP_ID_GIMBAL
PIXEL_MM = 0.0024
"""Pixel pitch by which the focal length is told in millimetres: the simulated camera has one in pixels alone."""
STORAGE_MIB = 65536.0
NAN = float("nan")


def camera_information(camera: Camera, ms: int) -> mav.MAVLink_message:
    """CAMERA_INFORMATION: takes pictures, also in flight; no video."""
    flags = (mav.CAMERA_CAP_FLAGS_CAPTURE_IMAGE | mav.CAMERA_CAP_FLAGS_HAS_MODES)
    return mav.MAVLink_camera_information_message(
        ms, _text("swarmscan"), _text("simulated camera"), 1, camera.fx_px * PIXEL_MM, camera.width_px * PIXEL_MM,
        camera.height_px * PIXEL_MM, camera.width_px, camera.height_px, 0, flags, 0, b"", GIMBAL_COMPONENT)


def camera_settings(ms: int) -> mav.MAVLink_message:
    """CAMERA_SETTINGS."""
    return mav.MAVLink_camera_settings_message(ms, mav.CAMERA_MODE_IMAGE, NAN, NAN)


def storage_information(craft: Craft, ms: int) -> mav.MAVLink_message:
    """STORAGE_INFORMATION of the vehicle's card."""
    used = sum(meta.size_bytes for meta in craft.images) / 2**20
    return mav.MAVLink_storage_information_message(ms, 1, 1, mav.STORAGE_STATUS_READY, STORAGE_MIB, used,
                                                   max(0.0, STORAGE_MIB - used), NAN, NAN)


def capture_status(craft: Craft, ms: int) -> mav.MAVLink_message:
    """CAMERA_CAPTURE_STATUS."""
    photos = craft.photos
    status = 0 if not photos.running else 3
    return mav.MAVLink_camera_capture_status_message(ms, status, 0, photos.interval_s if photos.running else 0.0, 0,
                                                     STORAGE_MIB, len(craft.images))


def image_captured(craft: Craft, index: int, epoch_us: int) -> mav.MAVLink_message:
    """CAMERA_IMAGE_CAPTURED of the picture with this index."""
    meta = craft.images[index]
    lat, lon, alt, relative = craft.geodetic(meta.pose.position_enu_m)
    return mav.MAVLink_camera_image_captured_message(
        meta.t_capture_ns // 1_000_000, epoch_us + meta.t_capture_ns // 1000, 0, lat, lon, alt, relative,
        [float(q) for q in meta.pose.quaternion_wxyz], index, 1, _url(meta))


def image_lost(craft: Craft, view_id: int, t_ns: int) -> mav.MAVLink_message:
    """CAMERA_IMAGE_CAPTURED of a picture that failed."""
    return mav.MAVLink_camera_image_captured_message(t_ns // 1_000_000, 0, 0, 0, 0, 0, 0, [1.0, 0.0, 0.0, 0.0],
                                                     len(craft.images), 0, f"view/{view_id}".encode())


def gimbal_manager_information(ms: int) -> mav.MAVLink_message:
    """GIMBAL_MANAGER_INFORMATION: pitch is the camera's, yaw the vehicle's."""
    can = (mav.GIMBAL_MANAGER_CAP_FLAGS_HAS_PITCH_AXIS | mav.GIMBAL_MANAGER_CAP_FLAGS_HAS_PITCH_LOCK
           | mav.GIMBAL_MANAGER_CAP_FLAGS_HAS_YAW_AXIS)
    return mav.MAVLink_gimbal_manager_information_message(ms, can, GIMBAL_COMPONENT, 0.0, 0.0, -math.pi / 2.0,
                                                          math.pi / 2.0, -math.pi, math.pi)


def gimbal_device_information(ms: int) -> mav.MAVLink_message:
    """GIMBAL_DEVICE_INFORMATION."""
    can = mav.GIMBAL_DEVICE_CAP_FLAGS_HAS_PITCH_AXIS | mav.GIMBAL_DEVICE_CAP_FLAGS_HAS_PITCH_LOCK
    return mav.MAVLink_gimbal_device_information_message(ms, b"swarmscan", b"simulated gimbal", b"", 1, 1, 0, can, 0,
                                                         0.0, 0.0, -math.pi / 2.0, math.pi / 2.0, -math.pi, math.pi)


def gimbal_status(ms: int) -> mav.MAVLink_message:
    """GIMBAL_MANAGER_STATUS."""
    flags = mav.GIMBAL_MANAGER_FLAGS_ROLL_LOCK | mav.GIMBAL_MANAGER_FLAGS_PITCH_LOCK
    return mav.MAVLink_gimbal_manager_status_message(ms, flags, GIMBAL_COMPONENT, 0, 0, 0, 0)


def gimbal_attitude(now: Kinematics, ms: int) -> mav.MAVLink_message:
    """GIMBAL_DEVICE_ATTITUDE_STATUS: pitch of the camera, yaw of the body from North."""
    yaw, pitch = math.radians(heading_deg_from_yaw_enu(now.yaw_enu_rad)), now.gimbal_elevation_rad
    cy, sy, cp, sp = math.cos(yaw / 2.0), math.sin(yaw / 2.0), math.cos(pitch / 2.0), math.sin(pitch / 2.0)
    flags = (mav.GIMBAL_DEVICE_FLAGS_ROLL_LOCK | mav.GIMBAL_DEVICE_FLAGS_PITCH_LOCK | mav.GIMBAL_DEVICE_FLAGS_YAW_LOCK
             | mav.GIMBAL_DEVICE_FLAGS_YAW_IN_EARTH_FRAME)
    return mav.MAVLink_gimbal_device_attitude_status_message(0, 0, ms, flags, [cy * cp, -sy * sp, cy * sp, sy * cp],
                                                             0.0, 0.0, 0.0, 0)


def _url(meta: PictureMeta) -> bytes:
    return f"{meta.phase}_{meta.view_id}.jpg".encode()


def _text(text: str) -> list[int]:
    return [*text.encode(), *([0] * (32 - len(text)))]
