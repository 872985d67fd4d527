"""`swarmscan scenes`: list what there is, export one, check a file, see them all, walk around some."""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import track

from missions.errors import UserError
from missions.mission import SiteSpec
from missions.scene_names import FAMILIES, PREFIX, FamilyScene, is_scene_name, parse_family
from missions.simulation import SceneSpec
from sim_bridge.render.gallery import Card, check_suffix, portraits, write_gallery
from sim_bridge.scenes.builtin import BUILT_IN
from sim_bridge.scenes.export import export_scene
from sim_bridge.scenes.families.registry import GENERATORS, member
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
    commands.add_parser("list", parents=[shared], help="list built-in structures and families").set_defaults(run=_list)
    export = commands.add_parser("export", parents=[shared], help="write a scene as OBJ with textures and bounds")
    export.add_argument("name", metavar="NAME", help=f"one of {', '.join(sorted(BUILT_IN))}, or {PREFIX}NAME:SEED")
    export.add_argument("folder", metavar="DIR", type=Path, help="folder to write NAME/ into")
    export.add_argument("--seed", type=int, default=1)
    export.set_defaults(run=_export)
    check = commands.add_parser("check", parents=[shared], help="describe a scene; say what is repaired in a file")
    check.add_argument("path", metavar="SCENE", help="a GLB, OBJ, PLY or STL file, a folder, or a scene's name")
    check.add_argument("--units-per-metre", type=float, default=1.0, metavar="N")
    check.set_defaults(run=_check)
    gallery = commands.add_parser("gallery", parents=[shared], help="render families on one HTML page or PNG")
    gallery.add_argument("file", metavar="FILE", type=Path, help="what to write: .html or .png")
    gallery.add_argument("--families", nargs="+", metavar="NAME", default=list(FAMILIES), help="default: all")
    gallery.add_argument("--seeds", nargs="+", type=int, default=[1, 2], metavar="N")
    gallery.set_defaults(run=_gallery)
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
    families = [{"name": name, "structure": structure, "split": split,
                 "parameters": [f.name for f in fields(GENERATORS[name])]}
                for name, (structure, split) in FAMILIES.items()]
    lines += ["", f"{'family':<20} {'structure':<10} {'split':<11} name a scene of it {PREFIX}NAME:SEED"]
    lines += [f"{f['name']:<20} {f['structure']:<10} {f['split']}" for f in families]
    return {"scenes": rows, "families": families}, "\n".join(lines)


def _export(args: argparse.Namespace) -> tuple[Any, str]:
    scene = load_scene(SceneSpec(name=args.name, seed=args.seed), SiteSpec())
    home = export_scene(scene, args.folder)
    return {"folder": str(home), **_described(scene)}, f"{args.name} is in {home}"


def _check(args: argparse.Namespace) -> tuple[Any, str]:
    if args.units_per_metre <= 0:
        raise UserError("--units-per-metre must be positive; give 1000 for a model in millimetres.")
    named = is_scene_name(args.path)
    spec = SceneSpec(name=args.path) if named else SceneSpec(path=args.path, units_per_metre=args.units_per_metre)
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


def _gallery(args: argparse.Namespace) -> tuple[Any, str]:
    check_suffix(args.file)
    asked = [parse_family(FamilyScene(name, seed).name) for name in args.families for seed in args.seeds]
    cards, rows = [], []
    for drawn in track([a for a in asked if a], "scenes", console=Console(stderr=True), disable=args.json):
        scene = load_scene(SceneSpec(name=drawn.name), SiteSpec())
        row, parameters = _described(scene), asdict(member(drawn))
        structure, split = FAMILIES[drawn.family]
        facts = f"{_size(row)} m, {row['object_triangles']} triangles; " + ", ".join(
            f"{key} {value}" for key, value in parameters.items())
        cards.append(Card(f"{structure}, {split}", drawn.name, facts, portraits(scene)))
        rows.append({**row, "parameters": parameters})
    write_gallery(args.file, cards)
    return {"file": str(args.file), "scenes": rows}, f"{len(cards)} scenes are in {args.file}"


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
