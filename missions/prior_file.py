"""The model that the operator has of the structure before the flight (knowledge = "mesh"): where it is, reading it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from missions.errors import UserError
from missions.mission import Mission
from missions.run_folder import RunFolder

if TYPE_CHECKING:
    import trimesh


def prior_file(mission: Mission, run: RunFolder) -> Path | None:
    """The prior model's file: the mission's own, else the one in the run folder; None where nothing is known before."""
    if mission.knowledge == "none":
        return None
    return Path(mission.prior_path) if mission.prior_path else run.prior


def load_prior(path: Path) -> trimesh.Trimesh:
    """A GLB, OBJ, PLY or STL file in ENU metres as one mesh, its vertices and faces as they are. Raises UserError."""
    import trimesh  # vehicles without a prior model do without it

    if not path.is_file():
        raise UserError(f"{path}: no such prior model; correct prior_path.")
    try:
        mesh = trimesh.load_mesh(path, process=False, skip_materials=True)
    except Exception as e:  # trimesh's readers raise whatever their formats make them
        raise UserError(f"{path}: cannot be read as a mesh ({e}); give a GLB, OBJ, PLY or STL file.") from e
    if not len(mesh.faces):
        raise UserError(f"{path}: holds no triangles; give a prior model with faces.")
    if not np.isfinite(mesh.vertices).all():
        raise UserError(f"{path}: holds vertices that are no numbers; repair the prior model.")
    return mesh
