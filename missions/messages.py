"""Every message of the flight that crosses a process, in one file; what people watch and say is in `live.py`. SI units,
ENU, radians unless the name says otherwise.

Messages are msgspec Structs, packed as MessagePack; decoding is typed and refuses bad data. Nothing is pickled.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from typing import Annotated

import msgspec
from msgspec import Meta

from missions.camera import Camera, Pose

Vector = tuple[float, float, float]


def vector(values: Iterable[float], digits: int | None = None) -> Vector:
    """Three numbers as they cross processes; with as many decimals, where given."""
    x, y, z = (float(v) if digits is None else round(float(v), digits) for v in values)
    return x, y, z


MAX_CHUNK = 256 * 1024
Chunk = Annotated[bytes, Meta(max_length=MAX_CHUNK)]


class Message(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Base of all messages."""


# --- clock: lock-step simulated time ---------------------------------------------------------------------------------


class Join(Message, frozen=True, kw_only=True):
    """A process asks to take part in the clock. Differing spec_hash or mission_hash is refused."""

    name: str
    boot: str
    spec_hash: str
    mission_hash: str


class SiteBrief(Message, frozen=True, kw_only=True):
    """What the operator knows before the flight: the object's box and the height of the ground. No geometry."""

    object_min_enu_m: Vector
    object_max_enu_m: Vector
    ground_up_m: float


class Welcome(Message, frozen=True, kw_only=True):
    """The bridge's answer to a Join, for all: who takes part, and the operator's knowledge of the site. under_way:
    whether somebody takes part again; counts: totals of the lock-step keys so far."""

    accepted: bool
    reason: str
    name: str
    boot: str
    site: SiteBrief
    under_way: bool = False
    counts: dict[str, int] = {}


class Tick(Message, frozen=True, kw_only=True):
    """Simulated time is now t_ns. `counts`: total messages published so far on each lock-step key that changed.
    `joins`: boot, by name, of who died and takes part again from the next tick on. `again`: the first tick of a bridge
    that was started again, which is the one it died in; what it held then is to be sent once more."""

    tick: int
    t_ns: int
    counts: dict[str, int]
    participants: list[str]
    stop: bool = False
    joins: dict[str, str] = {}
    again: bool = False


class TickDone(Message, frozen=True, kw_only=True):
    """A participant has done its work for this tick. It next needs the processor at wake_ns at the latest, or never
    again when it is leaving."""

    name: str
    tick: int
    counts: dict[str, int]
    wake_ns: int
    leaving: bool = False


# --- MAVLink over the bus --------------------------------------------------------------------------------------------


class MavlinkFrames(Message, frozen=True, kw_only=True):
    """Whole MAVLink 2 frames, in order."""

    frames: list[bytes]


class PlanHash(Message, frozen=True, kw_only=True):
    """Ground to vehicle: the SHA-256 that the plan about to be uploaded must have."""

    plan_id: int
    count: int
    sha256: str


class PlanVerdict(Message, frozen=True, kw_only=True):
    """Vehicle to ground: the whole plan is accepted or refused, never a part of it."""

    plan_id: int
    sha256: str
    accepted: bool
    reason: str = ""


class LegReport(Message, frozen=True, kw_only=True):
    """Vehicle to ground: a view that will not be flown in this plan, and why (blocked, energy, unreachable)."""

    plan_id: int
    view_id: int
    outcome: str
    detail: str = ""


class BatterySwap(Message, frozen=True, kw_only=True):
    """Ground to a vehicle on its pad, in place of the person who changes its battery (MAVLink knows no such command):
    after `battery.swap_s` it is full."""

    vehicle_id: int


class FenceOrder(Message, frozen=True, kw_only=True):
    """Ground to vehicle: the box to stay in from now on, wider than the one before (a MAVLink fence has neither floor
    nor ceiling)."""

    order_id: int
    lower_enu_m: Vector
    upper_enu_m: Vector


class FenceVerdict(Message, frozen=True, kw_only=True):
    """Vehicle to ground: the fence is accepted or refused."""

    order_id: int
    accepted: bool
    reason: str = ""


# --- vehicle state, for teammates and the referee --------------------------------------------------------------------


class VehicleState(Message, frozen=True, kw_only=True):
    """Kinematic state of the simulated vehicle; position is that of camera and body alike (no lever arm)."""

    vehicle_id: int
    t_ns: int
    position_enu_m: Vector
    velocity_enu_m_s: Vector
    acceleration_enu_m_s2: Vector
    yaw_enu_rad: float
    gimbal_elevation_rad: float
    battery_percent: float
    flying: bool
    mode: str


