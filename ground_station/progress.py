"""The live display of a mission on stderr: a table on a terminal, plain lines elsewhere."""

from __future__ import annotations

import logging
import sys
import time
from types import TracebackType

from rich.console import Console, Group
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from missions.clock import SECOND_NS
from missions.messages import Status

log = logging.getLogger(__name__)

STATUS_PERIOD_S, LINE_PERIOD_S = 0.25, 5.0


class Progress:
    """Shows Status records; `due` says when the next one is wanted, by the wall clock (display only). A terminal gets
    every one, a log one every LINE_PERIOD_S."""

    def __init__(self, quiet: bool = False) -> None:
        console = Console(file=sys.stderr)
        self._live = Live(console=console, auto_refresh=False, transient=False) if (
            console.is_terminal and not quiet) else None
        self._quiet = quiet
        self._next = self._next_line = 0.0
        self._phase = ""

    def __enter__(self) -> Progress:
        if self._live:
            self._live.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        if self._live:
            self._live.stop()

    def due(self, phase: str) -> bool:
        """Whether it is time to show something: every so often, and when the phase changes."""
        return phase != self._phase or time.monotonic() >= self._next

    def show(self, status: Status) -> None:
        """Show this."""
        now = time.monotonic()
        if self._live:
            self._live.update(render(status), refresh=True)
        elif not self._quiet and (now >= self._next_line or status.phase != self._phase):
            log.info(line(status))
            self._next_line = now + LINE_PERIOD_S
        self._phase, self._next = status.phase, now + STATUS_PERIOD_S


def line(status: Status) -> str:
    """One line of text for a log."""
    vehicles = ", ".join(f"uav{v.vehicle_id} {v.mode if v.alive else 'lost'} {v.battery_percent:.0f} % "
                         f"{v.views_done} done {v.views_left} left" for v in status.vehicles)
    return (f"{status.t_ns / SECOND_NS:7.1f} s {status.phase}: coverage about {status.coverage:.0%}, "
            f"{status.pictures} pictures, {_left(status)}; {vehicles}{'; ' + status.note if status.note else ''}")


def render(status: Status) -> Group:
    """The table for a terminal."""
    head = Text.assemble((f" {status.phase} ", "bold reverse"), f"  simulated {_clock(status.t_ns / SECOND_NS)}",
                         f"  coverage about {status.coverage:.0%}", f"  {status.pictures} pictures  {_left(status)}")
    table = Table(box=None, pad_edge=False)
    for name in ("vehicle", "mode", "battery", "", "views done", "left"):
        table.add_column(name, justify="right" if name in ("views done", "left") else "left")
    for v in status.vehicles:
        style = "green" if v.battery_percent > 40 else "yellow" if v.battery_percent > 20 else "red"
        table.add_row(f"uav{v.vehicle_id}", v.mode if v.alive else Text("lost", "red"),
                      ProgressBar(total=100, completed=v.battery_percent, width=24, complete_style=style),
                      f"{v.battery_percent:3.0f} %", str(v.views_done), str(v.views_left))
    return Group(head, table, Text(status.note, "dim"))


def _left(status: Status) -> str:
    return f"about {_clock(status.seconds_left)} left" if status.seconds_left > 0 else "time left unknown"


def _clock(seconds: float) -> str:
    return f"{int(seconds) // 60}:{int(seconds) % 60:02d}"
