"""What a person or a program that watches a mission sees and may say, as JSON on the topics `g/live/...`.

Nothing here belongs to the lock-step: updates are for looking at, and commands come when somebody sends them. A watcher
says `LiveHello` every few seconds and gets one `LiveUpdate` after the other, each with what is new since the one
before; the first, and any that it asks for with `whole`, has everything. Metres, ENU, seconds of simulated time.
"""

from __future__ import annotations

from typing import Literal

import msgspec

from missions.camera import Camera, Pose
from missions.messages import Vector

ALL = 0
"""The vehicle id that stands for every vehicle."""


class LiveMessage(msgspec.Struct, frozen=True, kw_only=True):
    """Base: unknown fields are passed over, so that watchers of other versions can read along."""


class LiveHello(LiveMessage, frozen=True, kw_only=True):
    """Somebody watches; say it at least every five seconds."""

    name: str
    whole: bool = False
    """The next update shall have everything."""


# --- what is seen ----------------------------------------------------------------------------------------------------


class LiveVehicle(LiveMessage, frozen=True, kw_only=True):
    """One vehicle now. `stage` is where the mission has it, `mode` what it says itself."""

    vehicle_id: int
    stage: str
    mode: str
    position_enu_m: Vector
    yaw_enu_rad: float
    gimbal_elevation_rad: float
    speed_m_s: float
    battery_percent: float
    home_percent: float
    """What flying home from here takes, detours included."""
    views_done: int
    views_left: int
    next_waypoint: int
    """Index in its plan of the waypoint that it flies to."""
    flying: bool
    held: bool
    """Paused, or called home, by an operator: it waits until it is resumed."""
    dropped: bool
    """Out of the mission, until it is added, for the first time or again."""
    reserve: bool = False
    """It has taken no part so far."""
    swaps_left: int = 0
    """Fresh batteries that wait for it at its pad."""
    trail_enu_m: list[Vector] = []
    """Where it was since the last update."""


class LivePlan(LiveMessage, frozen=True, kw_only=True):
    """What a vehicle has on board, and the views that it is to fly after that."""

    vehicle_id: int
    waypoints_enu_m: list[Vector]
    later_enu_m: list[Vector]


class LivePicture(LiveMessage, frozen=True, kw_only=True):
    """A picture on the ground station's disk."""

    vehicle_id: int
    view_id: int
    phase: str
    t_s: float
    pose: Pose
    camera: Camera
    file: str
    """Path on the ground station's machine."""


class LiveMap(LiveMessage, frozen=True, kw_only=True):
    """Voxels that have become solid or are not any more; lower corners at origin + index * voxel."""

    origin_enu_m: Vector
    voxel_m: float
    solid: list[tuple[int, int, int]]
    gone: list[tuple[int, int, int]]


class LiveRegion(LiveMessage, frozen=True, kw_only=True):
    """A box that an operator has marked."""

    region_id: int
    kind: Literal["important", "forbidden"]
    lower_enu_m: Vector
    upper_enu_m: Vector


AlarmName = Literal["missing", "lost", "disk", "lands out", "silent", "little energy", "returns",
                    "does not take off", "says", "waits for others", "waits for you", "dropped", "waits for start"]
"""docs/operating.md says of each what it means and what to do."""
Severity = Literal["danger", "warning", "notice"]


class LiveAlarm(LiveMessage, frozen=True, kw_only=True):
    """Something that a person should know, in plain words."""

    name: AlarmName
    severity: Severity
    text: str
    vehicle_id: int = ALL


class LiveSite(LiveMessage, frozen=True, kw_only=True):
    """What does not change: the mission and its limits. The fence is the mission's own; `LiveState` has the present
    one."""

    title: str
    object_lower_enu_m: Vector
    object_upper_enu_m: Vector
    ground_up_m: float
    fence_lower_enu_m: Vector
    fence_upper_enu_m: Vector
    limit_lower_enu_m: Vector
    """How far the fence may be moved out."""
    limit_upper_enu_m: Vector
    pads_enu_m: list[Vector]
    survey_range_m: float
    """Pictures show the structure up to this far."""
    reserve_percent: float
    threshold_percent: float


class LivePlaying(LiveMessage, frozen=True, kw_only=True):
    """A recording that is played again."""

    speed: float
    """Recorded seconds per wall second; 0 is as fast as possible."""
    paused: bool


