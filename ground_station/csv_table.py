"""A CSV file that a person has written: its rows and columns, or a sentence why not."""

from __future__ import annotations

import csv
from pathlib import Path

from missions.errors import UserError


def read_table(path: Path, field: str = "") -> tuple[list[dict[str, str]], set[str]]:
    """Rows by column's name, and those names. A byte order mark and blanks after commas do not matter. field: what
    names the file in a mission. Raises UserError."""
    what = f"{field} {path}" if field else str(path)
    try:
        with path.open(newline="", encoding="utf-8-sig") as f:
            reader = csv.DictReader(f, skipinitialspace=True)
            return list(reader), set(reader.fieldnames or ())
    except (OSError, UnicodeDecodeError, csv.Error) as e:
        raise UserError(f"{what}: cannot be read ({e}); give a readable CSV file.") from e
