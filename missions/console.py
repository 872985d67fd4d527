"""How every command answers on stdout: one JSON document for machines, a table for people."""

from __future__ import annotations

import json
import sys
from dataclasses import asdict
from typing import Any

from rich.console import Console, RenderableType

PIPED_WIDTH = 160
"""Characters in a line where stdout is no terminal, so that no table is squeezed."""


def print_result(document: Any, shown: RenderableType, as_json: bool) -> None:
    """The document (of what JSON knows, and dataclasses) for machines, or what is shown to people in its place."""
    if as_json:
        sys.stdout.write(json.dumps(document, indent=2, default=asdict) + "\n")
    else:
        # emoji off: rich would draw a church for the scene family:church:1
        Console(width=None if sys.stdout.isatty() else PIPED_WIDTH, emoji=False).print(shown)
