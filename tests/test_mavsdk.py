"""MAVSDK 4, a client that we did not write, flies a simulated vehicle through its door, as PX4 and as ArduPilot."""

from __future__ import annotations

import asyncio
import math
from collections.abc import AsyncIterator, Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest
from mavsdk import ComponentType, Configuration
from mavsdk.asyncio import Mavsdk
from mavsdk.asyncio.plugins.action import ActionAsync
from mavsdk.asyncio.plugins.camera import CameraAsync
from mavsdk.asyncio.plugins.geofence import GeofenceAsync
from mavsdk.asyncio.plugins.gimbal import GimbalAsync
from mavsdk.asyncio.plugins.info import InfoAsync
from mavsdk.asyncio.plugins.mission import MissionAsync
from mavsdk.asyncio.plugins.mission_raw import MissionRawAsync
from mavsdk.asyncio.plugins.offboard import OffboardAsync
from mavsdk.asyncio.plugins.param import ParamAsync
from mavsdk.asyncio.plugins.telemetry import TelemetryAsync
from mavsdk.exceptions import MavsdkError
from mavsdk.plugins.geofence.geofence import Circle, FenceType, GeofenceData, Point, Polygon
from mavsdk.plugins.gimbal.gimbal import ControlMode, GimbalMode, SendMode
from mavsdk.plugins.mission.mission import MissionItem, MissionPlan
from mavsdk.plugins.mission_raw.mission_raw import MissionItem as RawItem
from mavsdk.plugins.offboard.offboard import PositionNedYaw

from tests.simulated_doors import free_udp_port, simulated

pytestmark = [pytest.mark.loopback, pytest.mark.xdist_group("doors")]

STARTS_S, STEP_S = 300.0, 240.0
NAN = float("nan")
LEAST_STEPS = 44


class Script:
    """Steps against one vehicle; each either succeeds or fails the test by its name."""

    def __init__(self, system: Any, identity: str) -> None:
        self.px4 = identity == "px4"
        self.steps = 0
        self.action, self.telemetry, self.info = ActionAsync(system), TelemetryAsync(system), InfoAsync(system)
        self.param, self.mission, self.raw = ParamAsync(system), MissionAsync(system), MissionRawAsync(system)
        self.geofence, self.offboard = GeofenceAsync(system), OffboardAsync(system)
        self.camera, self.gimbal = CameraAsync(system), GimbalAsync(system)
        self.lat = self.lon = self.alt = 0.0

    async def do(self, call: Awaitable[Any], fits: Callable[[Any], bool] = lambda result: True) -> Any:
        """One call whose result fits."""
        result = await asyncio.wait_for(call, STEP_S)
        assert fits(result), f"step {self.steps + 1}: {result}"
        self.steps += 1
        return result

    async def see(self, stream: AsyncIterator[Any], fits: Callable[[Any], bool] = lambda value: True) -> Any:
        """The first value of a stream that fits."""
        async def first() -> Any:
            async for value in stream:
                if fits(value):
                    return value
            return None

        return await self.do(first())

    async def until(self, question: Callable[[], Awaitable[bool]]) -> None:
        """Ask until the answer is yes."""
        async def yes() -> bool:
            while not await question():
                await asyncio.sleep(0)
            return True

        await self.do(yes())

    async def refuse(self, call: Awaitable[Any]) -> None:
        """A call that the vehicle must not obey."""
        with pytest.raises(MavsdkError):
            await asyncio.wait_for(call, STEP_S)
        self.steps += 1

    def at(self, north_m: float, east_m: float) -> tuple[float, float]:
        """Latitude and longitude, degrees, of a place seen from home."""
        return (self.lat + north_m / 111_319.5,
                self.lon + east_m / (111_319.5 * math.cos(math.radians(self.lat))))


async def look_around(s: Script) -> None:
    """Everything that is told before the flight."""
    telemetry = s.telemetry
    await s.do(s.info.get_identification(), lambda i: i.legacy_uid == 1)
    await s.do(s.info.get_version())
    for stream in (telemetry.subscribe_position, telemetry.subscribe_attitude_euler, telemetry.subscribe_gps_info,
                   telemetry.subscribe_attitude_quaternion, telemetry.subscribe_velocity_ned,
                   telemetry.subscribe_raw_gps, telemetry.subscribe_flight_mode, telemetry.subscribe_landed_state,
                   telemetry.subscribe_fixedwing_metrics, telemetry.subscribe_heading, telemetry.subscribe_altitude,
                   telemetry.subscribe_unix_epoch_time, telemetry.subscribe_position_velocity_ned):
        await s.see(stream())
    await s.see(telemetry.subscribe_battery(), lambda b: b.remaining_percent == 100.0)
    await s.see(telemetry.subscribe_armed(), lambda armed: not armed)
    await s.see(telemetry.subscribe_in_air(), lambda flying: not flying)
    await s.see(telemetry.subscribe_health(), lambda h: h.is_armable and h.is_global_position_ok
                and h.is_home_position_ok and h.is_local_position_ok)
    home = await s.see(telemetry.subscribe_home())
    s.lat, s.lon, s.alt = home.latitude_deg, home.longitude_deg, home.absolute_altitude_m


