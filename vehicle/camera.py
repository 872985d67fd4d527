"""The camera: shutter, storage, and pictures sent until the ground has them."""

from __future__ import annotations

import hashlib
import logging
import math
from pathlib import Path

import msgspec

from missions.disk import Disk
from missions.messages import MAX_CHUNK, PictureAck, PictureChunk, PictureMeta, SensorPicture, ShutterRequest
from missions.mission import CameraSpec
from vehicle.simulator import Kinematics

log = logging.getLogger(__name__)

SEND_AGAIN_NS = 5_000_000_000
READ_OUT_NS = 2_000_000_000
CHECK_NS = 1_000_000_000
ACKNOWLEDGED = ".ack"
"""Ends the name of a file beside a picture that the ground has."""
FIRST_OWN_VIEW_ID = 2_000_000
"""Views beyond those that a ground station of ours numbers."""


class CameraPayload:
    """Pictures go to the vehicle's own storage first and stay owed to the ground until it acknowledges them."""

    def __init__(self, vehicle_id: int, spec: CameraSpec, storage: Path) -> None:
        self._id, self._storage, self._card = vehicle_id, storage, Disk(storage)
        self._unwritten: dict[tuple[int, str], SensorPicture] = {}
        """What the card has not taken; only here until it does."""
        self._checked_ns = 0
        self._cameras = {"explore": spec.explore_camera(), "survey": spec.survey_camera()}
        self.exposed: set[tuple[str, int]] = set()
        self.captured: list[PictureMeta] = []
        self._own_view_id = FIRST_OWN_VIEW_ID
        self._awaited: dict[tuple[str, int], int] = {}
        self._owed: dict[tuple[int, str], tuple[PictureMeta, int]] = {}

    def remember(self) -> None:
        """After a restart: pictures on the card are taken, and owed unless the ground has acknowledged them."""
        metas = [msgspec.json.decode(path.read_bytes(), type=PictureMeta) for path in self._storage.glob("*.json")]
        for meta in sorted(metas, key=lambda m: (m.t_capture_ns, m.view_id)):
            self.exposed.add((meta.phase, meta.view_id))
            self.captured.append(meta)
            if not self._path(meta).with_suffix(ACKNOWLEDGED).exists():
                self._owed[meta.view_id, meta.sha256] = (meta, -SEND_AGAIN_NS)

    def new_view_id(self) -> int:
        """An id for a view that no ground station of ours has numbered."""
        self._own_view_id += 1
        return self._own_view_id

    def expose(self, view_id: int, phase: str, kinematics: Kinematics, t_ns: int) -> ShutterRequest | None:
        """Open the shutter; None when this view was taken already (a repeated command makes no second picture)."""
        if (phase, view_id) in self.exposed:
            return None
        self.exposed.add((phase, view_id))
        self._awaited[phase, view_id] = t_ns
        return ShutterRequest(vehicle_id=self._id, view_id=view_id, phase=phase, t_capture_ns=t_ns,
                              pose=kinematics.pose, speed_m_s=kinematics.speed_m_s, camera=self._cameras[phase])

    def store(self, picture: SensorPicture, t_ns: int) -> list[PictureChunk]:
        """Write a read-out to storage, then cut it into chunks for the ground."""
        meta = picture.meta
        self._awaited.pop((meta.phase, meta.view_id), None)
        if not self._written(picture):
            self._unwritten[meta.view_id, meta.sha256] = picture
        self.captured.append(meta)
        self._owed[meta.view_id, meta.sha256] = (meta, t_ns)
        return _chunks(meta, picture.jpeg)

    def acknowledge(self, ack: PictureAck, t_ns: int) -> list[PictureChunk]:
        """Strike off what the ground has; the chunks that it misses."""
        owed = self._owed.get((ack.view_id, ack.sha256))
        if owed is None:
            return []
        if not ack.missing:
            del self._owed[ack.view_id, ack.sha256]
            self._unwritten.pop((ack.view_id, ack.sha256), None)
            self._card.write(self._path(owed[0]).with_suffix(ACKNOWLEDGED), b"")
            return []
        self._owed[ack.view_id, ack.sha256] = (owed[0], t_ns)
        chunks = self._from_storage(owed[0])
        return [chunks[i] for i in sorted(set(ack.missing)) if 0 <= i < len(chunks)]

    def send_again(self, t_ns: int) -> list[PictureChunk]:
        """Chunks of pictures that were not acknowledged in time."""
        out: list[PictureChunk] = []
        for key, (meta, sent_ns) in self._owed.items():
            if t_ns - sent_ns >= SEND_AGAIN_NS:
                self._owed[key] = (meta, t_ns)
                out.extend(self._from_storage(meta))
        return out

    def owe_at_once(self) -> None:
        """Whoever takes the pictures may have missed those that were sent: all that are owed are sent again now."""
        self._owed = {key: (meta, -SEND_AGAIN_NS) for key, (meta, _) in self._owed.items()}

    @property
    def trouble(self) -> str:
        """Why the card takes no pictures, to follow "the disk"; "" when it does."""
        return self._card.trouble

    def mind_the_card(self, t_ns: int) -> None:
        """Try once a second to write what the card did not take."""
        if not self._card.trouble or t_ns - self._checked_ns < CHECK_NS:
            return
        self._checked_ns = t_ns
        self._card.check()
        if not self._card.trouble:
            self._unwritten = {key: p for key, p in self._unwritten.items() if not self._written(p)}

    def lost(self, t_ns: int) -> list[int]:
        """Views whose read-out has not come; each is told once, and may be taken again."""
        gone = [v for v, since in self._awaited.items() if t_ns - since >= READ_OUT_NS]
        for view in gone:
            del self._awaited[view]
            self.exposed.discard(view)
        return [view_id for _, view_id in gone]

    @property
    def owed(self) -> int:
        """Pictures that the ground has not acknowledged."""
        return len(self._owed)

    def _from_storage(self, meta: PictureMeta) -> list[PictureChunk]:
        kept = self._unwritten.get((meta.view_id, meta.sha256))
        try:
            return _chunks(meta, self._path(meta).read_bytes() if kept is None else kept.jpeg)
        except OSError as e:
            log.error("uav%d: picture %d cannot be read from the card: %s", self._id, meta.view_id, e)
            return []

    def _written(self, picture: SensorPicture) -> bool:
        path = self._path(picture.meta)
        return (self._card.write(path, picture.jpeg)
                and self._card.write(path.with_suffix(".json"), msgspec.json.encode(picture.meta)))

    def _path(self, meta: PictureMeta) -> Path:
        return self._storage / f"{meta.phase}_{meta.view_id}.jpg"


def _chunks(meta: PictureMeta, jpeg: bytes) -> list[PictureChunk]:
    count = max(1, math.ceil(len(jpeg) / MAX_CHUNK))
    return [PictureChunk(meta=meta, index=i, count=count, data=jpeg[i * MAX_CHUNK:(i + 1) * MAX_CHUNK])
            for i in range(count)]


def intact(picture: SensorPicture) -> bool:
    """Whether the read-out is the one that its meta data describes."""
    return hashlib.sha256(picture.jpeg).hexdigest() == picture.meta.sha256
