"""report.html."""

from __future__ import annotations

from typing import Any

from ground_station.report.measure import Measured
from ground_station.report.run_data import RunData


def write_page(data: RunData, measured: Measured | None, metrics: dict[str, Any]) -> None:
    """Write the page."""
    data.run.report.write_text("<!doctype html>", encoding="utf-8")
