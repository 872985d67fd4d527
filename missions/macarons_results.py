"""Result files of MACARONS: per scene and start the coverage after each move, and every pose on the way.

`{scene: {start: {coverage: [...], X_cam_history: [[x, y, z], ...], V_cam_history: [[elevation, azimuth], ...]}}}` in
scaled units and degrees. The first row is the pose from which the first move, to the start, was made; each move then
has FRAMES_PER_MOVE rows, the last of them the key pose that coverage counts.
"""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np

from missions.errors import UserError
from missions.frames import Array

FRAMES_PER_MOVE = 4


class MacaronsRun(msgspec.Struct, frozen=True, kw_only=True):
    """One exploration."""

    coverage: list[float] = []
    X_cam_history: list[tuple[float, float, float]]
    V_cam_history: list[tuple[float, float]]

    def rows(self, every_picture: bool = False) -> Array:
        """(n, 5) x, y, z, elevation, azimuth of the key poses, or of every picture."""
        rows = np.hstack([np.array(self.X_cam_history), np.array(self.V_cam_history)])
        return rows if every_picture else rows[FRAMES_PER_MOVE::FRAMES_PER_MOVE]

    @classmethod
    def of_key_poses(cls, rows: Array, coverage: list[float]) -> MacaronsRun:
        """The run that visits key poses (n, 5), with pictures between them as MACARONS takes them. The move to the
        start, which nobody made, stays at the start."""
        stops = np.vstack([rows[:1], rows])
        step = np.diff(stops, axis=0)
        step[:, 4] = (step[:, 4] + 180.0) % 360.0 - 180.0
        share = np.arange(1, FRAMES_PER_MOVE + 1) / FRAMES_PER_MOVE
        between = (stops[:-1, None] + share[:, None] * step[:, None]).reshape(-1, 5)
        between[FRAMES_PER_MOVE - 1::FRAMES_PER_MOVE] = rows
        history = np.vstack([stops[:1], between])
        return cls(coverage=coverage, X_cam_history=[(float(x), float(y), float(z)) for x, y, z in history[:, :3]],
                   V_cam_history=[(float(e), float(a)) for e, a in history[:, 3:]])


Results = dict[str, dict[str, MacaronsRun]]


def read_results(path: Path) -> Results:
    """All runs of a result file by scene and start. Raises UserError."""
    try:
        results = msgspec.json.decode(path.read_bytes(), type=Results)
    except OSError as e:
        raise UserError(f"{path}: cannot be read ({e.strerror}); give a result file of MACARONS.") from e
    except msgspec.DecodeError as e:
        raise UserError(f"{path}: not a result file of MACARONS ({e}); give one with X_cam_history and "
                        "V_cam_history.") from e
    for scene, starts in results.items():
        for start, run in starts.items():
            if len(run.X_cam_history) != len(run.V_cam_history) or len(run.X_cam_history) <= FRAMES_PER_MOVE:
                raise UserError(f"{path}: {scene} {start}: X_cam_history and V_cam_history must be equally long and "
                                f"hold more than {FRAMES_PER_MOVE} rows; export the run again.")
    return results


def write_results(results: Results, path: Path) -> None:
    """Write a result file."""
    path.write_bytes(msgspec.json.encode(results))
