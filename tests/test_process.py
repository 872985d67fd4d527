"""How a process ends: what it writes last is written, whatever it is told meanwhile."""

from __future__ import annotations

import os
import signal
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
