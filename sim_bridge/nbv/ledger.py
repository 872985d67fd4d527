"""Rows of a campaign on disk, one line each, so that a campaign of hours can be broken off and taken up again."""

from __future__ import annotations

from pathlib import Path

import msgspec

from missions.errors import UserError
from sim_bridge.nbv.campaign import Campaign, Row, Run
from sim_bridge.nbv.rules import Rules


class _Line(msgspec.Struct, frozen=True):
    """A row, and all that it depends on."""

    run: Run
    rules: Rules
    options: dict[str, str]
    row: Row


class Ledger:
    """Knows the rows of earlier runs under the same rules and options; without a path it keeps none."""

    def __init__(self, path: Path | None, campaign: Campaign) -> None:
        """Raises UserError where the file cannot be read."""
        self._path, self._campaign = path, campaign
        self._rows: dict[Run, Row] = {}
        if path is None or not path.exists():
            return
        try:
            lines = [msgspec.json.decode(text, type=_Line) for text in path.read_bytes().splitlines()]
        except (OSError, msgspec.DecodeError) as e:
            raise UserError(f"--rows {path}: not rows of this benchmark ({e}); name another file.") from e
        self._rows = {line.run: line.row for line in lines
                      if (line.rules, line.options) == (campaign.rules, campaign.options)}

    def row(self, run: Run) -> Row | None:
        """What came out of a run, if it was made."""
        return self._rows.get(run)

    def add(self, run: Run, row: Row) -> None:
        """Write a row down. Raises UserError where the file cannot be written."""
        if self._path is None:
            return
        line = _Line(run, self._campaign.rules, self._campaign.options, row)
        try:
            with self._path.open("ab") as file:
                file.write(msgspec.json.encode(line) + b"\n")
        except OSError as e:
            raise UserError(f"--rows {self._path}: cannot be written ({e.strerror}); name a file in a folder that "
                            "exists.") from e
