"""A mission over a box that a simulated vehicle and a real autopilot fly together, in processes of their own."""

from __future__ import annotations

import json
import math
import socket
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from ground_station import launcher, processes
from ground_station.mission_setup import prepare
from ground_station.views_file import write_views
from missions.camera import Pose
from missions.frames import Site
from missions.run_folder import RunFolder

HERE = Path(__file__).parent
PADS = [(-4.0, -15.0, 0.2), (4.0, -15.0, 0.2)]
SETTINGS = ['knowledge="mesh"', "explore.enabled=false", 'survey.views="file"', "survey.stop_at_views=true",
            "reconstruct.enabled=false", f"fleet.takeoff_enu_m={json.dumps(PADS)}"]


def free_port() -> int:
    """A UDP port on which nobody listens."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as s:
        s.bind(("127.0.0.1", 0))
        return int(s.getsockname()[1])


def origin_for(vehicle_id: int, at: tuple[float, float, float]) -> list[str]:
    """Settings that put the mission where a vehicle stands: latitude, longitude, altitude (m)."""
    here = Site(*at)
    lat, lon, alt = here.geodetic_from_enu(-np.array(PADS[vehicle_id - 1]))
    return [f"site.origin_lat_deg={lat:.9f}", f"site.origin_lon_deg={lon:.9f}", f"site.origin_alt_m={alt:.3f}"]


def fly_mixed(folder: Path, url: str, external: int, at: tuple[float, float, float],
              views: int = 6, watch: Callable[[processes.Flight], None] | None = None,
              ) -> tuple[RunFolder, list[str], dict[str, Any]]:
    """Fly views around the box with vehicle `external` at this address and place; run folder, complaints of the
    launcher, the referee's verdict. watch: called in a thread of its own once everything is started."""
    box = trimesh.creation.box(extents=(8.0, 6.0, 7.0))
    box.apply_translation((0.0, 0.0, 3.5))
    box.export(folder / "house.ply")
    poses = [Pose((11.0 * math.cos(a), 10.0 * math.sin(a), 4.0 + 0.2 * n), math.pi + a, -0.1)
             for n, a in enumerate(np.linspace(-0.5 * math.pi, 1.5 * math.pi, views, endpoint=False))]
    write_views(poses, folder / "views.csv")
    settings = [*SETTINGS, *origin_for(external, at), f'survey.views_path="{folder / "views.csv"}"']
    sets = [part for s in settings for part in ("--set", s)]
    options = launcher._parse([str(HERE / "missions" / "house.toml"), "--scene", str(folder / "house.ply"), "--run",
                               str(folder / "run"), "--autopilot", f"{external}={url}", *sets])
    mission, run = prepare(options)
    table = processes.process_table(mission, run, processes.free_endpoint(), "mixed", quiet=True,
                                    autopilots={external: url})
    flight = processes.Flight(table, run, keep={})
    watcher = threading.Thread(target=watch, args=(flight,), daemon=True) if watch is not None else None
    try:
        if watcher is not None:
            watcher.start()
        complaints = flight.wait()
    finally:
        flight.stop()
    return run, complaints, json.loads(run.referee.read_text()) if run.referee.is_file() else {}
