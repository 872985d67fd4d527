"""The prior model as the ground station uses it (knowledge = "mesh"): the mesh itself, as a map, and as clearances."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from missions.grid import VoxelGrid
from missions.messages import SiteBrief
from missions.mission import Mission
from missions.pads import geofence
from missions.prior_file import load_prior, prior_file
from missions.run_folder import RunFolder
from planning.paths import MeshField, voxelised

if TYPE_CHECKING:
    import trimesh


@dataclass(frozen=True)
class Prior:
    """What the operator's model says of space inside the geofence."""

    mesh: trimesh.Trimesh
    grid: VoxelGrid
    """Free outside, occupied where the surface or the inside is."""
    field: MeshField

    @classmethod
    def of(cls, mesh: trimesh.Trimesh, mission: Mission, site: SiteBrief) -> Prior:
        """A mesh (ENU metres) in the geofence."""
        grid = voxelised(mesh.vertices, mesh.faces, *geofence(mission, site), mission.explore.voxel_m)
        return cls(mesh, grid, MeshField.from_mesh(mesh.vertices, mesh.faces, grid))


def open_prior(mission: Mission, run: RunFolder, site: SiteBrief) -> Prior | None:
    """The mission's prior model; None where nothing is known before. Raises UserError."""
    path = prior_file(mission, run)
    return None if path is None else Prior.of(load_prior(path), mission, site)
