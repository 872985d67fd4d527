"""UDP doors: ground stations that are not ours meet the vehicles here, as behind a MAVLink router.

Frames are passed on as they are. From outside, a frame with a target system goes to that vehicle, one without to all;
from a vehicle, a frame with a target goes to whoever has shown that id, one without to all who are there.
"""

from __future__ import annotations

import logging
import re
import select
import socket
import time
from collections import deque
from dataclasses import dataclass, field

from pymavlink.dialects.v20 import common as mav

from missions.errors import UserError
from missions.mavlink import AUTOPILOT_COMPONENT, Endpoint
from missions.mission import MavlinkSpec
from missions.tlog import Tlog
from sim_bridge.duplicates import Conflict, Duplicates
from sim_bridge.frame_header import Header, boot_ms_of, split, uid_of

log = logging.getLogger(__name__)

Address = tuple[str, int]
FORGET_S = 30.0
"""A visitor that has been silent for this long is gone."""
DATAGRAM_BYTES = 65536
ECHOES = 1024
"""So many of the frames last sent are known again when they come back."""
_URL = re.compile(r"(udp|udpin|udpout)://([^:/]+):(\d+)")


@dataclass
class Visitor:
    """Somebody at a door: the ids it has shown, and when it was last heard."""

    ids: set[tuple[int, int]] = field(default_factory=set)
    heard_s: float = 0.0


class Door:
    """One socket. `visitors` holds who is there; one that was called (udpout) stays."""

    def __init__(self, url: str, vehicles: frozenset[int]) -> None:
        """vehicles: ids of those behind the door. Raises UserError."""
        found = _URL.fullmatch(url)
        if found is None:
            raise UserError(f"mavlink.open = {url!r}: not a door; write udpin://127.0.0.1:14540 or "
                            "udpout://127.0.0.1:14550.")
        self.vehicles = vehicles
        host, port, waits = found[2], int(found[3]), found[1] == "udpin"
        self._called: Address | None = None if waits else (host, port)
        self.visitors: dict[Address, Visitor] = {} if self._called is None else {self._called: Visitor()}
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self.socket.bind((host, port) if waits else ("127.0.0.1" if _is_loopback(host) else "", 0))
        except OSError as e:
            self.socket.close()
            raise UserError(f"mavlink.open = {url!r}: cannot be opened ({e.strerror}); give a free port.") from e
        self.socket.setblocking(False)

    def receive(self, now_s: float) -> list[tuple[bytes, Address]]:
        """Frames that have come, and where from; notes who sent them."""
        frames: list[tuple[bytes, Address]] = []
        while True:
            try:
                datagram, address = self.socket.recvfrom(DATAGRAM_BYTES)
            except BlockingIOError:
                break
            except ConnectionError:  # nobody listens where we called
                continue
            fresh = split(datagram)
            visitor = self.visitors.setdefault(address, Visitor())
            visitor.heard_s = now_s
            visitor.ids |= {(h.system, h.component) for h in map(Header.of, fresh)}
            frames += [(frame, address) for frame in fresh]
        gone = [a for a, v in self.visitors.items() if a != self._called and now_s - v.heard_s > FORGET_S]
        for address in gone:
            del self.visitors[address]
        return frames

    def send(self, frame: bytes, header: Header) -> None:
        """To all visitors, or to those that the frame is for."""
        for address, visitor in self.visitors.items():
            if header.for_all or any(header.reaches(*shown) for shown in visitor.ids):
                try:
                    self.socket.sendto(frame, address)
                except OSError as e:  # a full buffer or a vanished route loses a datagram, as UDP does
                    log.debug("door: %s to %s", e, address)


