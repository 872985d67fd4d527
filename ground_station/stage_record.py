"""What each stage of a process took: seconds, seconds of processor, and peak memory of that stage alone."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from missions.run_folder import RunFolder, peak_memory_mib

FORGET_PEAK = "5"
"""What Linux takes in clear_refs for: the peak of resident memory is what is resident now."""


class StageRecord:
    """Collects stages, and writes them into the process's record of the run."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._started = time.monotonic()
        self.stages: dict[str, dict[str, float]] = {}

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Measure what is done inside."""
        with suppress(OSError):
            Path("/proc/self/clear_refs").write_text(FORGET_PEAK, encoding="ascii")
        wall_s, cpu_s = time.monotonic(), time.process_time()
        yield
        self.stages[name] = {"wall_s": round(time.monotonic() - wall_s, 2),
                             "cpu_s": round(time.process_time() - cpu_s, 2),
                             "peak_memory_mib": round(peak_memory_mib(), 1)}

    def write(self, run: RunFolder) -> dict[str, Any]:
        """Into processes/NAME.json; returns it, without the name."""
        peak = max((s["peak_memory_mib"] for s in self.stages.values()), default=0.0)
        found = {"wall_s": round(time.monotonic() - self._started, 2), "stages": self.stages}
        run.write_process_record(self._name, peak_memory_mib=max(peak, round(peak_memory_mib(), 1)), **found)
        return found
