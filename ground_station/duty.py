"""A ground station on duty: a `Station` that takes part in the clock and keeps its journal."""

from __future__ import annotations

import time
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any

from ground_station.checkpoint import Checkpoints
from ground_station.journal import Journal
from ground_station.progress import STATUS_PERIOD_S, Progress
from ground_station.station import Station
from missions import topics
from missions.bus import Bus, Delivery
from missions.clock import GROUND, SimClock
from missions.messages import SiteBrief
from missions.mission import Mission
from missions.process import uninterrupted
from missions.run_folder import RunFolder

HEARD: tuple[topics.Topic[Any], ...] = (
    topics.MAVLINK_UP, topics.PLAN_VERDICT, topics.FENCE_VERDICT, topics.LEG_REPORT, topics.PICTURE_CHUNK,
    topics.RANGE_HITS, topics.VEHICLE_STATE, topics.LIVE_HELLO, topics.OPERATOR_COMMAND)


def take_part(bus: Bus, mission: Mission) -> tuple[SimClock, SiteBrief]:
    """Join the clock; what the operator knows of the site. Raises LinkError, or UserError when refused."""
    for topic in HEARD:
        bus.subscribe(topic)
    clock = SimClock(bus, mission.mission_hash, mission.clock.world_wait_s)
    return clock, clock.join()


@dataclass(frozen=True)
class Duty:
    """Turn after turn, to the end of the mission."""

    clock: SimClock
    station: Station
    bus: Bus
    journal: Journal
    checkpoints: Checkpoints
    run: RunFolder

    def serve(self, progress: Progress) -> None:
        """Run the mission to its end; whatever is known is written down, however it ends."""
        station = self.station
        try:
            if self._fly(progress):
                station.recorder.note(station.fleet.t_ns, "the clock was stopped before the mission was over")
            self.clock.leave()
            self.checkpoints.forget()
        finally:
            with uninterrupted(), ExitStack() as last:
                last.callback(self.run.write_process_record, GROUND, messages_sent=self.bus.sent)
                last.callback(self.journal.close)
                last.callback(station.close)

    def _fly(self, progress: Progress) -> bool:
        """Whether the clock was stopped before the mission was over."""
        station = self.station
        while True:
            turn = self.clock.next()
            begin = time.perf_counter()
            station.hear(turn)
            station.feed.hear(turn.beside)
            beside = [*turn.beside, *self._wait_for_start(turn.stop)]
            wake_ns = station.act()
            self.journal.write(turn, beside, station.voice.take_digest(), station.ingest.disk.take_answers())
            if self.journal.whole:
                self.checkpoints.spent(time.perf_counter() - begin, station, self.journal.size)
            over = turn.stop or station.director.phase == "over"
            if progress.due(station.director.phase):
                self._show(progress)
            if over:
                return turn.stop
            self.clock.done(wake_ns)

    def _show(self, progress: Progress) -> None:
        status = self.station.director.status()
        self.bus.publish(topics.STATUS, status)
        progress.show(status)
        self.station.feed.tell()

    def _wait_for_start(self, stop: bool) -> list[Delivery]:
        """Hold everybody's clock until an operator says start, or the clock is stopped; what was heard meanwhile."""
        heard: list[Delivery] = []
        operator, feed = self.station.operator, self.station.feed
        while not (operator.started or stop or self.clock.called_off):
            feed.tell()
            fresh = self.clock.hear(STATUS_PERIOD_S)
            operator.receive(fresh)
            feed.hear(fresh)
            heard += fresh
            operator.answer()
        return heard
