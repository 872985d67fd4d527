"""What flown plans took out of the batteries against what was predicted when they were made."""

from __future__ import annotations

from typing import Any

from ground_station.report.run_data import RunData


def predicted_plans(data: RunData) -> list[dict[str, Any]]:
    """The plans that were flown to their end and had a prediction, in order of their ends."""
    plans = data.flight.get("plans") or []
    return [p for p in plans if p["flown"] and p["predicted_percent"] is not None]


def used_percent(plan: dict[str, Any]) -> float:
    """What a plan took out of the battery, percent of a full one."""
    return float(plan["start_percent"] - plan["end_percent"])


def energy_numbers(data: RunData) -> dict[str, dict[str, float]]:
    """The `energy` part of metrics.json: by vehicle id, sums over its plans, and the prediction's error as a share of
    what was used."""
    numbers: dict[str, dict[str, float]] = {}
    for k in sorted({p["vehicle_id"] for p in predicted_plans(data)}):
        mine = [p for p in predicted_plans(data) if p["vehicle_id"] == k]
        predicted, used = sum(p["predicted_percent"] for p in mine), sum(used_percent(p) for p in mine)
        numbers[str(k)] = {"plans": len(mine), "predicted_percent": predicted, "used_percent": used,
                           "error": predicted / used - 1.0 if used > 0.0 else 0.0}
    return numbers
