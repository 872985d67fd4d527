"""`python -m ground_station.nbv.player`: one method under test, as a process that talks over stdin and stdout.

It has the trial's brief, pictures and poses, and nothing else; the tester reads its time and memory from its answers.
"""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path
from typing import IO

from ground_station.nbv.methods import Method, make_method
from missions.errors import ProtocolError, SwarmscanError, UserError
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
    seeing = 0.0
    while (message := read_to_method(stream)) is not None:
        if isinstance(message, Frame):
            begin = time.perf_counter()
            method.see(message)
            seeing += time.perf_counter() - begin
        elif isinstance(message, Ask):
            write_message(out, answer(method, message, seeing))
            seeing = 0.0


def answer(method: Method, ask: Ask, seconds_seeing: float) -> Answer:
    """The method's choice, with what it took."""
    begin = time.perf_counter()
    choice = method.choose(ask.vehicle, ask.candidates)
    return Answer(choice=choice, seconds_seeing=seconds_seeing, seconds_choosing=time.perf_counter() - begin,
                  peak_memory_mib=peak_memory_mib())


def peak_memory_mib() -> float:
    """Most resident memory of this process so far. Not getrusage, whose peak begins with that of the tester, which
    this process was forked from."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmHWM:")) / 1024.0


if __name__ == "__main__":
    sys.exit(main())
