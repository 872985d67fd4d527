"""The failsafe's table for people: `python -m vehicle.failsafe_page docs/failsafe.md` brings the page up to date."""

from __future__ import annotations

import sys
from pathlib import Path

from vehicle.failsafe_table import TABLE, Action, Row

BEGIN, END = "<!-- table: written by vehicle/failsafe_page.py -->", "<!-- end of table -->"
SEVERITY = ("emergency", "alert", "critical", "error", "warning")
NAMES = {Action.WARN: "warn", Action.FINISH_PLAN: "finish the plan, then return", Action.HOLD: "hold",
         Action.FINISH_LEG: "return after the leg", Action.RETURN: "return", Action.LAND: "land"}


def table() -> str:
    """Markdown, one line per trigger, in the order in which people are told."""
    head = ["| trigger | it says | severity | it does | what it means | what to do |", "|---|---|---|---|---|---|"]
    return "\n".join([*head, *(_line(trigger.value, row) for trigger, row in TABLE.items())])


def updated(page: str) -> str:
    """The page with the table of this code between its marks. Raises ValueError where these are missing."""
    before, _, rest = page.partition(BEGIN)
    _, mark, after = rest.partition(END)
    if not mark:
        raise ValueError(f"the page has no {BEGIN} and {END}")
    return f"{before}{BEGIN}\n{table()}\n{END}{after}"


def _line(name: str, row: Row) -> str:
    does = "; ".join(NAMES[s.action] if s.after_s == 0.0 else f"after {s.after_s:g} s {NAMES[s.action]}"
                     for s in row.steps)
    cells = (name, f"`{row.what}`", SEVERITY[row.severity], does, row.meaning, row.remedy)
    return f"| {' | '.join(cells)} |"


if __name__ == "__main__":
    file = Path(sys.argv[1])
    file.write_text(updated(file.read_text(encoding="utf-8")), encoding="utf-8")
