"""`swarmscan doctor`: what works on this machine, and what to do about what does not."""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path

import psutil
from rich.console import Console
from rich.table import Table

from missions.console import print_result

PROBES = {
    "Open3D": "import open3d; print(open3d.__version__)",
    "EGL pictures": "import moderngl; c = moderngl.create_standalone_context(backend='egl'); "
                    "print(c.info['GL_RENDERER'])",
    "Embree": "import trimesh, trimesh.ray.ray_pyembree as r; print(r.RayMeshIntersector("
              "trimesh.creation.box()).intersects_any([[0, 0, 5]], [[0, 0, -1]])[0])",
    "FCL": "import fcl; print(fcl.collide(fcl.CollisionObject(fcl.Sphere(1.0)), fcl.CollisionObject(fcl.Sphere(1.0))))",
    "OMPL": "from ompl import base, geometric; print(geometric.RRTConnect(base.SpaceInformation("
            "base.RealVectorStateSpace(3))).getName())",
    "ruckig": "import ruckig; print(ruckig.Ruckig(3).degrees_of_freedom, 'axes')",
    "semi-global matching": "import cv2; cv2.StereoSGBM_create(0, 16); print(cv2.__version__)",
    "torch": "import torch; print(torch.__version__, 'cuda' if torch.cuda.is_available() else 'cpu')",
    "numba": "import numba; print(numba.njit(lambda x: x + 1)(1) == 2, numba.__version__)",
    "MAVLink": "from pymavlink.dialects.v20 import common; print(len(common.mavlink_map), 'messages')",
    "bus on loopback": "import missions.bus as b, socket; s = socket.socket(); s.bind(('127.0.0.1', 0)); "
                       "p = s.getsockname()[1]; s.close(); u = b.Bus('bridge', 'doctor', "
                       "listen=f'tcp/127.0.0.1:{p}'); u.close(); print('opened and closed')",
}
REMEDIES = {
    "Open3D": "sudo apt-get install -y libusb-1.0-0 libgl1 libgomp1 libx11-6",
    "EGL pictures": "sudo apt-get install -y libegl1 libegl-mesa0 libgl1-mesa-dri; until then pictures are ray-cast, "
                    "about five times slower",
    "bus on loopback": "allow this user to listen on 127.0.0.1",
}
OPTIONAL = {"EGL pictures"}
PROBE_S = 120.0


@dataclass(frozen=True)
class Finding:
    """One thing that was tried."""

    name: str
    works: bool
    detail: str
    remedy: str
    required: bool


def probe(name: str, code: str) -> Finding:
    """Run a probe in a process of its own: a library that crashes takes only itself down."""
    try:
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=PROBE_S,
                              check=False)
        lines = (done.stdout if done.returncode == 0 else done.stderr).strip().splitlines()
        works, detail = done.returncode == 0, lines[-1] if lines else f"exit code {done.returncode}"
    except subprocess.TimeoutExpired:
        works, detail = False, f"no answer within {PROBE_S:g} s"
    remedy = "" if works else REMEDIES.get(name, "run: bash .ci/setup")
    return Finding(name, works, detail, remedy, name not in OPTIONAL)


def machine() -> list[Finding]:
    """Python, cores, memory, disk."""
    memory_gib = psutil.virtual_memory().available / 2**30
    disk_gib = shutil.disk_usage(Path.cwd()).free / 2**30
    cores = len(os.sched_getaffinity(0))
    version = ".".join(map(str, sys.version_info[:3]))
    return [
        Finding("Python", (3, 11) <= sys.version_info[:2] < (3, 14), version, "install Python 3.11 to 3.13", True),
        Finding("cores", cores >= 2, f"{cores}", "missions are planned for 4 cores; fewer take longer", False),
        Finding("free memory", memory_gib >= 6, f"{memory_gib:.1f} GiB", "close other programs; 6 GiB needed", True),
        Finding("free disk", disk_gib >= 2, f"{disk_gib:.0f} GiB", "free 2 GiB for a run's pictures", True),
    ]


def locked(lock: Path) -> Finding:
    """Whether the installed packages are those of the lock file."""
    wrong = []
    for line in lock.read_text(encoding="utf-8").splitlines() if lock.is_file() else []:
        name, _, version = line.partition("==")
        try:
            installed = metadata.version(name)
        except metadata.PackageNotFoundError:
            installed = "missing"
        if installed.split("+")[0] != version:
            wrong.append(f"{name} {installed}, locked {version}")
    detail = "; ".join(wrong[:4]) or ("as locked" if lock.is_file() else "no lock file beside the sources")
    return Finding("packages", not wrong, detail, "run: make setup" if wrong else "", False)


def examine(on_step: Callable[[str], None] = lambda name: None) -> list[Finding]:
    """Everything, in order."""
    findings = [*machine(), locked(Path(__file__).resolve().parents[1] / "requirements.lock")]
    for name, code in PROBES.items():
        on_step(name)
        findings.append(probe(name, code))
    return findings


def main(argv: list[str] | None = None) -> int:
    """The command; exit code 1 when something that is required does not work."""
    parser = argparse.ArgumentParser(prog="swarmscan doctor", description=__doc__)
    parser.add_argument("--json", action="store_true", help="one JSON document on stdout")
    options = parser.parse_args(argv)
    with Console(stderr=True).status("looking") as status:
        findings = examine(lambda name: status.update(f"trying {name}"))
    table = Table("", "what", "found", "what to do")
    for f in findings:
        mark = "[green]works" if f.works else ("[red]fails" if f.required else "[yellow]missing")
        table.add_row(mark, f.name, f.detail, "" if f.works else f.remedy)
    print_result(findings, table, options.json)
    return 0 if all(f.works or not f.required for f in findings) else 1
