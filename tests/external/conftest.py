from __future__ import annotations

import os
from collections.abc import Iterator

import pytest

from tests.external.sitl import Sitl

SITL = os.environ.get("SWARMSCAN_SITL", "")


@pytest.fixture
def sitl() -> Iterator[Sitl]:
    """The autopilot under test, on the ground and disarmed; skips where there is none."""
    if not SITL:
        pytest.skip("SWARMSCAN_SITL names no autopilot; set it to an address such as udpin://127.0.0.1:14550")
    with Sitl(SITL) as found:
        found.ready()
        yield found
