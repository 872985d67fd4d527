"""The layout of a run folder: one place that knows every file name in it."""

from __future__ import annotations

import csv
import json
import logging
from pathlib import Path
from typing import Any

from missions.messages import PictureMeta

log = logging.getLogger(__name__)

VIEW_COLUMNS = ("view_id", "vehicle_id", "phase", "t_capture_s", "east_m", "north_m", "up_m", "qw", "qx", "qy", "qz",
                "speed_m_s", "path")


class RunFolder:
    """Paths of a run; folders are created when asked for."""

    def __init__(self, root: Path) -> None:
        self.root = root

    def _dir(self, name: str) -> Path:
        path = self.root / name
        path.mkdir(parents=True, exist_ok=True)
        return path

    @property
    def mission(self) -> Path:
        """The merged mission."""
        return self.root / "mission.toml"

    @property
    def endpoint(self) -> Path:
        """Where the bus of the mission is, while `swarmscan fly` flies it."""
        return self.root / "endpoint"

    @property
    def in_charge(self) -> Path:
        """Locked by the process that sees to what follows the flight."""
        return self.root / "in_charge"

    @property
    def prior(self) -> Path:
        """The prior model that the operator gives away before the flight; only there with knowledge = "mesh"."""
        return self.root / "prior.ply"

    @property
    def pictures(self) -> Path:
        """Pictures as the ground station received them."""
        return self._dir("pictures")

    @property
    def logs(self) -> Path:
        """One log per process."""
        return self._dir("logs")

    @property
    def truth(self) -> Path:
        """What sim_bridge's referee knows; read by `evaluate` and `report` alone, after the flight."""
        return self._dir("truth")

    @property
    def truth_mesh(self) -> Path:
        """The true object's mesh."""
        return self.truth / "reference.ply"

    @property
    def truth_samples(self) -> Path:
        """Points spread evenly over the exposed surface: arrays `points` and `normals`, each (n, 3) float32, with the
        names of the object's `parts` and the part of every sample and of every triangle of the mesh."""
        return self.truth / "reference_samples.npz"

    @property
    def referee(self) -> Path:
        """Collisions, clearances, coverage (JSON)."""
        return self.truth / "referee.json"

    @property
    def world_journal(self) -> Path:
        """What sim_bridge heard, tick by tick, for one that takes its place; see `sim_bridge/world_journal.py`."""
        return self.truth / "world.bin"

    @property
    def world_kept(self) -> Path:
        """The true scene and its light as they were made, for whoever takes the bridge's place; only there while it
        flies, see `sim_bridge/kept_world.py`."""
        return self.truth / "scene.npz"

    @property
    def truth_views(self) -> Path:
        """The rows of views.csv with the poses from which the pictures were really taken."""
        return self.truth / "views.csv"

    @property
    def views_csv(self) -> Path:
        """One row per picture, with its measured pose."""
        return self.root / "views.csv"

    @property
    def trajectories(self) -> Path:
        """Per vehicle: time, position, velocity, battery at 10 Hz; tours with ids of origin."""
        return self.root / "trajectories.npz"

    @property
    def flight(self) -> Path:
        """What the ground station knows of the flight: phases, tours, reassignments, outcomes (JSON)."""
        return self.root / "flight.json"

    @property
    def journal(self) -> Path:
        """What the ground station heard, turn by turn, and digests of what it said; see `ground_station/journal.py`."""
        return self.root / "journal.bin"

    @property
    def checkpoint(self) -> Path:
        """The ground station as it was a moment ago, and arrays that do not change; only there while it flies, see
        `ground_station/checkpoint.py`."""
        return self._dir("checkpoint")

    @property
    def tlog(self) -> Path:
        """Every MAVLink frame between ground station and vehicles, with its simulated time."""
        return self.root / "flight.tlog"

    @property
    def door_tlog(self) -> Path:
        """The same of other ground stations' frames; only there when the mission opened a door."""
        return self.root / "doors.tlog"

    @property
    def recording(self) -> Path:
        """The whole run for Foxglove; only there after `swarmscan missions export --format mcap`."""
        return self.root / "run.mcap"

    @property
    def map(self) -> Path:
        """What exploration knew of space and surface when it ended: the voxel grid and the surface voxels (npz)."""
        return self.root / "map.npz"

    @property
    def explore_depth(self) -> Path:
        """Depth of a few exploration pictures as the ground station knew it: arrays `view_id` (n,) and `depth_m`
        (n, h, w) float16, NaN where it was not trusted."""
        return self.root / "explore_depth.npz"

    @property
    def thesis_waypoints(self) -> Path:
        """Missions with the thesis's method: a row per planned waypoint with its vehicle and the id of origin (npz)."""
        return self.root / "thesis_waypoints.npz"

    @property
    def plans(self) -> Path:
        """What the vehicles flew, as files for ground stations; only there after `swarmscan missions export`."""
        return self._dir("plans")

    @property
    def alignment(self) -> Path:
        """Poses after bundle adjustment and what they rest on; the files are those of
        `perception.reconstruct.aligned_poses`."""
        return self.root / "alignment"

    @property
    def flight_alignment(self) -> Path:
        """The same of the pictures that a second flight was planned from; only there where `survey.refine` was flown
        from measured poses."""
        return self.root / "flight_alignment"

    @property
    def control_points(self) -> Path:
        """Ground control and check points with their marks, in the run's ENU; only there when they were given."""
        return self.root / "control_points.csv"

    @property
    def straightened(self) -> Path:
        """Survey pictures without distortion; only there where the camera's lens has some."""
        return self.root / "straightened"

    @property
    def cloud(self) -> Path:
        """Reconstructed cloud: x y z, red green blue, nx ny nz, confidence."""
        return self.root / "cloud.ply"

    @property
    def mesh(self) -> Path:
        """Reconstructed mesh."""
        return self.root / "mesh.ply"

    @property
    def model(self) -> Path:
        """The mesh with a texture made of the pictures: OBJ with MTL and PNG, and GLB."""
        return self._dir("model")

    @property
    def products(self) -> Path:
        """From what cloud, mesh and model were made (JSON): the same again is not made again."""
        return self.root / "products.json"

    @property
    def metrics(self) -> Path:
        """All numbers of the run."""
        return self.root / "metrics.json"

    @property
    def report(self) -> Path:
        """One self-contained page."""
        return self.root / "report.html"

    def picture(self, vehicle_id: int, view_id: int) -> Path:
        """`pictures/UAV_{id}_{pose_id}.jpg`, the thesis's naming."""
        return self.pictures / f"UAV_{vehicle_id}_{view_id}.jpg"

    def view_row(self, meta: PictureMeta) -> list[Any]:
        """The row of views.csv for a picture."""
        q = meta.pose.quaternion_wxyz
        e, n, u = meta.pose.position_enu_m
        numbers = [f"{v:.9f}" for v in (meta.t_capture_ns / 1e9, e, n, u, *q, meta.speed_m_s)]
        path = self.picture(meta.vehicle_id, meta.view_id).relative_to(self.root).as_posix()
        return [meta.view_id, meta.vehicle_id, meta.phase, *numbers, path]

    def sd_card(self, vehicle_id: int) -> Path:
        """The vehicle's own storage: pictures stay there until the ground has acknowledged them."""
        return self._dir(f"sd_card_uav{vehicle_id}")

    def aircraft(self, vehicle_id: int) -> Path:
        """The simulated aircraft while its process is dead; see `vehicle/aircraft_file.py`."""
        return self.root / f"aircraft_uav{vehicle_id}.bin"

    def on_board(self, vehicle_id: int) -> Path:
        """What a vehicle was told in flight and its range sensor has seen; see `vehicle/on_board.py`."""
        return self.root / f"on_board_uav{vehicle_id}.bin"

    def write_process_record(self, name: str, **extra: Any) -> None:
        """Peak memory of this process, for metrics.json; call once, at its end. A disk that takes no more has none."""
        record = {"name": name, "peak_memory_mib": round(peak_memory_mib(), 1), **extra}
        try:
            (self._dir("processes") / f"{name}.json").write_text(json.dumps(record), encoding="utf-8")
        except OSError as e:
            log.error("no record of this process: %s", e)

    def has_process_record(self, name: str) -> bool:
        """Whether this process, or one that has taken its place, has come to its end."""
        return (self._dir("processes") / f"{name}.json").is_file()

    def process_records(self) -> list[dict[str, Any]]:
        """All records written so far, by name."""
        return [json.loads(p.read_text(encoding="utf-8")) for p in sorted(self._dir("processes").glob("*.json"))]


def peak_memory_mib() -> float:
    """Largest resident memory so far, from Linux; getrusage would count what the parent held at the start as ours."""
    status = Path("/proc/self/status").read_text(encoding="ascii")
    return int(status.split("VmHWM:")[1].split()[0]) / 1024.0


def write_views(path: Path, rows: list[list[Any]]) -> None:
    """Write views.csv, rows in order of view id; whole, or what was there stays. Raises OSError."""
    part = path.with_name(f"{path.name}.part")
    try:
        with part.open("w", newline="", encoding="utf-8") as f:
            writer = csv.writer(f)
            writer.writerow(VIEW_COLUMNS)
            ordered: list[list[Any]] = sorted(rows, key=lambda row: (str(row[2]), int(row[0])))
            writer.writerows(ordered)
        part.replace(path)
    except OSError:
        part.unlink(missing_ok=True)
        raise
