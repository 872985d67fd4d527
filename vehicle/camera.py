"""The camera: shutter, storage, and pictures sent until the ground has them."""

from __future__ import annotations

import hashlib
import math
from pathlib import Path

import msgspec

from missions.messages import MAX_CHUNK, PictureAck, PictureChunk, PictureMeta, SensorPicture, ShutterRequest
from missions.mission import CameraSpec
from vehicle.simulator import Kinematics

SEND_AGAIN_NS = 5_000_000_000
READ_OUT_NS = 2_000_000_000


class CameraPayload:
    """Pictures go to the vehicle's own storage first and stay owed to the ground until it acknowledges them."""

    def __init__(self, vehicle_id: int, spec: CameraSpec, storage: Path) -> None:
        self._id, self._storage = vehicle_id, storage
        self._cameras = {"explore": spec.explore_camera(), "survey": spec.survey_camera()}
        self.exposed: set[tuple[str, int]] = set()
        self.captured: list[PictureMeta] = []
        self._awaited: dict[tuple[str, int], int] = {}
        self._owed: dict[tuple[int, str], tuple[PictureMeta, int]] = {}

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
        path = self._path(meta)
        path.write_bytes(picture.jpeg)
        path.with_suffix(".json").write_bytes(msgspec.json.encode(meta))
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
        return _chunks(meta, self._path(meta).read_bytes())

    def _path(self, meta: PictureMeta) -> Path:
        return self._storage / f"{meta.phase}_{meta.view_id}.jpg"


def _chunks(meta: PictureMeta, jpeg: bytes) -> list[PictureChunk]:
    count = max(1, math.ceil(len(jpeg) / MAX_CHUNK))
    return [PictureChunk(meta=meta, index=i, count=count, data=jpeg[i * MAX_CHUNK:(i + 1) * MAX_CHUNK])
            for i in range(count)]


def intact(picture: SensorPicture) -> bool:
    """Whether the read-out is the one that its meta data describes."""
    return hashlib.sha256(picture.jpeg).hexdigest() == picture.meta.sha256
