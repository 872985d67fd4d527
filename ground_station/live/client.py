"""A mission under way, for programs: watch it and act on it, as the live page does.

    from ground_station import connect

    with connect("runs/20260601T100000Z-bridge") as mission:
        answer = mission.pause(2)                     # returns when vehicle 2 has acknowledged it
        for state in mission.states():                # a few times per second, until the mission is over
            print(state.t_s, state.coverage, [a.text for a in state.alarms])

    async with connect_async("runs/...") as mission:  # the same, awaited
        await mission.do(Home(vehicle_id=2))

Other languages subscribe to `swarmscan/FLEET/g/live/update` and `.../answer` on the zenoh router and publish to
`.../hello` and `.../command`; payloads are JSON, `missions/live.py` names every field.
"""

from __future__ import annotations

import asyncio
import threading
import time
import uuid
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, contextmanager
from pathlib import Path

from ground_station.live.model import LiveModel
from missions import live, topics
from missions.bus import DEFAULT_ENDPOINT, Bus
from missions.clock import BRIDGE
from missions.errors import LinkError, UserError
from missions.live import LiveHello, LiveState, LiveUpdate, OperatorAnswer, OperatorCommand
from missions.messages import Vector
from missions.run_folder import RunFolder

BRIDGE_BACK_S = 20.0
"""A bridge that has died may be started again; one that is away for longer is not waited for."""
HELLO_S = 3.0
ANSWER_S = 120.0
"""A mission that has just been started loads its world first, and a decision on a busy machine takes its time."""
AGAIN_S = 1.0
"""A command, or its answer, may be lost on the way; it is sent again with the same id until it is answered."""
POLL_S = 0.2


class LiveMission:
    """A mission under way. All calls may come from any thread; nothing here slows the flight."""

    def __init__(self, bus: Bus) -> None:
        self._bus = bus
        self._model = LiveModel()
        self._changed = threading.Condition()
        self._answers: dict[str, OperatorAnswer | None] = {}
        self._over = False
        self._version = 0
        self._thread = threading.Thread(target=self._listen, name="live", daemon=True)
        self._thread.start()

    @property
    def over(self) -> bool:
        """Whether the mission, or the link to it, has ended."""
        return self._over

    @property
    def state(self) -> LiveState:
        """The newest state; waits for the first. Raises LinkError when none comes."""
        with self._changed:
            self._changed.wait_for(lambda: self._model.state is not None or self._over, ANSWER_S)
            if self._model.state is None:
                raise LinkError("no ground station has told anything; is the mission under way?")
            return self._model.state

    def states(self) -> Iterator[LiveState]:
        """Every new state as it comes, skipping what was not read in time, until the mission is over."""
        seen = 0
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._version > seen or self._over)  # noqa: B023 - called here only
                if self._version <= seen or self._model.state is None:
                    return
                seen, state = self._version, self._model.state
            yield state

    @contextmanager
    def reading(self) -> Iterator[LiveModel]:
        """All that is known, which does not change meanwhile."""
        with self._changed:
            yield self._model

    def do(self, action: live.AnyAction, timeout_s: float = ANSWER_S) -> OperatorAnswer:
        """Ask for an action and wait for the answer of all who were asked. Raises LinkError when none comes."""
        command_id = uuid.uuid4().hex
        with self._changed:
            self._answers[command_id] = None
        deadline_s, settled = time.monotonic() + timeout_s, False
        while not settled and (left_s := deadline_s - time.monotonic()) > 0.0:
            self._bus.publish(topics.OPERATOR_COMMAND, OperatorCommand(command_id=command_id, action=action))
            with self._changed:
                settled = self._changed.wait_for(lambda: self._answers[command_id] is not None or self._over,
                                                 min(AGAIN_S, left_s))
        with self._changed:
            answer = self._answers.pop(command_id)
        if answer is None:
            why = "was over before it answered" if self._over else f"did not answer within {timeout_s:.0f} s"
            raise LinkError(f"the ground station {why}.")
        return answer

    def start(self) -> OperatorAnswer:
        """Begin, where the mission waits for it."""
        return self.do(live.Start())

    def pause(self, vehicle_id: int = live.ALL) -> OperatorAnswer:
        """Hold one or all where they are."""
        return self.do(live.Pause(vehicle_id=vehicle_id))

    def resume(self, vehicle_id: int = live.ALL) -> OperatorAnswer:
        """Let one or all go on."""
        return self.do(live.Resume(vehicle_id=vehicle_id))

    def home(self, vehicle_id: int = live.ALL) -> OperatorAnswer:
        """Call one or all home, to wait on the pad."""
        return self.do(live.Home(vehicle_id=vehicle_id))

    def abort(self) -> OperatorAnswer:
        """Everybody home, and the mission is over."""
        return self.do(live.Abort())

    def mark(self, kind: str, lower_enu_m: Vector, upper_enu_m: Vector) -> OperatorAnswer:
        """Mark a box as "important" or "forbidden"."""
        if kind not in ("important", "forbidden"):
            raise UserError(f"region {kind}: say important or forbidden.")
        return self.do(live.MarkRegion(kind=kind, lower_enu_m=lower_enu_m,  # type: ignore[arg-type]
                                       upper_enu_m=upper_enu_m))

    def _listen(self) -> None:
        hello_s, there_s, whole = -HELLO_S, time.monotonic(), True
        while not self._over:
            if time.monotonic() - hello_s > HELLO_S or whole:
                hello_s = time.monotonic()
                self._bus.publish(topics.LIVE_HELLO, LiveHello(name=self._bus.name, whole=whole))
                whole = False
            for delivery in self._bus.poll(timeout_s=POLL_S):
                whole = not self._take(delivery.message) or whole
            if self._bus.is_alive(BRIDGE):
                there_s = time.monotonic()
            elif time.monotonic() - there_s > BRIDGE_BACK_S:
                self._end()

    def _take(self, message: LiveUpdate | OperatorAnswer) -> bool:
        """False when an update before this one is missing."""
        with self._changed:
            if isinstance(message, OperatorAnswer):
                if message.command_id in self._answers:
                    self._answers[message.command_id] = message
            elif not self._model.apply(message):
                return False
            else:
                self._version += 1
                self._over = self._over or message.state.phase == "over"
            self._changed.notify_all()
        return True

    def _end(self) -> None:
        with self._changed:
            self._over = True
            self._changed.notify_all()

    def _leave(self) -> None:
        self._end()
        self._thread.join()


