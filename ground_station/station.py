"""A ground station without its wires: what it hears goes in turn by turn, what it says comes out through its `Voice`.

Flying, replaying and taking up again are the same station, fed from the clock or from a journal.
"""

from __future__ import annotations

from ground_station.control import Control
from ground_station.director import Director
from ground_station.fleet import Fleet
from ground_station.ingest import Ingest
from ground_station.live.feed import LiveFeed
from ground_station.operator import Operator
from ground_station.prior import open_prior
from ground_station.recorder import Recorder
from ground_station.voice import Voice
from missions.clock import Turn
from missions.messages import SiteBrief
from missions.mission import Mission
from missions.pads import takeoff_points
from missions.run_folder import RunFolder


class Station:
    """The parts of a ground station, and what they do in a turn of the clock."""

    def __init__(self, mission: Mission, site: SiteBrief, run: RunFolder, voice: Voice, wait: bool = False,
                 writes: RunFolder | None = None) -> None:
        """wait: for an operator's start. writes: where it writes, if not into the run's folder."""
        kept = run if writes is None else writes
        at_once = mission.survey.refine and mission.camera.exact_poses
        mapped = ("explore", "survey") if at_once else ("explore",)
        self.voice = voice
        self.ingest = Ingest(kept, mission.site.anchor, mission.clock.epoch_utc, takeoff_points(mission, site), mapped,
                             mission.camera.distortion)
        self.recorder = Recorder(kept, mission, site)
        self.fleet = Fleet(mission, site, voice, self.ingest, self.recorder)
        self.prior = open_prior(mission, run, site)
        self._control = control = Control(mission, site, self.fleet, voice, self.recorder, self.prior)
        self.director = Director(control)
        self.operator = Operator(control, self.director, voice, wait)
        self.feed = LiveFeed(control, self.director, self.operator, run, voice)

    def hear(self, turn: Turn) -> None:
        """A turn begins; after an absence vehicles are met again."""
        if turn.resumed:
            self.fleet.meet_again(turn.t_ns)
            self._control.send_map_again()
        self.fleet.receive(turn)
        self.feed.see(self.fleet.new_pictures)
        self.operator.receive(turn.beside)

    def act(self) -> int:
        """Decide and say; the simulated time at which the next turn is wanted."""
        self.director.step()
        wake_ns = self.fleet.send()
        self.operator.answer()
        return wake_ns

    def live_through(self, turn: Turn) -> bytes:
        """A turn of the past; the digest of what is said in it."""
        self.ingest.disk.relive(turn.disk)
        self.hear(turn)
        self.act()
        self.ingest.disk.relive(None)
        self.ingest.disk.take_answers()
        return self.voice.take_digest()

    def rewind(self) -> None:
        """It was read from a checkpoint: what it had written after that is forgotten, and will be written again."""
        self.recorder.mavlink.rewind()
        self.ingest.rewind()

    def close(self) -> None:
        """It hears no more: what is known is written down. Raises DiskError, with all written that could be."""
        self.ingest.close()
        self.recorder.write(self.fleet.t_ns)