class Doors:
    """All doors of a mission. Use `close` at the end."""

    def __init__(self, spec: MavlinkSpec, vehicles: int, tlog: Tlog | None = None) -> None:
        """tlog: keeps everything that passes. Raises UserError when a door cannot be opened."""
        self._tlog = tlog
        self._duplicates, self._told = Duplicates(), frozenset[Conflict]()
        self._sent: deque[bytes] = deque(maxlen=ECHOES)
        everybody = range(1, vehicles + 1)
        urls = [(url, frozenset(everybody)) for url in spec.open]
        if spec.open_each:
            urls += [(_with_port(spec.open_each, k - 1), frozenset({k})) for k in everybody]
        self.doors: list[Door] = []
        try:
            for url, behind in urls:
                self.doors.append(Door(url, behind))
        except UserError:
            self.close()
            raise

    def wait(self, seconds: float) -> bool:
        """Wait so long for somebody to knock; whether somebody did."""
        return bool(select.select([door.socket for door in self.doors], [], [], seconds)[0])

    def receive(self, t_ns: int) -> list[tuple[int, list[bytes]]]:
        """By vehicle id, the frames that have come for it by simulated time t_ns. What is for an id that more than one
        vehicle has is kept back: nobody knows who would obey."""
        now_s = time.monotonic()
        boxes: dict[int, list[bytes]] = {}
        came = [(door, Header.of(frame), frame, address) for door in self.doors
                for frame, address in door.receive(now_s)]
        self._keep([frame for _, _, frame, _ in came], t_ns)
        for door, header, frame, address in came:
            posed = header.system in door.vehicles and header.component == AUTOPILOT_COMPONENT
            if posed and frame not in self._sent:  # a router between two doors gives us back what our vehicles said
                self._note(header.system, address, frame, now_s)
        contested = self._contested(now_s)
        for door, header, frame, _ in came:
            if header.target_system not in contested:
                for vehicle_id in (v for v in sorted(door.vehicles) if header.target_system in (0, v)):
                    boxes.setdefault(vehicle_id, []).append(frame)
        return sorted(boxes.items())

    def _note(self, system: int, source: Address | str, frame: bytes, now_s: float) -> None:
        self._duplicates.heard(system, source, now_s, boot_ms=boot_ms_of(frame), uid=uid_of(frame))

    def _contested(self, now_s: float) -> set[int]:
        """Ids that more than one vehicle has; everybody is told of it once."""
        found = frozenset(self._duplicates.conflicts(now_s))
        for conflict in sorted(found - self._told, key=lambda c: c.system):
            log.warning("%s", conflict.reason)
            frame = _text(conflict)
            for door in self.doors:
                door.send(frame, Header.of(frame))
        self._told = found
        return {c.system for c in found}

    def send(self, vehicle_id: int, frames: list[bytes], t_ns: int) -> None:
        """Pass on what a vehicle says at simulated time t_ns."""
        self._keep(frames, t_ns)
        self._sent.extend(frames)
        now_s = time.monotonic()
        for frame in frames:
            self._note(vehicle_id, "this mission", frame, now_s)
            header = Header.of(frame)
            for door in self.doors:
                if vehicle_id in door.vehicles:
                    door.send(frame, header)

    def _keep(self, frames: list[bytes], t_ns: int) -> None:
        if self._tlog is not None:
            self._tlog.write(frames, t_ns)

    def close(self) -> None:
        """Nobody comes in any more."""
        if self._tlog is not None:
            self._tlog.flush()
        for door in self.doors:
            door.socket.close()


def _text(conflict: Conflict) -> bytes:
    """STATUSTEXT, as from a computer on board of the vehicle that is meant: its autopilot knows nothing of this."""
    text = f"system id {conflict.system} is used twice: commands refused".encode()[:50]
    endpoint = Endpoint(conflict.system, mav.MAV_COMP_ID_ONBOARD_COMPUTER)
    return endpoint.pack(mav.MAVLink_statustext_message(mav.MAV_SEVERITY_CRITICAL, text))


def _with_port(url: str, more: int) -> str:
    head, _, port = url.rpartition(":")
    return f"{head}:{int(port) + more}" if port.isdigit() else url


def _is_loopback(host: str) -> bool:
    return host == "localhost" or host.startswith("127.")
