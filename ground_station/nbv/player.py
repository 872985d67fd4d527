"""`python -m ground_station.nbv.player`: one method under test, as a process that talks over stdin and stdout.

It has the trial's brief, pictures and poses, and nothing else; the tester reads its time and memory from its answers.
"""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path
from typing import IO

import numpy as np

from ground_station.nbv.methods import make_method
from missions.errors import ProtocolError, SwarmscanError, UserError
from missions.frames import Array
from missions.nbv_trial import Answer, Ask, Failure, Frame, TrialBrief, read_to_method, write_message


def main() -> int:
    """Play until the tester closes the stream."""
    with os.fdopen(os.dup(sys.stdout.fileno()), "wb") as out:
        os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # what libraries print must not land in the protocol
        try:
            play(sys.stdin.buffer, out)
        except SwarmscanError as e:
            write_message(out, Failure(reason=str(e), wrong_input=isinstance(e, UserError)))
            return 1
    return 0


def play(stream: IO[bytes], out: IO[bytes]) -> None:
    """One trial."""
    brief = read_to_method(stream)
    if not isinstance(brief, TrialBrief):
        raise ProtocolError("a trial begins with its brief")
    method = make_method(brief)
    seeing = np.zeros(2)
    while (message := read_to_method(stream)) is not None:
        begin = _clocks()
        if isinstance(message, Frame):
            method.see(message)
            seeing += _clocks() - begin
        elif isinstance(message, Ask):
            choice = method.choose(message.vehicle, message.candidates)
            choosing = _clocks() - begin
            write_message(out, Answer(choice=choice, seconds_seeing=float(seeing[0]),
                                      seconds_choosing=float(choosing[0]),
                                      seconds_processor=float((seeing + choosing)[1]),
                                      peak_memory_mib=peak_memory_mib()))
            seeing = np.zeros(2)


def _clocks() -> Array:
    """Seconds of wall time, and of processor time of all threads."""
    return np.array([time.perf_counter(), time.process_time()])


def peak_memory_mib() -> float:
    """Most resident memory of this process so far. Not getrusage, whose peak begins with that of the tester, which
    this process was forked from."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmHWM:")) / 1024.0


if __name__ == "__main__":
    sys.exit(main())
