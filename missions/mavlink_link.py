"""A ground station's end of a real MAVLink link: UDP, TCP or serial through pymavlink, in wall time.

Addresses are written as URLs: `udpout://127.0.0.1:14550` (send there first), `udpin://127.0.0.1:14550` (wait there),
`tcp://127.0.0.1:5760`, `serial:///dev/ttyACM0:57600`.
"""

from __future__ import annotations

import re
import time
from collections import deque
from collections.abc import Callable
from types import TracebackType
from typing import Any

from pymavlink import mavutil
from pymavlink.dialects.v20 import common as mav

from missions.errors import LinkError, UserError
from missions.mavlink import AUTOPILOT_COMPONENT, GROUND_COMPONENT, GROUND_SYSTEM, Endpoint
from missions.mission_transfer import Transfer
from missions.signing import Signing

HEARTBEAT_S, ASK_AGAIN_S, POLL_S = 1.0, 0.2, 0.02
LISTEN_S, DISCOVERY_S = 5.0, 1.5
"""How long to wait for the first vehicle, and then for others before one is taken for the only one."""
TEXTS, TEXT_BYTES = 12, 50
"""Texts that are kept; one that fills its message goes on in the next."""
_URL = re.compile(r"(?P<kind>udpin|udpout|tcp)://(?P<address>[^:/]+:\d{1,5})|serial://(?P<device>[^:]+)(:(?P<baud>\d+))?")


class MavlinkLink:
    """Sends and receives messages as a ground station that shows itself once a second. Use as a context manager."""

    def __init__(self, url: str, signing: Signing | None = None) -> None:
        """Raises UserError for an address that is none, LinkError when nothing can be opened there."""
        self.url = url
        self._connection = open_connection(url)
        self._endpoint = Endpoint(GROUND_SYSTEM, GROUND_COMPONENT, signing)
        self._heartbeat_s = 0.0
        self._texts: deque[tuple[int, str]] = deque(maxlen=TEXTS)

    def __enter__(self) -> MavlinkLink:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        self._connection.close()

    def send(self, messages: list[mav.MAVLink_message]) -> None:
        """Off they go, or are lost."""
        for message in messages:
            self._connection.write(self._endpoint.pack(message))

    def receive(self) -> list[Any]:
        """What has come, after POLL_S at the latest; in between the heartbeat goes out."""
        now_s = time.monotonic()
        if now_s - self._heartbeat_s >= HEARTBEAT_S:
            self._heartbeat_s = now_s
            self.send([mav.MAVLink_heartbeat_message(mav.MAV_TYPE_GCS, mav.MAV_AUTOPILOT_INVALID, 0, 0,
                                                     mav.MAV_STATE_ACTIVE, 3)])
        self._connection.select(POLL_S)
        chunks = []
        while data := self._connection.recv(2**16):
            chunks.append(bytes(data))
        messages = self._endpoint.parse(chunks)
        self._texts += [(m.get_srcSystem(), m.text) for m in messages if m.get_type() == "STATUSTEXT"]
        return messages

    def take_texts(self, system: int) -> str:
        """What a vehicle has said to people of late, in one line, once."""
        said = "".join(text if len(text) == TEXT_BYTES else text + "; " for who, text in self._texts if who == system)
        self._texts.clear()
        return said.removesuffix("; ")


def vehicles(link: MavlinkLink) -> dict[int, int]:
    """System ids and MAV_AUTOPILOT of those that are heard within DISCOVERY_S of the first one. Raises LinkError."""
    found: dict[int, int] = {}
    until_s = time.monotonic() + LISTEN_S
    while time.monotonic() < until_s:
        for message in link.receive():
            if message.get_type() == "HEARTBEAT" and message.get_srcComponent() == AUTOPILOT_COMPONENT \
                    and message.autopilot != mav.MAV_AUTOPILOT_INVALID:
                until_s = until_s if found else time.monotonic() + DISCOVERY_S
                found[message.get_srcSystem()] = message.autopilot
    if not found:
        raise LinkError(f"{link.url}: no vehicle was heard within {LISTEN_S:.0f} s; is it on, and does it send there?")
    return found


def home_position(link: MavlinkLink, system: int) -> tuple[float, float, float]:
    """Latitude and longitude in degrees and altitude above the sea of a vehicle's home. Raises LinkError."""
    ask = mav.MAVLink_command_long_message(system, AUTOPILOT_COMPONENT, mav.MAV_CMD_REQUEST_MESSAGE, 0,
                                           mav.MAVLINK_MSG_ID_HOME_POSITION, 0, 0, 0, 0, 0, 0)
    until_s, ask_s = time.monotonic() + LISTEN_S, 0.0
    while time.monotonic() < until_s:
        if time.monotonic() >= ask_s:
            ask_s = time.monotonic() + ASK_AGAIN_S
            link.send([ask])
        for message in link.receive():
            if message.get_type() == "HOME_POSITION" and message.get_srcSystem() == system:
                return message.latitude / 1e7, message.longitude / 1e7, message.altitude / 1000.0
    raise LinkError(f"{link.url}: vehicle {system} did not say where its home is.")


def run(link: MavlinkLink, transfer: Transfer, progress: Callable[[float], None] = lambda share: None) -> None:
    """Drive a transfer to its end. progress: told the share 0-1 that is done, whenever something was heard."""
    while not transfer.over:
        messages = link.receive()
        now_s = time.monotonic()
        for message in messages:
            link.send(transfer.receive(message, now_s))
        link.send(transfer.poll(now_s))
        if messages:
            progress(transfer.progress)


def open_connection(url: str) -> Any:
    """pymavlink's connection to an address, for its bytes alone. Raises UserError, LinkError."""
    found = _URL.fullmatch(url)
    if found is None:
        raise UserError(f"{url}: is no MAVLink address; give udpout://HOST:PORT, udpin://HOST:PORT, tcp://HOST:PORT or "
                        "serial://DEVICE:BAUD.")
    device = found["device"] or f"{found['kind']}:{found['address']}"
    try:
        return mavutil.mavlink_connection(device, baud=int(found["baud"] or 57600), source_system=GROUND_SYSTEM,
                                          source_component=GROUND_COMPONENT, retries=1)
    except (OSError, OverflowError) as e:
        raise LinkError(f"{url}: cannot be opened ({e}).") from e
