"""Clearance, paths around obstacles, and distances to many goals at once."""

from planning.paths.fields import ObstacleField, VoxelField
from planning.paths.mesh_field import MeshField, voxelised
from planning.paths.reach import Reach, reachable
from planning.paths.refusal import NoPath
from planning.paths.replan import plan_path, shortcut

__all__ = ["MeshField", "NoPath", "ObstacleField", "Reach", "VoxelField", "plan_path", "reachable",
           "shortcut", "voxelised"]
