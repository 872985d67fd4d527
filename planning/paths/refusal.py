"""Why there is no path: a typed refusal, never a silent skip."""

from __future__ import annotations

from typing import Literal

from missions.errors import SwarmscanError

Reason = Literal["start", "goal", "outside", "search"]
MESSAGES: dict[Reason, str] = {
    "start": "start occupied",
    "goal": "goal occupied",
    "outside": "outside the geofence",
    "search": "no way through known free space",
}


class NoPath(SwarmscanError):  # noqa: N818 - a refusal that callers expect, not a fault
    """No path was found. `reason` is start or goal where these lack the clearance, outside where they lie beyond the
    bounds, search where no way leads from one to the other; str() says it in words."""

    def __init__(self, reason: Reason) -> None:
        super().__init__(MESSAGES[reason])
        self.reason = reason
