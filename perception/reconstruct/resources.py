"""Memory and threads: what is kept and what is made again, and how many threads there is room for."""

from __future__ import annotations

from collections import OrderedDict, deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from threading import Lock
from typing import Generic, TypeVar

import cv2
from threadpoolctl import threadpool_limits

from missions.errors import UserError

GIB = 2**30
LIBRARIES_GIB = 0.6
"""Resident before any picture is read: Open3D, OpenCV, pycolmap, numba."""

Item = TypeVar("Item")
Made = TypeVar("Made")


class LastUsed(Generic[Item]):
    """Items by index, made when asked for; the last used ones are kept while they take no more than limit_bytes.

    Threads that ask for the same item wait for one of them to make it. What is asked for next does not depend on what
    is kept, so results never do.
    """

    def __init__(self, make: Callable[[int], Item], size_bytes: Callable[[Item], int], limit_bytes: int) -> None:
        self._make, self._size, self._limit = make, size_bytes, limit_bytes
        self._items: OrderedDict[int, Future[Item]] = OrderedDict()
        self._bytes = 0
        self._lock = Lock()

    def __getitem__(self, index: int) -> Item:
        with self._lock:
            found = self._items.get(index)
            mine = found is None
            if found is None:
                found = self._items[index] = Future()
            self._items.move_to_end(index)
        if mine:
            self._fill(index, found)
        return found.result()

    def _fill(self, index: int, place: Future[Item]) -> None:
        try:
            item = self._make(index)
        except BaseException as e:
            with self._lock:
                self._items.pop(index)
            place.set_exception(e)
            return
        place.set_result(item)
        with self._lock:
            self._bytes += self._size(item)
            for old, kept in list(self._items.items()):
                if self._bytes <= self._limit or old == index:
                    break
                if kept.done():
                    self._bytes -= self._size(self._items.pop(old).result())


@dataclass(frozen=True)
class Room:
    """How many threads may work at a time, and what they may keep between them."""

    threads: int
    kept_bytes: int


def room(memory_gib: float, threads: int, work_bytes: int, needed_bytes: int) -> Room:
    """As many threads as fit when each takes work_bytes and needed_bytes are kept at the least; the rest is kept too.

    Raises UserError when not even one fits.
    """
    free = int((memory_gib - LIBRARIES_GIB) * GIB)
    fitting = (free - needed_bytes) // work_bytes
    if fitting < 1:
        least = LIBRARIES_GIB + (work_bytes + needed_bytes) / GIB
        raise UserError(f"reconstruct.memory_gib {memory_gib:g}: too little for pictures of this size; give at least "
                        f"{least:.1f}, or lower reconstruct.depth_width_px.")
    fitting = min(threads, fitting)
    return Room(fitting, free - fitting * work_bytes)


def in_order(pool: ThreadPoolExecutor, work: Callable[[Item], Made], items: Sequence[Item],
             ahead: int) -> Iterator[Made]:
    """What work makes of each item, in order, at most so many made ahead of the one that is asked for."""
    waiting: deque[Future[Made]] = deque()
    for item in items:
        waiting.append(pool.submit(work, item))
        if len(waiting) > ahead:
            yield waiting.popleft().result()
    while waiting:
        yield waiting.popleft().result()


@contextmanager
def single_threaded_libraries() -> Iterator[None]:
    """A pool already keeps the cores busy; threads of OpenCV's and BLAS's own would only get in each other's way."""
    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        with threadpool_limits(1, user_api="blas"):
            yield
    finally:
        cv2.setNumThreads(before)
