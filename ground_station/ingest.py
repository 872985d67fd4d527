"""Pictures from the vehicles: chunks together, hash checked, on disk with EXIF and XMP, and only then acknowledged."""

from __future__ import annotations

import csv
import hashlib
import io
import logging
from collections.abc import Collection, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import datetime

import cv2
import numpy as np
from numpy.typing import NDArray

from ground_station.exif import SOI, with_metadata
from missions.clock import SECOND_NS
from missions.disk import Disk
from missions.errors import ProtocolError
from missions.frames import Site
from missions.lens import NONE, Distortion
from missions.messages import MAX_CHUNK, PictureAck, PictureChunk, PictureMeta, Vector
from missions.run_folder import RunFolder, write_views
from perception.lens import redrawn

log = logging.getLogger(__name__)

ASK_AGAIN_S = 0.3
CHECK_NS = SECOND_NS
MAX_PICTURE_BYTES = 64 * 1024 * 1024
PHASES = ("explore", "survey")


@dataclass
class Assembly:
    """The chunks of one picture that have arrived."""

    meta: PictureMeta
    count: int
    chunks: dict[int, bytes] = field(default_factory=dict)
    ask_ns: int = 0

    @property
    def missing(self) -> list[int]:
        """Indices that have not arrived."""
        return [i for i in range(self.count) if i not in self.chunks]

    def jpeg(self) -> bytes | None:
        """The whole picture, or None when its hash is wrong; then the chunks are dropped, to be asked for again."""
        data = b"".join(self.chunks[i] for i in range(self.count))
        if len(data) == self.meta.size_bytes and hashlib.sha256(data).hexdigest() == self.meta.sha256:
            return data
        log.warning("picture %d of vehicle %d: wrong hash, asked for again", self.meta.view_id, self.meta.vehicle_id)
        self.chunks.clear()
        return None


@dataclass(frozen=True)
class Picture:
    """A received picture; rgb (height, width, 3) uint8 is decoded for the map only."""

    meta: PictureMeta
    rgb: NDArray[np.uint8] | None


class Reassembly:
    """Chunks in, whole pictures and acknowledgements out, whatever the order, duplication or loss. No disk, no bus."""

    def __init__(self) -> None:
        self._open: dict[tuple[int, int, str], Assembly] = {}
        self._done: set[tuple[int, int, str]] = set()

    def add(self, vehicle_id: int, chunk: PictureChunk, t_ns: int) -> tuple[PictureMeta, bytes] | PictureAck | None:
        """A whole picture when this chunk completes one, a repeated acknowledgement for one already whole, else None.

        Raises ProtocolError for a chunk that contradicts itself, its sender or its picture.
        """
        _check(vehicle_id, chunk)
        key = (vehicle_id, chunk.meta.view_id, chunk.meta.sha256)
        if key in self._done:
            return PictureAck(view_id=chunk.meta.view_id, sha256=chunk.meta.sha256)
        assembly = self._open.setdefault(key, Assembly(chunk.meta, chunk.count))
        if assembly.count != chunk.count or assembly.meta != chunk.meta:
            raise ProtocolError(f"picture {chunk.meta.view_id} of vehicle {vehicle_id}: chunks disagree about it")
        assembly.chunks.setdefault(chunk.index, chunk.data)
        assembly.ask_ns = t_ns + round(ASK_AGAIN_S * SECOND_NS)
        if assembly.missing:
            return None
        data = assembly.jpeg()
        if data is None:
            assembly.ask_ns = t_ns
            return None
        del self._open[key]
        if not data.startswith(SOI):
            raise ProtocolError(f"picture {chunk.meta.view_id} of vehicle {vehicle_id} is no JPEG")
        self._done.add(key)
        return assembly.meta, data

    def overdue(self, t_ns: int) -> list[tuple[int, PictureAck]]:
        """(vehicle id, request) for every picture whose missing chunks have not come for a while."""
        out = []
        for (vehicle_id, view_id, sha256), assembly in sorted(self._open.items()):
            if t_ns >= assembly.ask_ns:
                assembly.ask_ns = t_ns + round(ASK_AGAIN_S * SECOND_NS)
                out.append((vehicle_id, PictureAck(view_id=view_id, sha256=sha256, missing=assembly.missing)))
        return out

    @property
    def unfinished(self) -> int:
        """Pictures of which only a part has arrived."""
        return len(self._open)

    def ask_again(self, meta: PictureMeta, count: int) -> None:
        """A whole picture could not be kept: it is as if nothing of it had come."""
        key = (meta.vehicle_id, meta.view_id, meta.sha256)
        self._done.discard(key)
        self._open[key] = Assembly(meta, count)

    def forget(self, vehicle_id: int) -> None:
        """Drop the unfinished pictures of a vehicle that is gone."""
        for key in [k for k in self._open if k[0] == vehicle_id]:
            del self._open[key]


