"""What a run folder tells: every reader tolerates missing parts, and says what is missing."""

from __future__ import annotations

import csv
import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from missions.camera import Pose
from missions.errors import UserError
from missions.frames import Array, matrix_from_quaternion, yaw_elevation_from_forward
from missions.grid import VoxelGrid
from missions.mission import Mission
from missions.mission_file import load_mission
from missions.run_folder import RunFolder
from perception.reconstruct.pictures import SurveyPicture
from perception.reconstruct.settings import Region

REGION_MARGIN_M = 0.25
"""The kept region reaches this far beyond the object's box, so that noise on its outermost faces is kept too."""
GROUND_CLEARANCE_M = 0.10
"""Points less than this above the ground belong to the ground and are left out."""


class ViewRow(msgspec.Struct, frozen=True):
    """A row of views.csv."""

    view_id: int
    vehicle_id: int
    phase: str
    t_capture_s: float
    east_m: float
    north_m: float
    up_m: float
    qw: float
    qx: float
    qy: float
    qz: float
    speed_m_s: float
    path: str

    @property
    def position_enu_m(self) -> Array:
        """(3,) where the picture was taken."""
        return np.array([self.east_m, self.north_m, self.up_m])

    @property
    def enu_from_camera(self) -> Array:
        """(3, 3) rotation."""
        return matrix_from_quaternion(np.array([self.qw, self.qx, self.qy, self.qz]))

    @property
    def pose(self) -> Pose:
        """The same, without roll."""
        return Pose((self.east_m, self.north_m, self.up_m), *yaw_elevation_from_forward(self.enu_from_camera[:, 2]))


@dataclass(frozen=True)
class Track:
    """A vehicle's flight at 10 Hz. `mode`, what it said that it was doing, is empty in runs that did not record it."""

    vehicle_id: int
    t_s: Array
    position_enu_m: Array
    battery_percent: Array
    mode: NDArray[np.str_]


@dataclass(frozen=True)
class RunData:
    """Mission, flight and truth of a run; empty dicts and lists where a file is missing, with a note."""

    run: RunFolder
    mission: Mission
    views: list[ViewRow]
    flight: dict[str, Any]
    referee: dict[str, Any]
    tracks: list[Track]
    notes: list[str] = field(default_factory=list)

    @property
    def box(self) -> tuple[Array, Array] | None:
        """The object's box (lower, upper) in ENU metres: from the mission, else from the flight; None if unknown."""
        site, told = self.mission.site, self.flight.get("site") or self.referee.get("site") or {}
        lower = site.object_min_enu_m or told.get("object_min_enu_m")
        upper = site.object_max_enu_m or told.get("object_max_enu_m")
        return None if lower is None or upper is None else (np.array(lower, float), np.array(upper, float))

    @property
    def ground_up_m(self) -> float | None:
        """Height of the ground; None if unknown."""
        told = self.flight.get("site") or self.referee.get("site") or {}
        ground = self.mission.site.ground_up_m
        return ground if ground is not None else told.get("ground_up_m")

    def grid(self) -> VoxelGrid:
        """The explored map. Raises FileNotFoundError when the run has none."""
        with np.load(self.run.map) as stored:
            return VoxelGrid(stored["origin_enu_m"], float(stored["voxel_m"]), stored["state"])

    def survey_pictures(self) -> list[SurveyPicture]:
        """The survey's pictures in order of view id."""
        camera = self.mission.camera.survey_camera()
        rows = sorted((v for v in self.views if v.phase == "survey"), key=lambda v: v.view_id)
        return [SurveyPicture(v.view_id, self.run.root / v.path, camera, v.enu_from_camera, v.position_enu_m)
                for v in rows]

    def exploration_pictures(self) -> list[SurveyPicture]:
        """The exploration's pictures in order of view id."""
        camera = self.mission.camera.explore_camera()
        rows = sorted((v for v in self.views if v.phase == "explore"), key=lambda v: v.view_id)
        return [SurveyPicture(v.view_id, self.run.root / v.path, camera, v.enu_from_camera, v.position_enu_m)
                for v in rows]

    def region(self) -> Region:
        """What to reconstruct and to measure: the object's box with a margin, above the ground.

        Without a known box, the space that the survey's cameras enclose.
        """
        if self.box is None:
            stands = np.array([p.position_enu_m for p in self.survey_pictures()]).reshape(-1, 3)
            if not len(stands):
                raise UserError(f"{self.run.views_csv}: no survey pictures, and site.object_min_enu_m is not in "
                                "mission.toml; fly the survey first.")
            return Region(stands.min(axis=0), stands.max(axis=0))
        lower, upper = self.box[0] - REGION_MARGIN_M, self.box[1] + REGION_MARGIN_M
        if self.ground_up_m is not None:
            lower[2] = max(lower[2], self.ground_up_m + GROUND_CLEARANCE_M)
        return Region(lower, upper)


def read_run(run: RunFolder) -> RunData:
    """Everything there is. Raises UserError when the folder holds no mission.toml."""
    if not run.mission.is_file():
        raise UserError(f"{run.root}: mission.toml is missing; give the folder that 'swarmscan fly' made.")
    notes: list[str] = []
    flight = _json(run.flight, "flight.json is missing: no tours, batteries or reassignments are shown", notes)
    referee = _json(run.referee,
                    "truth/referee.json is missing: collisions, clearances and coverage are unknown", notes)
    return RunData(run, load_mission(run.mission), read_views(run.views_csv), flight, referee,
                   _tracks(run.trajectories), notes)


def read_views(path: Path) -> list[ViewRow]:
    """The rows of views.csv; none when it does not exist. Raises UserError naming the row that cannot be read."""
    if not path.is_file():
        return []
    rows = []
    with path.open(newline="", encoding="utf-8") as f:
        for number, row in enumerate(csv.DictReader(f), start=2):
            try:
                rows.append(msgspec.convert(row, ViewRow, strict=False))
            except msgspec.ValidationError as e:
                raise UserError(f"{path}: line {number}: {e}; correct or remove that line.") from e
    return rows


def _json(path: Path, absence: str, notes: list[str]) -> dict[str, Any]:
    if not path.is_file():
        notes.append(absence + ".")
        return {}
    try:
        content: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    except json.JSONDecodeError as e:
        raise UserError(f"{path}: not valid JSON ({e}); restore the file or remove it.") from e
    return content


def _tracks(path: Path) -> list[Track]:
    if not path.is_file():
        return []
    with np.load(path) as data:
        ids = sorted(int(name[3:-4]) for name in data.files if name.startswith("uav") and name.endswith("_t_s"))
        return [Track(i, data[f"uav{i}_t_s"], data[f"uav{i}_position_enu_m"], data[f"uav{i}_battery_percent"],
                      data.get(f"uav{i}_mode", np.zeros(0, dtype=np.str_))) for i in ids]
