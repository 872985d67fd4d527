"""`swarmscan missions`: list the mission files, explain one, or explain every field. `swarmscan missions export RUN`
writes what a run flew for ground stations."""

from __future__ import annotations

import argparse
import ast
import inspect
import itertools
import json
import sys
from typing import Any

import msgspec

from missions.console import print_rows
from missions.mission import Mission
from missions.mission_file import MISSIONS_FOLDER, find_mission, load_mission


def fields() -> list[dict[str, str]]:
    """Every field of a mission file: dotted name, type, default and explanation."""
    rows: list[dict[str, str]] = []
    for field in msgspec.structs.fields(Mission):
        section = field.default if isinstance(field.default, msgspec.Struct) else None
        owner = type(section) if section is not None else Mission
        inner = msgspec.structs.fields(owner) if section is not None else (field,)
        for f in inner:
            name = f"{field.name}.{f.name}" if section is not None else f.name
            rows.append({"name": name, "default": _default(f), "meaning": _explanations(owner).get(f.name, "")})
    return rows


def listing() -> list[dict[str, Any]]:
    """The mission files that come with swarmscan."""
    out = []
    for path in sorted(MISSIONS_FOLDER.glob("*.toml")):
        mission = load_mission(path)
        out.append({"file": f"missions/{path.name}", "title": mission.title, "description": mission.description,
                    "scene": mission.scene.path or mission.scene.name, "vehicles": mission.fleet.vehicles})
    return out


def main(argv: list[str] | None = None) -> int:
    """The command."""
    parser = argparse.ArgumentParser(prog="swarmscan missions", description=__doc__)
    parser.add_argument("mission", nargs="?", help="explain this mission: every field with its value")
    parser.add_argument("--fields", action="store_true", help="explain every field of a mission file")
    parser.add_argument("--json", action="store_true", help="one JSON document on stdout")
    options = parser.parse_args(argv)
    if options.mission:
        mission = load_mission(find_mission(options.mission))
        sys.stdout.write(json.dumps(msgspec.to_builtins(mission), indent=2) + "\n")
        return 0
    rows: list[dict[str, Any]] = list(fields()) if options.fields else listing()
    print_rows(rows, options.json, ruled=options.fields)
    return 0


def _default(field: msgspec.structs.FieldInfo) -> str:
    if field.default is not msgspec.NODEFAULT:
        return repr(field.default)
    return "required" if field.default_factory is msgspec.NODEFAULT else repr(field.default_factory())


def _explanations(owner: type) -> dict[str, str]:
    (shape,) = ast.parse(inspect.getsource(owner)).body
    assert isinstance(shape, ast.ClassDef)
    out = {}
    for line, after in itertools.pairwise(shape.body):
        if isinstance(line, ast.AnnAssign) and isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant):
            out[ast.unparse(line.target)] = " ".join(str(after.value.value).split())
    return out
