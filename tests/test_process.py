"""How a process ends: what it writes last is written, whatever it is told meanwhile."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from missions.process import run_process, uninterrupted


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_the_last_writing_is_not_broken_off(tmp_path: Path, number: signal.Signals) -> None:
    def body() -> None:
        try:
            raise KeyboardInterrupt
        finally:
            with uninterrupted():
                os.kill(os.getpid(), number)
                (tmp_path / "last").write_text("written")

    before = signal.getsignal(number)
    assert run_process(body) == 130
    assert (tmp_path / "last").read_text() == "written"
    assert signal.getsignal(number) is before


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_it_ends_when_told_also_where_a_shell_ignores_interrupts(number: signal.Signals) -> None:
    program = ("import sys, time; from missions.process import end_when_told, run_process; end_when_told(); "
               "sys.exit(run_process(lambda: print('up', flush=True) or [time.sleep(0.1) for _ in iter(int, 1)]))")
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        child = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE)
    finally:
        signal.signal(signal.SIGINT, before)
    with child:
        assert child.stdout is not None
        assert child.stdout.readline() == b"up\n"
        child.send_signal(number)
        assert child.wait() == 130
