"""A ground station as it is between two turns, on disk, so that another process can go on from there.

`swarmscan resume` reads the newest checkpoint and lives through the turns that the journal has after it. One is written
as soon as living through them again would take long, so after every long decision.
"""

from __future__ import annotations

import logging
import os
import shutil
import time
import weakref
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from ground_station.frozen import Freezer, Thawer
from ground_station.prior import Prior, open_prior
from ground_station.station import Station
from ground_station.voice import Voice
from missions.messages import SPEC_HASH, SiteBrief
from missions.mission import Mission
from missions.run_folder import RunFolder
from perception.depth.depth_map import DepthMap
from perception.depth.plane_sweep import Frame

log = logging.getLogger(__name__)

AGAIN_S = 0.5
"""Turns that took so long, by the wall clock, are not lived through again."""
SHARE = 5.0
"""A checkpoint is not due before turns have taken this many times as long as the last one took to write."""
ALIGNED_BYTES = 64
CONSTANT = (DepthMap, Frame)
"""Classes whose arrays never change; there is one for each picture."""


class Kept(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """What is in the file. journal_bytes: size of the journal at that moment."""

    spec_hash: str
    journal_bytes: int
    root: Any
    table: list[list[Any]]


class Arrays:
    """A file that arrays are added to, each once. Those that are read are paged in when somebody looks at them."""

    def __init__(self, path: Path) -> None:
        self._path, self._size = path, path.stat().st_size if path.is_file() else 0
        self._at: dict[int, tuple[weakref.ref[NDArray[Any]], int]] = {}
        self._mapped: NDArray[np.uint8] | None = None

    def put(self, array: NDArray[Any]) -> list[int]:
        """Where it is: first byte and length."""
        known = self._at.get(id(array))
        if known is None or known[0]() is not array:
            first = -(-self._size // ALIGNED_BYTES) * ALIGNED_BYTES
            with self._path.open("r+b" if self._size else "wb") as file:  # what a full disk took in part is overwritten
                file.seek(first)
                file.write(array.tobytes("A"))
            known = self._at[id(array)] = weakref.ref(array), first
            self._size = first + array.nbytes
        return [known[1], array.nbytes]

    def get(self, at: list[int]) -> NDArray[np.uint8]:
        """What is there; who writes to it changes no file. Raises ValueError for what is not whole."""
        first, length = at
        if self._mapped is None:
            self._mapped = np.memmap(self._path, np.uint8, "c")
        data = self._mapped[first:first + length]
        if len(data) < length:
            raise ValueError(f"{self._path}: ends before byte {first + length}")
        return data

    def note(self, array: NDArray[Any], at: list[int]) -> None:
        """This array is what is there."""
        self._at[id(array)] = weakref.ref(array), at[0]


def _given(voice: Voice, run: RunFolder, mission: Mission, site: SiteBrief, prior: Prior | None) -> dict[str, object]:
    """What a checkpoint does without: whoever reads it has its own."""
    given: dict[str, object] = {"voice": voice, "run": run, "mission": mission, "site": site}
    if prior is not None:
        given |= {"prior": prior, "mesh": prior.mesh, "surface": prior.field.surface,
                  "triangles": prior.field.triangles}
    return given


@dataclass
class Checkpoints:
    """Of one mission."""

    run: RunFolder
    mission: Mission
    site: SiteBrief
    _spent_s: float = 0.0
    _last_s: float = 0.0
    _arrays: Arrays | None = None
    _cannot: bool = False

    def spent(self, seconds: float, station: Station, journal_bytes: int) -> None:
        """A turn took so long, and the journal has it; a checkpoint is written when one is due."""
        self._spent_s += seconds
        if self._cannot or self._spent_s < max(AGAIN_S, SHARE * self._last_s):
            return
        begin = time.perf_counter()
        try:
            self._write(station, journal_bytes)
        except OSError as e:
            log.error("no checkpoint, so that resuming would take longer; the next one is tried: %s", e)
        except TypeError as e:
            self._cannot = True
            log.error("no more checkpoints, so that resuming will take longer: %s", e)
        self._spent_s, self._last_s = 0.0, time.perf_counter() - begin

    def read(self, voice: Voice) -> tuple[Station, int] | None:
        """The station of the newest one, and where the journal goes on from it; None when there is none that can be
        read. Those that are written from here on need not write its arrays again."""
        path, arrays = _state(self.run), Arrays(_arrays(self.run))
        if not path.is_file():
            return None
        try:
            kept = msgspec.msgpack.decode(path.read_bytes(), type=Kept)
            if kept.spec_hash != SPEC_HASH:
                raise ValueError("written by another version of swarmscan")
            given = _given(voice, self.run, self.mission, self.site, open_prior(self.mission, self.run, self.site))
            station = Thawer(kept.table, given, arrays).object(kept.root)
        except (OSError, ValueError, LookupError, TypeError, AttributeError, ImportError) as e:
            log.warning("%s: not read, the whole journal is lived through again: %s", path, e)
            return None
        assert isinstance(station, Station)
        station.rewind()
        self._arrays = arrays
        return station, kept.journal_bytes

    def forget(self) -> None:
        """The mission is over: nobody will take it up again."""
        shutil.rmtree(self.run.checkpoint, ignore_errors=True)

    def _write(self, station: Station, journal_bytes: int) -> None:
        if self._arrays is None:
            self._arrays = Arrays(_arrays(self.run))
        given = _given(station.voice, self.run, self.mission, self.site, station.prior)
        freezer = Freezer(given, CONSTANT, self._arrays)
        root = freezer.value(station)
        fresh = _state(self.run).with_suffix(".part")
        try:
            fresh.write_bytes(msgspec.msgpack.encode(Kept(SPEC_HASH, journal_bytes, root, freezer.table)))
            os.replace(fresh, _state(self.run))
        except OSError:
            fresh.unlink(missing_ok=True)
            raise


def _state(run: RunFolder) -> Path:
    return run.checkpoint / "state.bin"


def _arrays(run: RunFolder) -> Path:
    return run.checkpoint / "arrays.bin"