class LiveState(LiveMessage, frozen=True, kw_only=True):
    """The mission now."""

    phase: str
    started: bool
    t_s: float
    wall_s: float
    """Since the ground station started."""
    coverage: float
    """Estimated share of the structure that was seen."""
    goal_coverage: float | None
    views_done: int
    views_total: int
    """Of the survey; 0 before it is planned."""
    pictures: int
    seconds_left: float
    fence_lower_enu_m: Vector
    fence_upper_enu_m: Vector
    vehicles: list[LiveVehicle]
    regions: list[LiveRegion]
    alarms: list[LiveAlarm]
    note: str
    """The newest line of the mission's log."""
    playing: LivePlaying | None = None
    """None for a mission that is under way."""


class LiveUpdate(LiveMessage, frozen=True, kw_only=True):
    """What is new. With `whole` it has everything: forget what was known before."""

    seq: int
    whole: bool
    site: LiveSite
    state: LiveState
    plans: list[LivePlan] = []
    pictures: list[LivePicture] = []
    map: LiveMap | None = None
    curve: list[tuple[float, float, float]] = []
    """(t_s, coverage, share of the survey that is flown)."""


# --- what an operator says -------------------------------------------------------------------------------------------


class Action(LiveMessage, frozen=True, kw_only=True, tag_field="do"):
    """Base of all that an operator can ask for."""


class Start(Action, frozen=True, kw_only=True, tag="start"):
    """Begin, where the mission was told to wait for it."""


class Pause(Action, frozen=True, kw_only=True, tag="pause"):
    """Hold where it is and keep the plan."""

    vehicle_id: int = ALL


class Resume(Action, frozen=True, kw_only=True, tag="resume"):
    """Go on after a pause, or take off again after being called home."""

    vehicle_id: int = ALL


class Home(Action, frozen=True, kw_only=True, tag="home"):
    """Return, land on the pad and wait there until resumed; it keeps its views."""

    vehicle_id: int = ALL


class Land(Action, frozen=True, kw_only=True, tag="land"):
    """Land where it is, or at home where what is below is not known to be free; it flies no more in this mission."""

    vehicle_id: int


class Drop(Action, frozen=True, kw_only=True, tag="drop"):
    """Out of the mission: it returns, and the others get its views."""

    vehicle_id: int


class Add(Action, frozen=True, kw_only=True, tag="add"):
    """A vehicle of the reserve, or one that was dropped, takes part from now on."""

    vehicle_id: int


class Abort(Action, frozen=True, kw_only=True, tag="abort"):
    """Everybody returns and the mission is over; what was taken is kept."""


class MoveFence(Action, frozen=True, kw_only=True, tag="fence"):
    """The box in which is flown from now on. Where it is wider than what the vehicles have on board they have to accept
    it; what it adds is unknown until pictures show it."""

    lower_enu_m: Vector
    upper_enu_m: Vector


class MarkRegion(Action, frozen=True, kw_only=True, tag="mark"):
    """More views where it is important; no legs where it is forbidden."""

    kind: Literal["important", "forbidden"]
    lower_enu_m: Vector
    upper_enu_m: Vector


class ClearRegion(Action, frozen=True, kw_only=True, tag="clear"):
    """Forget a marked region."""

    region_id: int


class SetGoal(Action, frozen=True, kw_only=True, tag="goal"):
    """Explore until this share of the structure is seen, as estimated."""

    coverage: float


class SetSpeed(Action, frozen=True, kw_only=True, tag="speed"):
    """Play a recording so many times as fast as real time; 0 is as fast as possible."""

    speed: float


AnyAction = (Start | Pause | Resume | Home | Land | Drop | Add | Abort | MoveFence | MarkRegion | ClearRegion | SetGoal
             | SetSpeed)


class OperatorCommand(LiveMessage, frozen=True, kw_only=True):
    """An action with an id of the sender's choice, new for each command, by which it knows the answer.

    Either may be lost on the way: sent again with the same id it is not carried out twice, and answered again.
    """

    command_id: str
    action: AnyAction


class VehicleAnswer(LiveMessage, frozen=True, kw_only=True):
    """What one vehicle answered."""

    vehicle_id: int
    accepted: bool
    text: str


class OperatorAnswer(LiveMessage, frozen=True, kw_only=True):
    """Sent once everybody who was asked has answered; accepted: by all of them."""

    command_id: str
    accepted: bool
    text: str
    vehicles: list[VehicleAnswer] = []
