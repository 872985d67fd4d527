"""How every command answers on stdout: one JSON document for machines, a table for people."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

from rich.console import Console, RenderableType
from rich.table import Table

PIPED_WIDTH = 160
"""Characters in a line where stdout is no terminal, so that no table is squeezed."""


def print_result(document: Any, shown: RenderableType, as_json: bool) -> None:
    """The document (of what JSON knows, and dataclasses) for machines, or what is shown to people in its place."""
    if as_json:
        sys.stdout.write(json.dumps(document, indent=2, default=asdict) + "\n")
    else:
        # emoji off: rich would draw a church for the scene family:church:1
        Console(width=None if sys.stdout.isatty() else PIPED_WIDTH, emoji=False).print(shown)


def print_rows(rows: Sequence[Mapping[str, object]], as_json: bool, ruled: bool = False) -> None:
    """A list of objects with the same keys for machines, or a table with these columns for people. ruled: lines between
    rows, where one needs several."""
    table = Table(*rows[0].keys(), show_lines=ruled)
    for row in rows:
        table.add_row(*(str(v) for v in row.values()))
    print_result(rows, table, as_json)
