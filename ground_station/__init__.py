"""For programs: `from ground_station import connect`, or `connect_async`; see `ground_station.live.client`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ground_station.live.client import connect, connect_async

__all__ = ["connect", "connect_async"]


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from ground_station.live import client  # for who asks: the mission's own processes do without
    return getattr(client, name)
