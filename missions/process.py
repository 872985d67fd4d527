"""How every process starts and ends: logging to stderr, errors that a person can act on, exit codes."""

from __future__ import annotations

import argparse
import logging
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from types import FrameType

from missions.disk import DISK_ERRORS
from missions.errors import SwarmscanError, UserError

log = logging.getLogger(__name__)


def run_process(body: Callable[[], int | None]) -> int:
    """Run the body; returns its result or 0, 2 for what the user can mend, 1 for what went wrong on the way, 130 when
    interrupted."""
    logging.basicConfig(level=logging.INFO, stream=sys.stderr, format="%(asctime)s %(name)s %(levelname)s %(message)s")
    try:
        return body() or 0
    except UserError as e:
        sys.stderr.write(f"{e}\n")
        return 2
    except SwarmscanError as e:
        log.error("%s", e)
        return 1
    except OSError as e:
        if e.errno not in DISK_ERRORS:
            raise
        log.error("%s: the disk %s; make space or mend it.", e.filename, DISK_ERRORS[e.errno])
        return 1
    except KeyboardInterrupt:
        return 130


def end_when_told() -> None:
    """SIGINT and SIGTERM end this process by KeyboardInterrupt, also where it was started by a shell that has SIGINT
    ignored in what it starts (nohup, `&` in a script): whoever starts a mission's processes ends them by SIGINT."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.default_int_handler)


def uninterrupted() -> AbstractContextManager[None]:
    """The last writing of a process that ends: SIGINT and SIGTERM, which may come late or twice, do not stop it."""
    return when_interrupted(signal.SIG_IGN)


@contextmanager
def when_interrupted(do: Callable[[int, FrameType | None], object] | signal.Handlers) -> Iterator[None]:
    """Within, SIGINT and SIGTERM do this and nothing else."""
    numbers = (signal.SIGINT, signal.SIGTERM)
    previous = [signal.signal(number, do) for number in numbers]
    try:
        yield
    finally:
        for number, handler in zip(numbers, previous, strict=True):
            signal.signal(number, handler)


def process_parser(prog: str, description: str) -> argparse.ArgumentParser:
    """The arguments that every process of a mission has."""
    parser = argparse.ArgumentParser(prog=f"swarmscan {prog}", description=description)
    parser.add_argument("mission", help="mission file, or the name of one in missions/")
    parser.add_argument("--run", type=Path, required=True, help="run folder")
    parser.add_argument("--fleet", default="default", help="name of the fleet on the bus (default %(default)s)")
    return parser
