"""Fresh batteries: how often each vehicle got one, and how long it stood in service for them."""

from __future__ import annotations

from typing import Any

from ground_station.report.activity import SWAP, spans
from ground_station.report.run_data import RunData


def service_numbers(data: RunData) -> dict[str, Any]:
    """Swaps and seconds in service, over all and by vehicle, from what the vehicles said; seconds to 0.1 s."""
    vehicles = {}
    for track in data.tracks:
        swaps = [s.end_s - s.start_s for s in spans(track, data.flight.get("phases") or {}) if s.activity == SWAP]
        vehicles[str(track.vehicle_id)] = {"swaps": len(swaps), "service_s": round(sum(swaps), 1)}
    return {"swaps": sum(v["swaps"] for v in vehicles.values()),
            "service_s": round(sum(v["service_s"] for v in vehicles.values()), 1), "vehicles": vehicles}