class Ingest:
    """Reassembly with a disk: pictures and views.csv are written before anything is acknowledged."""

    def __init__(self, run: RunFolder, site: Site, epoch_utc: str, homes: Sequence[Vector],
                 mapped: Collection[str] = ("explore",), lens: Distortion = NONE) -> None:
        """homes: where each vehicle takes off, ENU metres. mapped: phases whose pictures are decoded. lens: its
        distortion is taken out of the decoded picture; the file keeps it."""
        self._run, self._site, self._homes, self._mapped, self._lens = run, site, homes, mapped, lens
        self._epoch = datetime.fromisoformat(epoch_utc)
        self._reassembly = Reassembly()
        self._rows: list[list[object]] = []
        self.disk = Disk(run.pictures)
        self._checked_ns = 0
        write_views(run.views_csv, [])
        self.refused = 0

    @property
    def pictures(self) -> int:
        """Pictures on disk."""
        return len(self._rows)

    @property
    def unfinished(self) -> int:
        """Pictures of which only a part has arrived."""
        return self._reassembly.unfinished

    def receive(self, vehicle_id: int, chunk: PictureChunk, t_ns: int) -> tuple[PictureAck | None, Picture | None]:
        """The acknowledgement to send, and the picture when this chunk completed it."""
        try:
            result = self._reassembly.add(vehicle_id, chunk, t_ns)
        except ProtocolError as e:
            self.refused += 1
            log.warning("refused a chunk: %s", e)
            return None, None
        if result is None or isinstance(result, PictureAck):
            return result, None
        meta, jpeg = result
        if not self._store(meta, jpeg):
            self._reassembly.ask_again(meta, chunk.count)
            return None, None
        rgb = decode_rgb(jpeg) if meta.phase in self._mapped else None
        if rgb is not None and self._lens != NONE:
            rgb = redrawn(rgb, meta.camera, self._lens, meta.camera)
        return PictureAck(view_id=meta.view_id, sha256=meta.sha256), Picture(meta, rgb)

    def overdue(self, t_ns: int) -> list[tuple[int, PictureAck]]:
        """Requests for chunks that did not come; none while they could not be kept."""
        if t_ns - self._checked_ns >= CHECK_NS:
            self._checked_ns = t_ns
            self.disk.check()
        return [] if self.disk.trouble else self._reassembly.overdue(t_ns)

    @property
    def trouble(self) -> str:
        """Why the run's disk takes no pictures, to follow "the disk"; "" when it does."""
        return self.disk.trouble

    def forget(self, vehicle_id: int) -> None:
        """No more chunks will come from this vehicle."""
        self._reassembly.forget(vehicle_id)

    def rewind(self) -> None:
        """Forget on disk what came after this state was kept."""
        write_views(self._run.views_csv, self._rows)

    def close(self) -> None:
        """Write views.csv in its final order; where the disk takes no more it stays as it was written in flight."""
        with suppress(OSError):
            write_views(self._run.views_csv, self._rows)

    def _store(self, meta: PictureMeta, jpeg: bytes) -> bool:
        """Whether picture and row are on disk."""
        path = self._run.picture(meta.vehicle_id, meta.view_id)
        home_up_m = self._homes[meta.vehicle_id - 1][2]
        row, line = self._run.view_row(meta), io.StringIO(newline="")
        csv.writer(line).writerow(row)
        kept = (self.disk.write(path, with_metadata(jpeg, meta, self._site, self._epoch, home_up_m))
                and self.disk.append(self._run.views_csv, line.getvalue().encode()))
        if kept:
            self._rows.append(row)
        return kept


def decode_rgb(jpeg: bytes) -> NDArray[np.uint8] | None:
    """(height, width, 3) RGB of a JPEG; None when it does not decode."""
    bgr = cv2.imdecode(np.frombuffer(jpeg, dtype=np.uint8), cv2.IMREAD_COLOR)
    return None if bgr is None else np.ascontiguousarray(bgr[..., ::-1])


def _check(vehicle_id: int, chunk: PictureChunk) -> None:
    meta = chunk.meta
    if meta.vehicle_id != vehicle_id:
        raise ProtocolError(f"vehicle {vehicle_id} sent a picture of vehicle {meta.vehicle_id}")
    if meta.phase not in PHASES or meta.view_id < 0:
        raise ProtocolError(f"picture {meta.view_id}: phase {meta.phase!r} is none of {PHASES}")
    if not 0 < meta.size_bytes <= MAX_PICTURE_BYTES or not 0 < chunk.count <= MAX_PICTURE_BYTES // MAX_CHUNK * 4:
        raise ProtocolError(f"picture {meta.view_id}: {meta.size_bytes} bytes in {chunk.count} chunks is out of range")
    if not 0 <= chunk.index < chunk.count:
        raise ProtocolError(f"picture {meta.view_id}: chunk {chunk.index} of {chunk.count}")
