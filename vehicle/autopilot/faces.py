"""All faces of one vehicle: that of our own ground station, and that of everybody else at the doors."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from pymavlink.dialects.v20 import common as mav

from missions.clock import BRIDGE, GROUND
from missions.messages import RangeScan
from missions.mission import Mission
from missions.signing import Signing, read_key
from vehicle.autopilot.craft import Craft
from vehicle.autopilot.face import OWN_DIALECT, Face, epoch_us
from vehicle.autopilot.photos import Photos
from vehicle.dialects import DIALECTS
from vehicle.executor import Executor
from vehicle.judge import Judge
from vehicle.lease import Lease
from vehicle.settings import Settings
from vehicle.simulator import Kinematics


class Faces:
    """What goes to all links, or to one."""

    def __init__(self, mission: Mission, vehicle_id: int, executor: Executor, judge: Judge,
                 apply: Callable[[Settings], None]) -> None:
        """apply: makes new settings felt."""
        self.craft = Craft(
            vehicle_id, mission.site.anchor, executor, Photos(executor.camera), mission.camera.survey_camera(),
            Settings.of(mission), apply, mission.fleet.speed_m_s, endurance_s=60.0 * mission.airframe.hover_min,
            why_not_there=judge.why_not_there)
        self._lease, self._now_ns = Lease(), 0
        self._judge, epoch = judge, epoch_us(mission.clock.epoch_utc)
        self._faces = {GROUND: Face(self.craft, OWN_DIALECT, judge.ours, epoch)}
        if mission.mavlink.doors:
            dialect = DIALECTS[mission.mavlink.identity]
            key = mission.mavlink.signing_key
            self._faces[BRIDGE] = Face(self.craft, dialect, lambda kind, items: judge.clients(kind, items, dialect),
                                       epoch, self._lease, "hold" if dialect.streams_unasked else "manual",
                                       Signing(read_key(Path(key))) if key else None)

    def receive(self, frames: list[bytes], sender: str, t_ns: int) -> None:
        """Frames of one link; other senders have none."""
        face = self._faces.get(sender)
        if face is not None:
            face.receive(frames, t_ns)
        for text in self._judge.take_texts():
            self.text(text, mav.MAV_SEVERITY_WARNING)

    @property
    def leader_heard_ns(self) -> int | None:
        """When whoever leads at the doors, or led last, was heard last."""
        return self._lease.leader_heard_ns

    def step(self, now: Kinematics, scan: RangeScan | None, ground_leads: bool, t_ns: int) -> None:
        """Before anything is received: how things are."""
        self.craft.scan, self._now_ns = scan, t_ns
        self._lease.ground_leads = ground_leads
        for face in self._faces.values():
            face.step(now, t_ns)

    def text(self, text: str, severity: int = mav.MAV_SEVERITY_INFO) -> None:
        """A line for people."""
        for face in self._faces.values():
            face.text(text, severity)

    def reached(self, items: list[int]) -> None:
        """These items of the flight plan are done."""
        for face in self._faces.values():
            face.reached(items)
        if items:
            self.craft.plan.reached(items[-1])
        for seq in items:
            self._begin_series(seq)

    def reached_for_ground(self, items: list[int]) -> None:
        """The same for our own ground station alone, which may have missed it."""
        self._faces[GROUND].reached(items)

    def captured(self) -> None:
        """One more picture is in storage."""
        for face in self._faces.values():
            face.captured(len(self.craft.images) - 1)

    def lost(self, view_id: int, t_ns: int) -> None:
        """A picture did not come."""
        for face in self._faces.values():
            face.lost(view_id, t_ns)

    def frames(self, now: Kinematics, t_ns: int) -> dict[str, list[bytes]]:
        """By link, what is due now."""
        return {link: frames for link, face in self._faces.items() if (frames := face.frames(now, t_ns))}

    def _begin_series(self, seq: int) -> None:
        """A plan may start and stop series of pictures at its waypoints."""
        items, photos = self.craft.plan.items, self.craft.photos
        if seq >= len(items):
            return
        item = items[seq]
        if item.command == mav.MAV_CMD_IMAGE_START_CAPTURE and item.params[2] != 1.0:
            photos.start(item.params[1], int(item.params[2]), 0, (self.craft.system, 0), self._now_ns)
        elif item.command == mav.MAV_CMD_IMAGE_STOP_CAPTURE:
            photos.stop()
