"""Mission files: found, loaded from TOML, overridden by dotted names, checked, written into the run folder.

Unknown keys are refused. Every error names the file, the key and the remedy.
"""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

import msgspec
import tomli_w

from missions.errors import UserError
from missions.lens import invertible
from missions.mission import Mission

MISSIONS_FOLDER = Path(__file__).resolve().parent


def find_mission(name_or_path: str) -> Path:
    """The mission file meant by a path or by the bare name of one in missions/."""
    for candidate in (Path(name_or_path), MISSIONS_FOLDER / name_or_path, MISSIONS_FOLDER / f"{name_or_path}.toml"):
        if candidate.is_file():
            return candidate
    known = ", ".join(sorted(p.stem for p in MISSIONS_FOLDER.glob("*.toml")))
    raise UserError(f"{name_or_path}: no such mission file; give a path or one of: {known}.")


def load_mission(path: Path, overrides: dict[str, str] | None = None) -> Mission:
    """Read, override and check a mission file.

    overrides: dotted field name to TOML value text, e.g. {"fleet.vehicles": "3"}.
    Raises UserError naming file, key and remedy.
    """
    try:
        tree = tomllib.loads(path.read_text(encoding="utf-8"))
    except tomllib.TOMLDecodeError as e:
        raise UserError(f"{path}: not valid TOML ({e}); mend that line.") from e
    except (OSError, UnicodeDecodeError) as e:
        raise UserError(f"{path}: cannot be read ({e}); give a readable UTF-8 file.") from e
    for key, text in (overrides or {}).items():
        _override(tree, key, text)
    try:
        mission = msgspec.convert(tree, Mission)
    except msgspec.ValidationError as e:
        raise UserError(_explain(path, str(e))) from e
    check(mission, str(path))
    return mission


def check(mission: Mission, where: str) -> None:
    """Rules that hold between fields. Raises UserError."""
    n = mission.fleet.vehicles
    pads = mission.fleet.takeoff_enu_m
    if pads and len(pads) != n:
        raise UserError(f"{where}: fleet.takeoff_enu_m has {len(pads)} entries for {n} vehicles; give {n} or leave it "
                        "out.")
    lo, hi = mission.site.object_min_enu_m, mission.site.object_max_enu_m
    if (lo is None) != (hi is None):
        raise UserError(f"{where}: site.object_min_enu_m and site.object_max_enu_m belong together; give both or none.")
    if lo is not None and hi is not None and any(b - a <= 0 for a, b in zip(lo, hi, strict=True)):
        raise UserError(f"{where}: site.object_max_enu_m must exceed object_min_enu_m on every axis; swap or widen it.")
    if mission.fleet.clearance_m <= mission.fleet.radius_m:
        raise UserError(f"{where}: fleet.clearance_m must exceed fleet.radius_m; raise the clearance.")
    if mission.fleet.reserve >= mission.fleet.vehicles:
        raise UserError(f"{where}: fleet.reserve must be less than fleet.vehicles, of which it is a part; raise "
                        "fleet.vehicles.")
    if mission.site.geofence_room_m and mission.knowledge == "mesh":
        raise UserError(f"{where}: site.geofence_room_m is for missions without a prior model; leave it out.")
    if mission.prior_path and mission.knowledge == "none":
        raise UserError(f"{where}: prior_path needs knowledge = \"mesh\"; set it or leave prior_path out.")
    if mission.survey.views == "file" and not mission.survey.views_path:
        raise UserError(f"{where}: survey.views = \"file\" needs survey.views_path; name the views file.")
    if not all(invertible(camera, mission.camera.distortion)
               for camera in (mission.camera.survey_camera(), mission.camera.explore_camera())):
        raise UserError(f"{where}: camera.distortion {list(mission.camera.distortion)} folds the picture before its "
                        "corners; give smaller coefficients k1, k2, p1, p2.")
    if mission.reconstruct.far_m <= mission.reconstruct.near_m:
        raise UserError(f"{where}: reconstruct.far_m must exceed reconstruct.near_m; raise it.")
    _check_faults(mission, where)


def _check_faults(mission: Mission, where: str) -> None:
    for n, fault in enumerate(mission.faults):
        if fault.vehicle > mission.fleet.vehicles:
            raise UserError(f"{where}: faults[{n}].vehicle is {fault.vehicle}; this mission has vehicles 1 to "
                            f"{mission.fleet.vehicles}, name one.")
        if fault.until_s <= fault.at_s:
            raise UserError(f"{where}: faults[{n}].until_s must be later than at_s; raise it or leave it out.")
        if (fault.amount > 0.0) != (fault.kind in ("battery_sag", "clock_jump")):
            raise UserError(f"{where}: faults[{n}].amount belongs to battery_sag (percent) and clock_jump (seconds) "
                            "alone; give it there.")


def write_mission(mission: Mission, path: Path) -> None:
    """Write the merged mission as TOML."""
    tree = _without_none(msgspec.to_builtins(mission))
    path.write_text(tomli_w.dumps(tree), encoding="utf-8")


def _override(tree: dict[str, Any], key: str, text: str) -> None:
    try:
        value = tomllib.loads(f"v = {text}")["v"]
    except tomllib.TOMLDecodeError:
        value = text
    *parents, leaf = key.split(".")
    node = tree
    for name in parents:
        child = node.setdefault(name, {})
        if not isinstance(child, dict):
            raise UserError(f"--set {key}: {name} is a value, not a section; check the dotted name.")
        node = child
    node[leaf] = value


def _explain(path: Path, error: str) -> str:
    where = re.search(r"at `\$\.?([^`]*)`", error)
    what = re.sub(r" - at `[^`]*`", "", error)
    unknown = re.search(r"unknown field `([^`]+)`", error)
    section = where.group(1) if where else ""
    if unknown:
        key = f"{section}.{unknown.group(1)}" if section else unknown.group(1)
        return f"{path}: unknown key {key}; remove it or see 'swarmscan missions --fields' for the names."
    missing = re.search(r"missing required field `([^`]+)`", error)
    if missing:
        key = f"{section}.{missing.group(1)}" if section else missing.group(1)
        return f"{path}: key {key} is missing; add it."
    return f"{path}: key {section or '(top level)'}: {what[0].lower()}{what[1:]}; correct the value."


def _without_none(tree: Any) -> Any:
    if isinstance(tree, dict):
        return {k: _without_none(v) for k, v in tree.items() if v is not None}
    if isinstance(tree, list | tuple):
        return [_without_none(v) for v in tree]
    return tree
