"""A recording as people watch it: at the speed that they want, held where they want."""

from __future__ import annotations

import math
import time

from ground_station.operator import describe
from ground_station.station import Station
from missions import live, topics
from missions.bus import Bus
from missions.clock import SECOND_NS
from missions.live import OperatorAnswer, OperatorCommand

SHOW_S = 0.25


class Playback:
    """Says when the next turn of a recording is due, and hears those who watch meanwhile."""

    def __init__(self, station: Station, bus: Bus, speed: float, paused: bool = False) -> None:
        """speed: recorded seconds per wall second; 0 is as fast as possible. paused: until somebody says resume."""
        self._station, self._bus = station, bus
        self._speed, self._paused = speed, paused
        self._t_ns = self._from_ns = 0
        self._since_s = time.monotonic()
        self._shown_s = -SHOW_S
        bus.subscribe(topics.LIVE_HELLO)
        bus.subscribe(topics.OPERATOR_COMMAND)
        bus.announce_alive()
        self._tell()

    def wait_for(self, t_ns: int) -> None:
        """Return when the turn of this time is due."""
        self._t_ns = t_ns
        while (early_s := self._early_s(t_ns)) > 0.0:
            self.show(min(early_s, SHOW_S))
        if time.monotonic() - self._shown_s >= SHOW_S:
            self.show()

    def show(self, wait_s: float = 0.0) -> None:
        """Hear those who watch, up to so long, and tell them what is new."""
        heard = self._bus.poll(timeout_s=wait_s)
        for delivery in heard:
            if isinstance(delivery.message, OperatorCommand):
                self._obey(delivery.message)
        self._station.feed.hear(heard)
        if time.monotonic() - self._shown_s >= SHOW_S:
            self._shown_s = time.monotonic()
            self._station.feed.tell()

    def _early_s(self, t_ns: int) -> float:
        if self._paused:
            return math.inf
        if self._speed == 0.0:
            return 0.0
        return (t_ns - self._from_ns) / SECOND_NS / self._speed - (time.monotonic() - self._since_s)

    def _obey(self, command: OperatorCommand) -> None:
        action, text = command.action, ""
        if isinstance(action, live.Pause | live.Resume | live.Start):
            self._paused = isinstance(action, live.Pause)
        elif isinstance(action, live.SetSpeed) and action.speed >= 0.0:
            self._speed = action.speed
        else:
            text = "this is a recording: it can be paused, resumed, and played faster or slower"
        self._from_ns, self._since_s = self._t_ns, time.monotonic()
        self._tell()
        self._bus.publish(topics.OPERATOR_ANSWER, OperatorAnswer(
            command_id=command.command_id, accepted=not text, text=text or describe(action)))

    def _tell(self) -> None:
        self._station.feed.playing = live.LivePlaying(speed=self._speed, paused=self._paused)
