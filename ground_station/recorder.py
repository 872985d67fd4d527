"""What the ground station knows of the flight, on disk: trajectories.npz at 10 Hz and flight.json."""

from __future__ import annotations

import json
import time
from dataclasses import dataclass, field
from typing import Any

import msgspec
import numpy as np

from missions.clock import SECOND_NS
from missions.frames import Array
from missions.grid import SurfaceVoxels, VoxelGrid
from missions.messages import PictureMeta, SiteBrief, VehicleState
from missions.mission import Mission
from missions.run_folder import RunFolder

RATE_HZ = 10


@dataclass
class Track:
    """States of one vehicle in order of time, and the views it has flown."""

    t_ns: list[int] = field(default_factory=list)
    position: list[tuple[float, float, float]] = field(default_factory=list)
    velocity: list[tuple[float, float, float]] = field(default_factory=list)
    battery: list[float] = field(default_factory=list)
    view_ids: list[int] = field(default_factory=list)
    origin_ids: list[int] = field(default_factory=list)

    def add(self, state: VehicleState) -> None:
        """Append a state; what is not newer than the last one is left out."""
        if not self.t_ns or state.t_ns > self.t_ns[-1]:
            self.t_ns.append(state.t_ns)
            self.position.append(state.position_enu_m)
            self.velocity.append(state.velocity_enu_m_s)
            self.battery.append(state.battery_percent)

    def sampled(self) -> tuple[Array, Array, Array, Array]:
        """(t_s (n,), position_enu_m (n, 3), velocity_enu_m_s (n, 3), battery_percent (n,)) at exactly 10 Hz."""
        step = SECOND_NS // RATE_HZ
        if not self.t_ns:
            return np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0)
        grid = np.arange(-(-self.t_ns[0] // step), self.t_ns[-1] // step + 1) * step
        known = np.array(self.t_ns)

        def at(values: Array) -> Array:
            return np.stack([np.interp(grid, known, column) for column in values.T], axis=-1)

        return (grid / SECOND_NS, at(np.array(self.position)), at(np.array(self.velocity)),
                np.interp(grid, known, np.array(self.battery)))

    def path_m(self) -> float:
        """Length of the flown path."""
        return float(np.linalg.norm(np.diff(np.array(self.position).reshape(-1, 3), axis=0), axis=1).sum())


class Recorder:
    """Collects during the flight; `write` may be called at any time, also after a crash, and writes what is known."""

    def __init__(self, run: RunFolder, mission: Mission, site: SiteBrief) -> None:
        self._run, self._mission, self._site = run, mission, site
        self.tracks = {k: Track() for k in range(1, mission.fleet.vehicles + 1)}
        self.phases: dict[str, dict[str, float]] = {}
        self.battery_at_view: list[dict[str, float | int]] = []
        self.predicted_coverage: list[float] = []
        self.notes: list[str] = []
        self.outcomes: dict[str, str] = {}
        self.reassignments: list[dict[str, Any]] = []
        self.planned: dict[str, Any] = {}
        self._wall: dict[str, float] = {}
        self._ended: set[str] = set()

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
        i = int(np.searchsorted(np.array(track.t_ns), meta.t_capture_ns, side="right")) - 1
        self.battery_at_view.append({"view_id": meta.view_id, "vehicle_id": meta.vehicle_id,
                                     "t_s": meta.t_capture_ns / SECOND_NS,
                                     "battery_percent": track.battery[i] if i >= 0 else 100.0})

    def write_map(self, grid: VoxelGrid, surface: SurfaceVoxels) -> None:
        """Write map.npz, what the survey was planned on."""
        np.savez_compressed(self._run.map, origin_enu_m=grid.origin_enu_m, voxel_m=grid.voxel_m, state=grid.state,
                            surface_position_enu_m=surface.position_enu_m, surface_normal_enu=surface.normal_enu,
                            surface_seen_count=surface.seen_count)

    def write(self, t_ns: int) -> None:
        """Write trajectories.npz and flight.json; a phase that was cut short ends here."""
        for phase in self._wall.keys() - self._ended:
            self.end(phase, t_ns)
        arrays: dict[str, Any] = {}
        for k, track in self.tracks.items():
            names = ("t_s", "position_enu_m", "velocity_enu_m_s", "battery_percent")
            arrays |= {f"uav{k}_{name}": values for name, values in zip(names, track.sampled(), strict=True)}
            arrays[f"uav{k}_view_ids"] = np.array(track.view_ids, dtype=np.int64)
            arrays[f"uav{k}_origin_ids"] = np.array(track.origin_ids, dtype=np.int64)
        np.savez_compressed(self._run.trajectories, **arrays)
        self._run.flight.write_text(json.dumps(self._flight(t_ns), indent=1), encoding="utf-8")

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
            "reassignments": self.reassignments, "outcomes": self.outcomes,
            "battery_at_view": self.battery_at_view, "predicted_coverage": self.predicted_coverage,
            "notes": self.notes,
        }
