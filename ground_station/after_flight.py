"""What follows a flight, and who sees to it: model, measurements and report, each as a process of its own."""

from __future__ import annotations

import fcntl
import logging
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from missions.mission import Mission
from missions.run_folder import RunFolder

log = logging.getLogger(__name__)

STAGES = ("reconstruct", "report")
"""The report measures, too: `swarmscan evaluate` is for those who want no page."""


@contextmanager
def in_charge(run: RunFolder) -> Iterator[bool]:
    """Whether what follows the flight is up to this process: nobody else who sees to it is alive."""
    with run.in_charge.open("w") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)  # the kernel lets go of it however a process ends
        except BlockingIOError:
            yield False
        else:
            yield True


def run_stages(run: RunFolder, mission: Mission, keep_depth: bool) -> bool:
    """All of the mission's stages; False when one failed."""
    stages = STAGES if mission.reconstruct.enabled else STAGES[1:]
    failed = [stage for stage in stages if not _run_stage(stage, run, keep_depth)]
    return not failed


def _run_stage(stage: str, run: RunFolder, keep_depth: bool) -> bool:
    """Run one stage after the flight in its own process; False when it failed."""
    log.info("%s ...", stage)
    options = ["--keep-depth"] if keep_depth and stage == "reconstruct" else []
    code = subprocess.run([sys.executable, "-m", "ground_station.stages", stage, str(run.root), *options],
                          stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, check=False).returncode
    if code != 0:
        log.error("%s failed with code %d; mend the cause and run 'swarmscan %s %s'", stage, code, stage, run.root)
    return code == 0