async def set_up(s: Script) -> None:
    """Parameters and geofence."""
    speed, silent = ("MPC_XY_CRUISE", "NAV_DLL_ACT") if s.px4 else ("WPNAV_SPEED", "FS_GCS_ENABLE")
    await s.do(s.param.set_param_float(speed, 4.5 if s.px4 else 450.0))
    await s.do(s.param.get_param_float(speed), lambda v: v == (4.5 if s.px4 else 450.0))
    await s.do(s.param.set_param_int(silent, 1))
    await s.do(s.param.get_param_int(silent), lambda v: v == 1)
    await s.do(s.param.get_all_params(), lambda a: len(a.float_params) > 3)
    await s.refuse(s.param.get_param_float("NO_SUCH"))
    await s.do(s.action.set_takeoff_altitude(6.0))
    await s.do(s.action.get_takeoff_altitude(), lambda a: abs(a - 6.0) < 1e-3)
    outline = Polygon([Point(*s.at(n, e)) for n, e in ((-5, -30), (45, -30), (45, 30), (-5, 30))], FenceType.INCLUSION)
    tree = Circle(Point(*s.at(30, 25)), 3.0, FenceType.EXCLUSION)
    await s.do(s.geofence.upload_geofence(GeofenceData([outline], [tree])))
    await s.do(s.geofence.download_geofence(), lambda g: (len(g.polygons), len(g.circles)) == (1, 1))


async def fly_by_hand(s: Script) -> None:
    """Take-off, goto, gimbal, photos, offboard."""
    await s.do(s.action.arm())
    await s.see(s.telemetry.subscribe_armed(), bool)
    await s.do(s.action.takeoff())
    await s.see(s.telemetry.subscribe_in_air(), bool)
    await s.see(s.telemetry.subscribe_position(), lambda p: abs(p.relative_altitude_m - 6.0) < 0.1)
    for forbidden in (s.action.disarm, s.action.arm_force, s.action.kill, s.action.reboot):
        await s.refuse(forbidden())
    await s.do(s.action.goto_location(*s.at(0.0, 8.0), s.alt + 8.0, 90.0))
    await s.see(s.telemetry.subscribe_position(), lambda p: abs(p.longitude_deg - s.at(0.0, 8.0)[1]) < 2e-7
                and abs(p.relative_altitude_m - 8.0) < 0.02)
    gimbals = await s.see(s.gimbal.subscribe_gimbal_list(), lambda g: len(g.gimbals) > 0)
    gimbal_id = gimbals.gimbals[0].gimbal_id
    await s.do(s.gimbal.take_control(gimbal_id, ControlMode.PRIMARY))
    await s.do(s.gimbal.set_angles(gimbal_id, 0.0, -30.0, 0.0, GimbalMode.YAW_FOLLOW, SendMode.ONCE))
    await s.see(s.gimbal.subscribe_attitude(), lambda a: abs(a.euler_angle_forward.pitch_deg + 30.0) < 0.1)
    cameras = await s.see(s.camera.subscribe_camera_list(), lambda c: len(c.cameras) > 0)
    camera_id = cameras.cameras[0].component_id
    shown = asyncio.ensure_future(s.see(s.camera.subscribe_capture_info(), lambda c: c.index == 0 and c.is_success))
    await asyncio.sleep(0)
    await s.do(s.camera.take_photo(camera_id))
    await shown
    await s.do(s.camera.start_photo_interval(camera_id, 1.0))
    await s.see(s.camera.subscribe_capture_info(), lambda c: c.index >= 2 and c.is_success)
    await s.do(s.camera.stop_photo_interval(camera_id))
    await s.see(s.camera.subscribe_storage(), lambda card: card.storage.available_storage_mib > 0.0)
    here = await s.see(s.telemetry.subscribe_position_velocity_ned())
    target = PositionNedYaw(here.position.north_m, here.position.east_m - 5.0, here.position.down_m, 0.0)
    await s.do(s.offboard.set_position_ned(target))
    await s.do(s.offboard.start())
    await s.see(s.telemetry.subscribe_flight_mode(), lambda mode: mode.name == "OFFBOARD")
    await s.see(s.telemetry.subscribe_position_velocity_ned(),
                lambda p: abs(p.position.east_m - target.east_m) < 0.05)
    await s.do(s.offboard.stop())
    await s.see(s.telemetry.subscribe_flight_mode(), lambda mode: mode.name == "HOLD")


