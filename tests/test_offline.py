"""Nothing that flies asks a service on the internet."""

from __future__ import annotations

from pathlib import Path

ROOMS = ("missions", "planning", "perception", "vehicle", "sim_bridge", "ground_station")


def test_ruckig_is_never_given_waypoints_in_between() -> None:
    """Ruckig's community version computes those on its makers' server."""
    sources = [path for room in ROOMS for path in (Path(__file__).parents[1] / room).rglob("*.py")]
    assert any("Ruckig(" in path.read_text(encoding="utf-8") for path in sources)
    assert [path.name for path in sources if "intermediate_positions" in path.read_text(encoding="utf-8")] == []
