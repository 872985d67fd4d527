"""What commands print for people."""

from __future__ import annotations

import pytest
from rich.table import Table

from missions.console import print_result


def test_names_of_scenes_are_printed_as_they_are(capsys: pytest.CaptureFixture[str]) -> None:
    table = Table("scene")
    table.add_row("family:church:1")
    print_result({}, table, as_json=False)
    assert "family:church:1" in capsys.readouterr().out
