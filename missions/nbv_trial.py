"""The contract between the tester of next-best-view methods and a method under test, which runs in its own process.

The tester sends a `TrialBrief`, then `Frame`s, and an `Ask` whenever a vehicle has arrived; the method answers each Ask
with a `Choice`, one step of the 5-D lattice of MACARONS (Guedon et al., CVPR 2023). That is all a method ever learns.
Vehicles are numbered from 1.
"""

from __future__ import annotations

from typing import IO, Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from missions.camera import Camera, Pose
from missions.errors import ProtocolError
from missions.mission import FleetSpec
from missions.mission_section import Point
from missions.pose_lattice import Index5, PoseLattice

LENGTH_BYTES = 4
LARGEST_MESSAGE = 1 << 28


class _Message(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag=True):
    pass


class TrialBrief(_Message, frozen=True, kw_only=True):
    """All that is known before the first picture. Outside the object's box and above the ground there is nothing of the
    object, but what is free only the pictures say."""

    method: str
    seed: int
    object_min_enu_m: Point
    object_max_enu_m: Point
    ground_up_m: float
    camera_min_enu_m: Point
    """The box that the lattice divides; views stand at the centres of its cells."""
    camera_max_enu_m: Point
    shape: tuple[int, int, int]
    elevations_deg: tuple[float, ...]
    azimuths: int
    camera: Camera
    sensing_range_m: float
    """What is farther away counts as not seen."""
    frames_per_step: int
    """Pictures on the way to each key pose, the one at the key pose included."""
    starts: list[Index5]
    """Where the vehicles begin, one per vehicle."""
    poses: int
    """Key poses of all vehicles together, the starts included, after which the trial ends."""
    fleet: FleetSpec = FleetSpec()
    """Size, clearance, speed and agility of the vehicles."""
    options: dict[str, str] = {}
    """Settings of the method, as typed."""

    @property
    def lattice(self) -> PoseLattice:
        """The lattice of views."""
        return PoseLattice(self.camera_min_enu_m, self.camera_max_enu_m, self.shape, self.elevations_deg,
                           self.azimuths)


class Frame(_Message, frozen=True, kw_only=True):
    """A picture and where it was taken."""

    vehicle: int
    pose: Pose
    index: Index5 | None
    """The lattice's index where this is a key pose; None on the way."""
    rgb: NDArray[np.uint8]
    """(h, w, 3)"""


class Ask(_Message, frozen=True, kw_only=True):
    """A vehicle has arrived, all of its frames were sent: where next? candidates: its neighbours on the lattice but for
    the positions that other vehicles hold or fly to. The truth has no say in them."""

    vehicle: int
    candidates: list[Index5]


class Choice(_Message, frozen=True, kw_only=True):
    """A method's decision."""

    vehicle: int
    index: Index5
    """One of the candidates; or where the vehicle is, to wait until another vehicle has arrived somewhere."""
    predicted_gain: float = 0.0
    """Expected new surface of this view, m^2 (0 where the method has no such notion)."""
    coverage_estimate: float = 0.0
    """Share of the object's reachable surface that is believed to be covered by now, 0 to 1."""
    stop: bool = False
    """The method would end the exploration here; the tester notes it and goes on."""


class Answer(_Message, frozen=True, kw_only=True):
    """What the method's process says to an Ask. seconds of wall time, over all frames since its last answer;
    seconds_processor: of all its threads together, over the same; 0 where nobody measures it."""

    choice: Choice
    seconds_seeing: float
    seconds_choosing: float
    peak_memory_mib: float
    seconds_processor: float = 0.0


class Failure(_Message, frozen=True, kw_only=True):
    """The method cannot go on, in one sentence. `wrong_input`: because of what the user asked for."""

    reason: str
    wrong_input: bool = False


ToMethod = TrialBrief | Frame | Ask
FromMethod = Answer | Failure


def write_message(stream: IO[bytes], message: ToMethod | FromMethod) -> None:
    """One message as msgpack, behind its length in four bytes."""
    body = msgspec.msgpack.encode(message, enc_hook=_encoded_array)
    stream.write(len(body).to_bytes(LENGTH_BYTES, "big") + body)
    stream.flush()


def read_to_method(stream: IO[bytes]) -> ToMethod | None:
    """The next message from the tester; None when it has closed the stream. Raises ProtocolError."""
    message: ToMethod | None = _read(stream, _TO_METHOD)
    return message


def read_from_method(stream: IO[bytes]) -> FromMethod | None:
    """The next message from the method; None when its process has gone. Raises ProtocolError."""
    message: FromMethod | None = _read(stream, _FROM_METHOD)
    return message


def _read(stream: IO[bytes], decoder: msgspec.msgpack.Decoder[Any]) -> Any:
    head = stream.read(LENGTH_BYTES)
    if not head:
        return None
    length = int.from_bytes(head, "big")
    if length > LARGEST_MESSAGE:
        raise ProtocolError(f"a message of {length} bytes was announced")
    body = stream.read(length)
    if len(body) < length:
        return None
    try:
        return decoder.decode(body)
    except msgspec.DecodeError as e:
        raise ProtocolError(f"a message of the trial cannot be read: {e}") from e


def _encoded_array(value: object) -> object:
    if isinstance(value, np.ndarray):
        return value.shape, value.tobytes()
    raise NotImplementedError(f"{type(value)} does not travel")


def _decoded_array(_: type, value: Any) -> NDArray[np.uint8]:
    shape, content = value
    return np.frombuffer(content, dtype=np.uint8).reshape(shape)


_TO_METHOD: msgspec.msgpack.Decoder[Any] = msgspec.msgpack.Decoder(ToMethod, dec_hook=_decoded_array)
_FROM_METHOD: msgspec.msgpack.Decoder[Any] = msgspec.msgpack.Decoder(FromMethod, dec_hook=_decoded_array)
