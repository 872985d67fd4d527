"""`swarmscan scenes`: list the built-in structures, export one, check a file, walk around some."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import track

from missions.errors import UserError
from missions.mission import SceneSpec, SiteSpec
from sim_bridge.scenes.builtin import BUILT_IN
from sim_bridge.scenes.export import export_scene
from sim_bridge.scenes.load import load_scene
from sim_bridge.scenes.scene import Scene


def main(argv: list[str]) -> int:
    """Run one of the commands; exit code 0, or 2 where the input is bad."""
    args = _parser().parse_args(argv)
    try:
        result, text = args.run(args)
    except UserError as e:
        sys.stderr.write(f"{e}\n")
        return 2
    sys.stdout.write((json.dumps(result, indent=2) if args.json else text) + "\n")
    return 0


def _parser() -> argparse.ArgumentParser:
    shared = argparse.ArgumentParser(add_help=False)
    shared.add_argument("--json", action="store_true", help="print one JSON document")
    parser = argparse.ArgumentParser(prog="swarmscan scenes", description=__doc__, parents=[shared])
    parser.set_defaults(run=_list)
    commands = parser.add_subparsers(title="commands", metavar="COMMAND")
    shared = argparse.ArgumentParser(add_help=False)
    shared.add_argument("--json", action="store_true", default=argparse.SUPPRESS, help="print one JSON document")
    commands.add_parser("list", parents=[shared], help="list the built-in structures").set_defaults(run=_list)
    export = commands.add_parser("export", parents=[shared], help="write a scene as OBJ with textures and bounds")
    export.add_argument("name", metavar="NAME", help=f"one of {', '.join(sorted(BUILT_IN))}")
    export.add_argument("folder", metavar="DIR", type=Path, help="folder to write NAME/ into")
    export.add_argument("--seed", type=int, default=1)
    export.set_defaults(run=_export)
    check = commands.add_parser("check", parents=[shared], help="say what the importer finds and repairs in a file")
    check.add_argument("path", metavar="PATH", help="a GLB, OBJ, PLY or STL file, or a folder")
    check.add_argument("--units-per-metre", type=float, default=1.0, metavar="N")
    check.set_defaults(run=_check)
    walks = commands.add_parser("walks", parents=[shared], help="write walks with true depth, to train on")
    walks.add_argument("folder", metavar="DIR", type=Path, help="folder to write the walks into")
    walks.add_argument("--scenes", nargs="+", required=True, metavar="SCENE", help="names of scenes, or files")
    walks.add_argument("--walks", type=int, default=2, help="walks per scene (default %(default)s)")
    walks.add_argument("--pictures", action="store_true", help="write pictures too")
    walks.add_argument("--seed", type=int, default=1)
    walks.set_defaults(run=_walks)
    return parser


def _list(_: argparse.Namespace) -> tuple[Any, str]:
    rows = [_described(load_scene(SceneSpec(name=name), SiteSpec())) for name in sorted(BUILT_IN)]
    lines = [f"{'name':<10} {'length x width x height, m':<28} {'object triangles':>16} {'all triangles':>14}"]
    lines += [f"{r['name']:<10} {_size(r):<28} {r['object_triangles']:>16} {r['triangles']:>14}" for r in rows]
    return {"scenes": rows}, "\n".join(lines)


def _export(args: argparse.Namespace) -> tuple[Any, str]:
    scene = load_scene(SceneSpec(name=args.name, seed=args.seed), SiteSpec())
    home = export_scene(scene, args.folder)
    return {"folder": str(home), **_described(scene)}, f"{args.name} is in {home}"


def _check(args: argparse.Namespace) -> tuple[Any, str]:
    if args.units_per_metre <= 0:
        raise UserError("--units-per-metre must be positive; give 1000 for a model in millimetres.")
    spec = SceneSpec(path=args.path, units_per_metre=args.units_per_metre)
    found = _described(load_scene(spec, SiteSpec()))
    lines = [f"{found['name']}: {_size(found)} m, {found['parts']} parts, {found['object_triangles']} triangles, "
             f"{found['textured_parts']} parts with their own texture", *(f"- {note}" for note in found["notes"])]
    return found, "\n".join(lines)


def _walks(args: argparse.Namespace) -> tuple[Any, str]:
    from sim_bridge.training_walks import write_walks

    args.folder.mkdir(parents=True, exist_ok=True)
    written = []
    for name in track(args.scenes, "walking", console=Console(stderr=True)):
        written += write_walks(name, args.folder, max(1, args.walks), args.seed, args.pictures)
    return {"walks": [str(p) for p in written]}, f"{len(written)} walks are in {args.folder}"


def _described(scene: Scene) -> dict[str, Any]:
    own = [p for p in scene.parts if p.is_object]
    size = [round(b - a, 3) for a, b in zip(scene.object_min_enu_m, scene.object_max_enu_m, strict=True)]
    return {
        "name": scene.name, "size_m": size, "object_min_enu_m": list(scene.object_min_enu_m),
        "object_max_enu_m": list(scene.object_max_enu_m), "ground_up_m": scene.ground_up_m, "parts": len(own),
        "textured_parts": sum(not p.procedural for p in own), "object_triangles": sum(len(p.faces) for p in own),
        "triangles": scene.triangles(), "notes": scene.notes,
    }


def _size(row: dict[str, Any]) -> str:
    return " x ".join(f"{s:.1f}" for s in row["size_m"])
