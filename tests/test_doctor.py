"""What the doctor says of a sound machine and of a broken one."""

from __future__ import annotations

import json
from importlib import metadata
from pathlib import Path
from types import SimpleNamespace

import pytest

from ground_station import doctor

SOUND = {"MAVLink": doctor.PROBES["MAVLink"]}


def told(capsys: pytest.CaptureFixture[str]) -> tuple[int, dict[str, dict[str, object]]]:
    """Exit code, and the findings of --json by name; nothing else may be on stdout."""
    code = doctor.main(["--json"])
    findings = json.loads(capsys.readouterr().out)
    assert all(set(f) == {"name", "works", "detail", "remedy", "required"} for f in findings)
    assert len({f["name"] for f in findings}) == len(findings)
    return code, {f["name"]: f for f in findings}


def machine(monkeypatch: pytest.MonkeyPatch, probes: dict[str, str], memory_gib: float = 16.0,
            disk_gib: float = 100.0, cores: int = 4) -> None:
    """A machine with this much of everything, on which these probes are tried."""
    monkeypatch.setattr(doctor, "PROBES", probes)
    monkeypatch.setattr(doctor.psutil, "virtual_memory", lambda: SimpleNamespace(available=memory_gib * 2**30))
    monkeypatch.setattr(doctor.shutil, "disk_usage", lambda path: SimpleNamespace(free=disk_gib * 2**30))
    monkeypatch.setattr(doctor.os, "sched_getaffinity", lambda pid: set(range(cores)))


def test_a_sound_machine_passes(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    machine(monkeypatch, SOUND)
    code, findings = told(capsys)
    assert code == 0
    assert [name for name, f in findings.items() if not f["works"]] == []
    assert findings["MAVLink"] | {"detail": ""} == {
        "name": "MAVLink", "works": True, "detail": "", "remedy": "", "required": True}
    assert str(findings["MAVLink"]["detail"]).endswith(" messages")


@pytest.mark.parametrize("name", list(doctor.PROBES))
def test_whatever_is_broken_has_a_remedy_and_counts_unless_optional(
        name: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    machine(monkeypatch, {name: "raise ImportError('libfoo.so.1 is missing')"})
    exit_code, findings = told(capsys)
    finding = findings[name]
    assert (finding["works"], finding["detail"]) == (False, "ImportError: libfoo.so.1 is missing")
    assert finding["remedy"]
    assert exit_code == (1 if finding["required"] else 0)
    assert finding["required"] == (name != "EGL pictures")


@pytest.mark.parametrize(("short", "name", "exit_code"), [
    ({"memory_gib": 5.9}, "free memory", 1), ({"disk_gib": 1.9}, "free disk", 1), ({"cores": 1}, "cores", 0)])
def test_a_small_machine_is_told(short: dict[str, float], name: str, exit_code: int, monkeypatch: pytest.MonkeyPatch,
                                 capsys: pytest.CaptureFixture[str]) -> None:
    machine(monkeypatch, {}, **short)
    code, findings = told(capsys)
    assert code == exit_code
    assert [n for n, f in findings.items() if not f["works"]] == [name]
    assert findings[name]["remedy"]


def test_a_library_that_crashes_takes_only_its_probe_down() -> None:
    finding = doctor.probe("torch", "import os, signal; os.kill(os.getpid(), signal.SIGKILL)")
    assert (finding.works, finding.detail) == (False, "exit code -9")
    assert finding.remedy


def test_a_probe_that_hangs_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "PROBE_S", 0.2)
    finding = doctor.probe("torch", "import threading; threading.Event().wait()")
    assert (finding.works, finding.detail) == (False, "no answer within 0.2 s")
    assert finding.remedy


def test_packages_are_compared_with_the_lock(tmp_path: Path) -> None:
    lock = tmp_path / "requirements.lock"
    lock.write_text(f"numpy=={metadata.version('numpy')}\n")
    assert doctor.locked(lock) == doctor.Finding("packages", True, "as locked", "", False)
    lock.write_text("numpy==0.1\nno-such-package==2.0\n")
    wrong = doctor.locked(lock)
    assert not wrong.works
    assert wrong.detail == f"numpy {metadata.version('numpy')}, locked 0.1; no-such-package missing, locked 2.0"
    assert wrong.remedy


def test_the_table_names_what_fails_and_what_to_do(monkeypatch: pytest.MonkeyPatch,
                                                   capsys: pytest.CaptureFixture[str]) -> None:
    machine(monkeypatch, {"Open3D": "raise SystemExit('cannot load')"})
    assert doctor.main([]) == 1
    table = capsys.readouterr().out
    assert "Open3D" in table
    assert "fails" in table
    assert "apt-get" in table
