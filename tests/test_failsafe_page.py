"""docs/failsafe.md shows the table that flies."""

from __future__ import annotations

from pathlib import Path

import pytest

from vehicle.failsafe_page import table, updated
from vehicle.failsafe_table import TABLE, Trigger

PAGE = Path(__file__).parent.parent / "docs" / "failsafe.md"


def test_the_page_is_up_to_date() -> None:
    page = PAGE.read_text(encoding="utf-8")
    assert updated(page) == page, "run: python -m vehicle.failsafe_page docs/failsafe.md"


def test_every_trigger_has_one_line_that_says_what_to_do() -> None:
    lines = table().splitlines()[2:]
    assert [line.split(" | ")[0] for line in lines] == [f"| {t.value}" for t in Trigger]
    for line, row in zip(lines, TABLE.values(), strict=True):
        assert line.count("|") == 7
        assert line.endswith(f"{row.remedy} |")


def test_a_page_without_marks_is_refused() -> None:
    with pytest.raises(ValueError, match="no <!-- table"):
        updated("# Nothing")
