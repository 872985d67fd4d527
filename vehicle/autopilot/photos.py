"""Pictures that somebody asks for outside of a plan: one, so many, or one every few seconds."""

from __future__ import annotations

from missions.messages import ShutterRequest
from vehicle.camera import CameraPayload
from vehicle.simulator import NS, Kinematics

PHASE = "survey"
SAME_COMMAND_NS = 5 * NS
"""A photo command with the same sequence number that comes again within this long is the same one, sent again."""
LEAST_INTERVAL_S = 0.5


class Photos:
    """One series of pictures at a time."""

    def __init__(self, camera: CameraPayload) -> None:
        self._camera = camera
        self._left: int | None = 0
        """How many are still to be taken; None for no end."""
        self.interval_s = 0.0
        self._next_ns = 0
        self._last: tuple[tuple[int, int], int, int] | None = None

    @property
    def running(self) -> bool:
        """Whether a series is being taken."""
        return self._left is None or self._left > 0

    def start(self, interval_s: float, count: int, sequence: int, sender: tuple[int, int], t_ns: int) -> None:
        """Take so many pictures (0: until stopped); a single one only once for each sequence number of a sender."""
        if count == 1:
            again = self._last is not None and self._last[:2] == (sender, sequence)
            fresh = not again or (self._last is not None and t_ns - self._last[2] > SAME_COMMAND_NS)
            self._last = (sender, sequence, t_ns)
            if not fresh:
                return
        self.interval_s, self._left, self._next_ns = max(interval_s, LEAST_INTERVAL_S), count or None, t_ns

    def stop(self) -> None:
        """No more of this series."""
        self._left = 0

    def step(self, now: Kinematics, t_ns: int) -> list[ShutterRequest]:
        """Pictures that are due."""
        if not self.running or t_ns < self._next_ns:
            return []
        self._next_ns += round(self.interval_s * NS)
        if self._left is not None:
            self._left -= 1
        request = self._camera.expose(self._camera.new_view_id(), PHASE, now, t_ns)
        return [] if request is None else [request]