class RightOfWay(Message, frozen=True, kw_only=True):
    """A way that a waiting vehicle asks the others to leave free: from where it rests to where it would go. The
    longest wait goes first: (since_ns, vehicle_id) is the rank, and vehicle_id for whom in the end, since a vehicle
    that makes way asks on behalf of the one it makes way for."""

    path_enu_m: list[Vector]
    since_ns: int
    vehicle_id: int


class AnnouncedTrajectory(Message, frozen=True, kw_only=True):
    """Where a vehicle will be: positions at fixed steps from t_start_ns; it stays at the last one. In between it leaves
    the chords by at most acceleration * step^2 / 8. Should it have to stop, it rests where it would have been at most
    stopping_s later."""

    vehicle_id: int
    t_start_ns: int
    step_ns: int
    positions_enu_m: list[Vector]
    stopping_s: float = 0.0
    wants: RightOfWay | None = None


# --- pictures --------------------------------------------------------------------------------------------------------


class ShutterRequest(Message, frozen=True, kw_only=True):
    """Vehicle to bridge: expose now, at this pose."""

    vehicle_id: int
    view_id: int
    phase: str
    t_capture_ns: int
    pose: Pose
    speed_m_s: float
    camera: Camera


class PictureMeta(Message, frozen=True, kw_only=True):
    """Everything known of a picture but its pixels."""

    vehicle_id: int
    view_id: int
    phase: str
    t_capture_ns: int
    pose: Pose
    """As the vehicle measured it."""
    position_sigma_m: float
    """How exactly, per axis."""
    speed_m_s: float
    camera: Camera
    sha256: str
    size_bytes: int


class SensorPicture(Message, frozen=True, kw_only=True):
    """Bridge to vehicle: the camera's read-out, as JPEG."""

    meta: PictureMeta
    jpeg: bytes


class PictureChunk(Message, frozen=True, kw_only=True):
    """Vehicle to ground: one piece of a JPEG. The ground acknowledges by SHA-256 or asks again."""

    meta: PictureMeta
    index: int
    count: int
    data: Chunk


class PictureAck(Message, frozen=True, kw_only=True):
    """Ground to vehicle: received and written to disk (missing is empty), or which chunks to send again."""

    view_id: int
    sha256: str
    missing: list[int] = []


# --- range sensor ----------------------------------------------------------------------------------------------------


class RangeScan(Message, frozen=True, kw_only=True):
    """Simulated short-range obstacle sensor: one range per direction of `missions.sensors.RANGE_DIRECTIONS`,
    body at this position, directions in ENU axes; inf where nothing is within reach."""

    vehicle_id: int
    t_ns: int
    position_enu_m: Vector
    ranges_m: list[float]


class RangeHits(Message, frozen=True, kw_only=True):
    """Vehicle to ground: where its range sensor has hit something for the first time, one point per small cell, so that
    the ways of others keep clear of it too. No map is made of it."""

    t_ns: int
    points_enu_m: list[Vector]


# --- maps ------------------------------------------------------------------------------------------------------------


class MapSnapshot(Message, frozen=True, kw_only=True):
    """The ground station's knowledge of space, for onboard checks. state_zlib: zlib of uint8 (nx, ny, nz), C order:
    0 unknown, 1 free, 2 occupied."""

    t_ns: int
    origin_enu_m: Vector
    voxel_m: float
    shape: tuple[int, int, int]
    state_zlib: bytes


# --- status for people -----------------------------------------------------------------------------------------------


class VehicleStatus(Message, frozen=True, kw_only=True):
    """One line of the progress display."""

    vehicle_id: int
    mode: str
    battery_percent: float
    views_done: int
    views_left: int
    alive: bool


class Status(Message, frozen=True, kw_only=True):
    """What a person wants to know, a few times per wall second."""

    phase: str
    t_ns: int
    coverage: float
    pictures: int
    seconds_left: float
    vehicles: list[VehicleStatus]
    note: str = ""


def _spec_hash() -> str:
    types = sorted((c for c in Message.__subclasses__()), key=lambda c: c.__name__)
    text = repr([(c.__name__, [(f.name, str(f.type)) for f in msgspec.structs.fields(c)]) for c in types])
    return hashlib.sha256(text.encode()).hexdigest()[:16]


SPEC_HASH = _spec_hash()
"""Peers compare this at Join; different message definitions never talk."""