class AsyncLiveMission:
    """The same for asyncio."""

    def __init__(self, mission: LiveMission) -> None:
        self.mission = mission

    async def state(self) -> LiveState:
        """The newest state; waits for the first."""
        return await asyncio.to_thread(lambda: self.mission.state)

    async def do(self, action: live.AnyAction, timeout_s: float = ANSWER_S) -> OperatorAnswer:
        """Ask for an action and await the answer of all who were asked."""
        return await asyncio.to_thread(self.mission.do, action, timeout_s)

    async def states(self) -> AsyncIterator[LiveState]:
        """Every new state as it comes, until the mission is over."""
        states = self.mission.states()
        while (state := await asyncio.to_thread(next, states, None)) is not None:
            yield state


@contextmanager
def connect(run: str | Path = "", *, endpoint: str = "", fleet: str = "default") -> Iterator[LiveMission]:
    """Join the mission of a run folder on this machine, or the one whose bus is at an endpoint. Raises LinkError."""
    where = endpoint or (_endpoint_of(Path(run)) if run else DEFAULT_ENDPOINT)
    with Bus(f"watcher-{uuid.uuid4().hex[:8]}", fleet, connect=where) as bus:
        bus.subscribe(topics.LIVE_UPDATE)
        bus.subscribe(topics.OPERATOR_ANSWER)
        bus.wait_alive({BRIDGE}, ANSWER_S)
        mission = LiveMission(bus)
        try:
            yield mission
        finally:
            mission._leave()


@asynccontextmanager
async def connect_async(run: str | Path = "", *, endpoint: str = "",
                        fleet: str = "default") -> AsyncIterator[AsyncLiveMission]:
    """As `connect`, for asyncio."""
    joined = connect(run, endpoint=endpoint, fleet=fleet)
    mission = await asyncio.to_thread(joined.__enter__)
    try:
        yield AsyncLiveMission(mission)
    finally:
        await asyncio.to_thread(joined.__exit__, None, None, None)


def _endpoint_of(run: Path) -> str:
    path = RunFolder(run).endpoint
    if not path.is_file():
        raise UserError(f"{path}: not there; give the folder of a mission that 'swarmscan fly' flies now, or its "
                        "endpoint.")
    return path.read_text(encoding="ascii").strip()
