"""Mission files: every error names file, key and remedy; what is written reads back the same."""

from pathlib import Path

import msgspec
import pytest

from ground_station import cli
from missions.commands import fields
from missions.errors import UserError
from missions.mission import Mission, without_scene
from missions.mission_file import MISSIONS_FOLDER, find_mission, load_mission, write_mission


def mission_text(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "m.toml"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize("path", sorted(MISSIONS_FOLDER.glob("*.toml")), ids=lambda p: p.stem)
def test_shipped_missions_load_and_are_described(path):
    mission = load_mission(path)
    assert mission.description.endswith(".")


@pytest.mark.parametrize(("text", "key", "remedy"), [
    ("title = 'x'\n[fleet]\nvehicules = 2\n", "fleet.vehicules", "remove it"),
    ("title = 'x'\n[fleet]\nvehicles = 0\n", "fleet.vehicles", "correct the value"),
    ("title = 'x'\n[fleet]\nspeed_m_s = 'fast'\n", "fleet.speed_m_s", "correct the value"),
    ("description = 'x'\n", "title", "add it"),
    ("title = 'x'\n[fleet]\ntakeoff_enu_m = [[0.0, 0.0, 0.0]]\n", "fleet.takeoff_enu_m", "leave it out"),
    ("title = 'x'\n[site]\nobject_min_enu_m = [0.0, 0.0, 0.0]\n", "object_max_enu_m", "give both"),
    ("title = 'x'\n[fleet]\nclearance_m = 0.1\n", "fleet.clearance_m", "raise the clearance"),
    ("title = 'x'\n[fleet]\nreserve = 2\n", "fleet.reserve", "raise fleet.vehicles"),
    ("title = x\n", "TOML", "mend that line"),
])
def test_errors_name_file_key_and_remedy(tmp_path, text, key, remedy):
    path = mission_text(tmp_path, text)
    with pytest.raises(UserError) as error:
        load_mission(path)
    message = str(error.value)
    assert str(path) in message
    assert key in message
    assert remedy in message


def test_overrides_by_dotted_name(tmp_path):
    path = mission_text(tmp_path, "title = 'x'\n")
    mission = load_mission(path, {"fleet.vehicles": "3", "scene.name": "statue", "camera.survey_px": "[3840, 2160]"})
    assert (mission.fleet.vehicles, mission.scene.name, mission.camera.survey_px) == (3, "statue", (3840, 2160))


def test_written_mission_reads_back_the_same(tmp_path):
    mission = load_mission(find_mission("bridge"), {"fleet.takeoff_enu_m": "[[0.0, -20.0, 0.2], [5.0, -20.0, 0.2]]"})
    write_mission(mission, tmp_path / "merged.toml")
    assert load_mission(tmp_path / "merged.toml") == mission


def test_planners_get_no_scene():
    mission = load_mission(find_mission("bridge"), {
        "scene.path": "secret.glb", "obstacles": "[{center_enu_m = [0, 0, 5], size_m = [1, 1, 1]}]"})
    assert b"secret" not in msgspec.json.encode(without_scene(mission))
    assert without_scene(mission).obstacles == []


def test_unknown_mission_lists_those_there(capsys):
    assert cli.main(["missions", "nowhere"]) == 2
    assert "bridge" in capsys.readouterr().err


def test_every_field_is_listed():
    names = {row["name"] for row in fields()}
    assert {"title", "fleet.vehicles", "battery.percent_per_m", "camera.diagonal_fov_deg"} <= names
    assert len(names) > len(msgspec.structs.fields(Mission))


def test_every_command_is_there():
    import importlib

    for command in cli.COMMANDS:
        module, function = command.target.split(":")
        assert callable(getattr(importlib.import_module(module), function)), command.name
