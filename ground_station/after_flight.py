"""What follows a flight, and who sees to it: model, measurements and report, each as a process of its own."""

from __future__ import annotations

import fcntl
import logging
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import IO

from missions.mission import Mission
from missions.run_folder import RunFolder

log = logging.getLogger(__name__)


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
    """All of the mission's stages; False when one failed. The report measures, too (`swarmscan evaluate` is for those
    who want no page): it needs the cloud for that, so it begins while mesh and model are being made."""
    if not mission.reconstruct.enabled:
        with _stage("report", run) as report:
            return _succeeded(report)
    with _stage("reconstruct", run, "--announce", *(["--keep-depth"] if keep_depth else [])) as reconstruct:
        reconstruct.said.readline()  # the cloud is there, or there will be none
        with _stage("report", run, "--wait") as report:
            made = _succeeded(reconstruct)
            return _succeeded(report) and made


@dataclass(frozen=True)
class Stage:
    """A stage in a process of its own."""

    name: str
    run: RunFolder
    process: subprocess.Popen[bytes]
    said: IO[bytes]


@contextmanager
def _stage(name: str, run: RunFolder, *options: str) -> Iterator[Stage]:
    """It ends with the block at the latest."""
    log.info("%s ...", name)
    process = subprocess.Popen([sys.executable, "-m", "ground_station.stages", name, str(run.root), *options],
                               stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    assert process.stdout is not None
    try:
        yield Stage(name, run, process, process.stdout)
    finally:
        process.kill()
        process.wait()


def _succeeded(stage: Stage) -> bool:
    """End its stdin, and wait for its own end; False when it failed."""
    stage.process.communicate()
    code = stage.process.returncode
    if code != 0:
        log.error("%s failed with code %d; mend the cause and run 'swarmscan %s %s'", stage.name, code, stage.name,
                  stage.run.root)
    return code == 0
