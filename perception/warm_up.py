"""Compiles this room's kernels into numba's cache on disk, by mapping a tiny wall: python -m perception.warm_up.

Calling what a mission calls compiles exactly the types and memory layouts that a mission needs.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from missions.camera import Camera, Pose
from perception.depth.depth_map import DepthMap
from perception.depth.pictures import PictureDepths
from perception.imagination.imagine import Imagination
from perception.imagination.layers import gradients
from perception.imagination.surroundings import COUNT
from perception.mapping.line_votes import Lines, LineVotes
from perception.mapping.voxel_map import VoxelMap
from perception.products.best_pictures import CANDIDATES, Candidates, best_pictures
from perception.products.surface import Surface
from perception.reconstruct.cloud import Cloud
from perception.reconstruct.depth_map import merge_pairs
from perception.reconstruct.features import Features
from perception.reconstruct.free_space import not_looked_through
from perception.reconstruct.fusion import PosedDepth, support
from perception.reconstruct.matching import match, nearest_anywhere
from perception.reconstruct.onlookers import Onlookers
from perception.reconstruct.optics import Optics
from perception.reconstruct.outliers import without_outliers
from perception.reconstruct.pictures import SurveyPicture
from perception.reconstruct.refinement import refined
from perception.reconstruct.stereo import Eye, PairDepth
from perception.reconstruct.ties import Known, ties
from perception.wires.agreement import agree
from perception.wires.crowds import alone
from perception.wires.lookup import gathered, rays_enu, sorted_lines
from perception.wires.mutual import drawn_together
from perception.wires.ridges import ridges

CAMERA = Camera.from_diagonal_fov(64, 48, 90.0)
WALL_M = 4.0


def warm_up() -> None:
    """Sweep planes through two pictures, map a wall from its depth, look for wires, fuse depth maps, follow a wire,
    choose the picture of a triangle and imagine a voxel of what is not seen."""
    poses = [Pose((0.0, y, 2.0), 0.0, 0.0) for y in (2.0, 2.5)]
    picture = np.random.default_rng(1).integers(0, 255, (CAMERA.height_px, CAMERA.width_px, 3), dtype=np.uint8)
    depths = PictureDepths(min_sources=1)
    for pose in poses:
        depths.add(picture, CAMERA, pose)
    depths.update()
    camera = CAMERA.scaled(CAMERA.width_px // 2, CAMERA.height_px // 2)
    wall = np.full((camera.height_px, camera.width_px), WALL_M, dtype=np.float32)
    _map(camera, poses, wall)
    LineVotes(np.array([[3.0, 2.0, 2.0]]), 9.0).add(Lines.of(picture), CAMERA, poses[0])
    _fuse(camera, poses, wall.copy())
    _lines(poses)
    shown = Candidates(np.zeros((1, CANDIDATES), np.int32), np.ones((1, CANDIDATES), np.float32), np.ones(1, bool))
    best_pictures(Surface(np.eye(3), np.zeros((3, 3), np.uint8), np.array([[0, 1, 2]])), shown)
    imagination, known = Imagination.load(), np.zeros((8, COUNT), np.float32)
    imagination.chance(known)
    gradients(known, known[:, 0].copy(), known[:, 0].copy(), imagination.mean, imagination.scale, *imagination.layers)


def _map(camera: Camera, poses: list[Pose], depth: np.typing.NDArray[np.float32]) -> None:
    voxels = VoxelMap(np.zeros(3), np.array([6.0, 5.0, 5.0]), 0.5)
    yes = np.ones(depth.shape, dtype=np.bool_)
    for pose in poses:
        voxels.integrate(DepthMap(camera, pose, depth, yes, np.ones_like(depth), ~yes, 0.001))
    voxels.surface()


def _fuse(camera: Camera, poses: list[Pose], depth: np.typing.NDArray[np.float32]) -> None:
    merge_pairs([PairDepth(1.0 / depth, 0.01)], depth.shape)
    bare, no_sky = np.zeros(depth.shape, np.uint8), np.zeros(depth.shape, np.bool_)
    eyes = [Eye(bare, no_sky, camera, pose.enu_from_camera, np.array(pose.position_enu_m)) for pose in poses]
    refined(eyes[0], eyes[1:], depth)
    depth.setflags(write=False)  # a pipeline reads its depth maps from files mapped read-only
    own, other = (PosedDepth(depth, pose.enu_from_camera, np.array(pose.position_enu_m)) for pose in poses)
    support(own, [other], camera)
    Onlookers([own, other], camera).of(0, 1)
    point = np.zeros((1, 3), np.float32)
    cloud = Cloud(point, point.astype(np.uint8), point, np.ones(1, np.uint8))
    not_looked_through(cloud, [replace(own, depth=depth.copy())], camera, 1.0)
    without_outliers(cloud, 0.03)
    seen = Features(np.zeros((1, 2), np.float32), np.zeros((1, 128), np.uint8), np.zeros(1, np.float32))
    first, second = (SurveyPicture(k, Path(), camera, pose.enu_from_camera, np.array(pose.position_enu_m))
                     for k, pose in enumerate(poses))
    match(first, second, seen, seen, 1.0)
    nearest_anywhere(seen, seen)
    nobody, place = np.zeros(1, np.int64), np.array([[2.0, 2.0, 2.0]])
    ties(first, seen, Known(nobody, nobody, nobody, place, second.position_enu_m[None] - place, np.ones(1),
                            seen.descriptors), Optics(camera), 1.0)


def _lines(poses: list[Pose]) -> None:
    """A wire in two pictures."""
    picture = np.full((48, 64), 128, np.uint8)
    picture[:, 30] = 0
    pictures = [SurveyPicture(k, Path(), CAMERA, p.enu_from_camera, np.array(p.position_enu_m))
                for k, p in enumerate(poses)]
    lines = [alone(sorted_lines(ridges(picture), p), p) for p in pictures]
    own, rays, out = lines[0], rays_enu(lines[0].ridges, pictures[0]), np.zeros((len(lines[0].normal), 9))
    agree(np.tile([1.0, 9.0], (len(rays), 1)), own.normal, rays, pictures[0].position_enu_m, CAMERA.fx_px,
          gathered(pictures[1:], lines[1:]), 1, out)
    drawn_together(rays, rays, np.zeros(len(rays), np.int64))


if __name__ == "__main__":
    warm_up()
