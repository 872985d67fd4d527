"""What the ground station knows of the flight, on disk: trajectories.npz at 10 Hz and flight.json."""

from __future__ import annotations

import io
import json
import time
from bisect import bisect_right
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from missions.clock import SECOND_NS
from missions.disk import Disk
from missions.errors import DiskError
from missions.frames import Array
from missions.grid import SurfaceVoxels, VoxelGrid
from missions.messages import PictureMeta, SiteBrief, VehicleState
from missions.mission import Mission
from missions.run_folder import RunFolder
from missions.tlog import Tlog
from perception.depth.depth_map import DepthMap

RATE_HZ = 10
PATIENCE_S = 60.0
"""For files that are written once."""


@dataclass
class Track:
    """States of one vehicle in order of time, and the views it has flown."""

    t_ns: list[int] = field(default_factory=list)
    position: list[tuple[float, float, float]] = field(default_factory=list)
    velocity: list[tuple[float, float, float]] = field(default_factory=list)
    battery: list[float] = field(default_factory=list)
    mode: list[str] = field(default_factory=list)
    view_ids: list[int] = field(default_factory=list)
    origin_ids: list[int] = field(default_factory=list)

    def add(self, state: VehicleState) -> None:
        """Append a state; what is not newer than the last one is left out."""
        if not self.t_ns or state.t_ns > self.t_ns[-1]:
            self.t_ns.append(state.t_ns)
            self.position.append(state.position_enu_m)
            self.velocity.append(state.velocity_enu_m_s)
            self.battery.append(state.battery_percent)
            self.mode.append(state.mode)

    def sampled(self) -> dict[str, NDArray[Any]]:
        """At exactly 10 Hz: t_s (n,), position_enu_m (n, 3), velocity_enu_m_s (n, 3), battery_percent (n,), and mode
        (n,), what the vehicle said last that it was doing."""
        step = SECOND_NS // RATE_HZ
        known = np.array(self.t_ns, dtype=np.int64)
        grid = np.arange(-(-known[0] // step), known[-1] // step + 1) * step if len(known) else known

        def at(values: Array) -> Array:
            return np.array([np.interp(grid, known, column) for column in values.T]).T.reshape(-1, 3)

        newest = np.searchsorted(known, grid, side="right") - 1
        return {"t_s": grid / SECOND_NS, "position_enu_m": at(np.array(self.position)),
                "velocity_enu_m_s": at(np.array(self.velocity)),
                "battery_percent": np.interp(grid, known, np.array(self.battery)) if len(known) else np.zeros(0),
                "mode": np.array(self.mode, dtype=np.str_)[newest]}

    def level_at(self, t_ns: int) -> float:
        """Battery, percent, as last told at a time; 100 before anything was told."""
        i = bisect_right(self.t_ns, t_ns) - 1
        return self.battery[i] if i >= 0 else 100.0

    def path_m(self) -> float:
        """Length of the flown path."""
        return float(np.linalg.norm(np.diff(np.array(self.position).reshape(-1, 3), axis=0), axis=1).sum())


class Recorder:
    """Collects during the flight; `write` may be called at any time, also after a crash, and writes what is known."""

    def __init__(self, run: RunFolder, mission: Mission, site: SiteBrief) -> None:
        self.run, self._mission, self._site = run, mission, site
        self._disk = Disk(run.root, PATIENCE_S, slow_s=PATIENCE_S)
        self._unwritten: dict[Path, bytes] = {}
        """What the disk has not taken; it is tried once more at the end."""
        self.tracks = {k: Track() for k in range(1, mission.fleet.vehicles + 1)}
        self.phases: dict[str, dict[str, float]] = {}
        self.battery_at_view: list[dict[str, float | int]] = []
        self.predicted_coverage: list[float] = []
        self.exploration: dict[str, Any] = {}
        """See `ExplorationLog.document`."""
        self.mavlink = Tlog(run.tlog, mission.clock.epoch_utc)
        """Every frame from and to the vehicles; on disk as the flight goes on."""
        self.notes: list[str] = []
        self.outcomes: dict[str, str] = {}
        self.outcome_details: dict[str, str] = {}
        self.allocations: list[dict[str, Any]] = []
        self.reassignments: list[dict[str, Any]] = []
        self.plans: list[dict[str, Any]] = []
        self._wall: dict[str, float] = {}
        self._ended: set[str] = set()
        self._plans: dict[int, dict[str, Any]] = {}

    def begin(self, phase: str, t_ns: int) -> None:
        """A phase starts."""
        self._wall[phase] = time.monotonic()
        self.phases[phase] = {"start_s": t_ns / SECOND_NS, "end_s": t_ns / SECOND_NS, "wall_s": 0.0}

    def end(self, phase: str, t_ns: int) -> None:
        """A phase is over."""
        self._ended.add(phase)
        self.phases[phase]["end_s"] = t_ns / SECOND_NS
        self.phases[phase]["wall_s"] = round(time.monotonic() - self._wall[phase], 3)

    def note(self, t_ns: int, text: str) -> None:
        """Something a reader of the report should know."""
        self.notes.append(f"{t_ns / SECOND_NS:.1f} s: {text}")

    def picture(self, meta: PictureMeta, origin: int) -> None:
        """A picture was received; origin is the vehicle its view was first given to."""
        track = self.tracks[meta.vehicle_id]
        track.view_ids.append(meta.view_id)
        track.origin_ids.append(origin)
        self.battery_at_view.append({"view_id": meta.view_id, "vehicle_id": meta.vehicle_id,
                                     "t_s": meta.t_capture_ns / SECOND_NS,
                                     "battery_percent": track.level_at(meta.t_capture_ns)})

    def plan_begins(self, vehicle_id: int, phase: str, views: int, t_ns: int,
                    predicted_percent: float | None = None) -> None:
        """A plan is sent to a hovering vehicle. predicted_percent: what flying it should take out of the battery."""
        self._plans[vehicle_id] = {"vehicle_id": vehicle_id, "phase": phase, "views": views,
                                   "start_s": t_ns / SECOND_NS, "predicted_percent": predicted_percent,
                                   "start_percent": self.tracks[vehicle_id].level_at(t_ns)}

    def plan_ends(self, vehicle_id: int, t_ns: int, flown: bool) -> None:
        """The plan sent last is over; flown: to its end, not broken off."""
        plan = self._plans.pop(vehicle_id, None)
        if plan is not None:
            self.plans.append({**plan, "end_s": t_ns / SECOND_NS, "flown": flown,
                               "end_percent": self.tracks[vehicle_id].level_at(t_ns)})

    def write_map(self, grid: VoxelGrid, surface: SurfaceVoxels) -> None:
        """Write map.npz, what the survey was planned on."""
        self._keep(self.run.map, _npz(
            origin_enu_m=grid.origin_enu_m, voxel_m=grid.voxel_m, state=grid.state,
            surface_position_enu_m=surface.position_enu_m, surface_normal_enu=surface.normal_enu,
            surface_seen_count=surface.seen_count))

    def write_depths(self, depths: dict[int, DepthMap]) -> None:
        """Write explore_depth.npz: depth by view id, all of one size."""
        known = [np.where(d.valid, d.depth_m, np.nan).astype(np.float16) for d in depths.values()]
        self._keep(self.run.explore_depth, _npz(view_id=np.array(list(depths), dtype=np.int64),
                                                depth_m=np.array(known)))

    def write(self, t_ns: int) -> None:
        """Write trajectories.npz, flight.json and the rest of the tlog; a phase that was cut short ends here. Raises
        DiskError, with all written that could be."""
        self.mavlink.flush()
        for phase in self._wall.keys() - self._ended:
            self.end(phase, t_ns)
        arrays: dict[str, Any] = {}
        for k, track in self.tracks.items():
            arrays |= {f"uav{k}_{name}": values for name, values in track.sampled().items()}
            arrays[f"uav{k}_view_ids"] = np.array(track.view_ids, dtype=np.int64)
            arrays[f"uav{k}_origin_ids"] = np.array(track.origin_ids, dtype=np.int64)
        self._keep(self.run.trajectories, _npz(**arrays))
        self._keep(self.run.flight, json.dumps(self._flight(t_ns), indent=1).encode())
        for path in list(self._unwritten):
            self._keep(path, self._unwritten.pop(path))
        missing = [path.name for path in self._unwritten]
        if missing:
            raise DiskError(f"{self.run.root}: the disk {self._disk.trouble}, and {', '.join(missing)} could not be "
                            "written; pictures that it took are kept, the others are on the vehicles' cards.")

    def _keep(self, path: Path, data: bytes) -> None:
        if not self._disk.write(path, data):
            self._unwritten[path] = data

    def _flight(self, t_ns: int) -> dict[str, Any]:
        values = list(self.outcomes.values())
        return {
            "title": self._mission.title, "seed": self._mission.seed, "mission_hash": self._mission.mission_hash,
            "site": msgspec.to_builtins(self._site), "phases": self.phases,
            "fleet": {
                "makespan_s": t_ns / SECOND_NS,
                "path_m": {str(k): track.path_m() for k, track in self.tracks.items()},
                "battery_end_percent": {str(k): t.battery[-1] for k, t in self.tracks.items() if t.battery},
                "views_flown": values.count("flown"), "views_reassigned": len(self.reassignments),
                "views_unreachable": values.count("unreachable"),
            },
            "tours": {str(k): track.view_ids for k, track in self.tracks.items()},
            "reassignments": self.reassignments, "allocations": self.allocations,
            "outcomes": self.outcomes, "outcome_details": self.outcome_details, "plans": self.plans,
            "battery_at_view": self.battery_at_view, "predicted_coverage": self.predicted_coverage,
            "exploration": self.exploration, "notes": self.notes,
        }


def _npz(**arrays: Any) -> bytes:
    file = io.BytesIO()
    np.savez_compressed(file, **arrays)
    return file.getvalue()