PLACES = ((0.0, 6.0, 6.0), (0.0, -6.0, 7.0), (3.0, -6.0, 7.0))
"""North and east of home, and above it, metres."""


async def upload(s: Script) -> None:
    """A plan with three pictures. With ArduPilot MAVSDK's own plans lack item 0 (home) and carry NaN, and the real one
    refuses them as well: raw items are the way."""
    photo = MissionItem.CameraAction.TAKE_PHOTO
    items = [MissionItem(*s.at(n, e), up, 3.0, False, -20.0, NAN, photo, 0.5, acceptance_radius_m=0.5, yaw_deg=10.0)
             for n, e, up in PLACES]
    await s.do(s.mission.set_return_to_launch_after_mission(True))
    if s.px4:
        await s.do(s.mission.upload_mission(MissionPlan(items)))
        await s.do(s.mission.download_mission(), lambda plan: len(plan.mission_items) == len(PLACES))
        return
    await s.refuse(s.mission.upload_mission(MissionPlan(items)))
    raw = [(3, 16, (0.0, 0.0, 0.0, 0.0), (s.lat, s.lon, 0.0)), (3, 22, (0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 5.0))]
    for n, e, up in PLACES:
        raw += [(3, 16, (0.5, 0.0, 0.0, 0.0), (*s.at(n, e), up)), (2, 2000, (0.0, 0.0, 1.0, 0.0), (0.0, 0.0, 0.0))]
    raw.append((3, 20, (0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)))
    await s.do(s.raw.upload_mission([
        RawItem(seq, frame, command, int(seq == 0), 1, *params, round(lat * 1e7), round(lon * 1e7), up, 0)
        for seq, (frame, command, params, (lat, lon, up)) in enumerate(raw)]))


async def fly_a_plan(s: Script) -> None:
    """Start, pause, resume, the end, and the way home."""
    mission: Any = s.mission if s.px4 else s.raw
    await upload(s)
    await s.do(mission.start_mission())
    await s.see(mission.subscribe_mission_progress(), lambda p: p.current >= (1 if s.px4 else 3))
    await s.do(mission.pause_mission())
    await s.see(s.telemetry.subscribe_flight_mode(), lambda mode: mode.name == "HOLD")
    await s.do(mission.start_mission())
    await s.see(s.telemetry.subscribe_flight_mode(), lambda mode: mode.name == "RETURN_TO_LAUNCH")
    await s.until(mission.is_mission_finished)
    await s.see(s.telemetry.subscribe_landed_state(), lambda state: state.name == "ON_GROUND")
    await s.see(s.telemetry.subscribe_armed(), lambda armed: not armed)


async def clear_up(s: Script) -> None:
    """Raw lists, and nothing left behind; then a short hop that ends where it began."""
    await s.do(s.raw.download_mission(), lambda items: len(items) > 3)
    await s.do(s.raw.upload_rally_points([RawItem(0, 3, 5100, 1, 1, 0.0, 0.0, 0.0, 0.0, round(s.lat * 1e7),
                                                  round(s.lon * 1e7), 5.0, 2)]))
    await s.do(s.raw.download_rallypoints(), lambda items: len(items) == 1)
    await s.do(s.mission.clear_mission())
    await s.do(s.geofence.clear_geofence())
    await s.do(s.raw.download_mission(), lambda items: not items)
    await s.do(s.action.arm())
    await s.do(s.action.takeoff())
    await s.see(s.telemetry.subscribe_position(), lambda p: p.relative_altitude_m > 4.0)
    await s.do(s.action.land())
    await s.see(s.telemetry.subscribe_armed(), lambda armed: not armed)


async def script(port: int, identity: str) -> int:
    """All of it; the number of steps."""
    configuration = Configuration.create_with_component_type(ComponentType.GROUND_STATION)
    async with Mavsdk(configuration) as client:
        await client.add_any_connection(f"udpin://127.0.0.1:{port}")
        system = await client.first_autopilot(timeout_s=STARTS_S)
        assert system is not None
        s = Script(system, identity)
        for part in (look_around, set_up, fly_by_hand, fly_a_plan, clear_up):
            await part(s)
        return s.steps


@pytest.mark.parametrize("identity", ["px4", "ardupilot"])
def test_mavsdk_flies_a_vehicle_through_all_it_knows(identity: str, tmp_path: Path) -> None:
    port = free_udp_port()
    with simulated(tmp_path, "--open", f"udp://127.0.0.1:{port}", "--identity", identity):
        assert asyncio.run(script(port, identity)) >= LEAST_STEPS
