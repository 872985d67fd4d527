"""What a body knows of its own state beside where it is."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Health:
    """As good as it gets, unless the body says otherwise."""

    position_valid: bool = True
    battery_known: bool = True
    """Whether the charge is measured: data that is missing, negative or not a number is no charge."""
    utc_offset_s: float = 0.0
    """The clock's UTC less monotonic time; only that it stays the same matters."""


HEALTHY = Health()
