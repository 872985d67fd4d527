"""The explored map as the survey's own pictures complete it: they show what exploration has left out."""

from __future__ import annotations

import logging
from typing import Protocol

import cv2
import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from ground_station.explore import Explorer
from ground_station.ingest import Picture
from missions.camera import Camera, Pose
from missions.frames import roll_about_axis
from missions.grid import VoxelGrid
from missions.messages import PictureMeta
from missions.mission import Mission
from missions.run_folder import RunFolder
from perception.lens import redrawn
from perception.mapping.explorer_map import ExplorerMap
from perception.reconstruct.pictures import SurveyPicture, read_colour

log = logging.getLogger(__name__)

BATCH = 8
"""Pictures that are mapped at a time: their depth is looked for among all before them and each other."""
LEAST_TO_ALIGN = 3


class CompletedMap(Protocol):
    """Survey pictures in, map out."""

    needs_time: bool
    """Whether vehicles should wait on their pads, not in the air, while `grid` is asked for."""

    def add(self, picture: Picture) -> None:
        """Take in a picture."""

    def grid(self) -> VoxelGrid:
        """With all pictures so far."""


def completed_map(explorer: Explorer, mission: Mission, run: RunFolder) -> CompletedMap:
    """The explorer's map, to be added to. run: where the pictures are."""
    at_once = SurveyMap(explorer.map, mission.camera.explore_px)
    return at_once if mission.camera.exact_poses else AlignedSurveyMap(at_once, explorer, mission, run)


class SurveyMap:
    """Where poses are exact: pictures are mapped as they arrive, at the exploration's resolution."""

    needs_time = False

    def __init__(self, explored: ExplorerMap, picture_px: tuple[int, int]) -> None:
        """explored: is added to."""
        self._map, self._picture_px = explored, picture_px
        self._new = 0

    def add(self, picture: Picture) -> None:
        """Take in a picture; one that was not decoded is left out."""
        if picture.rgb is not None:
            small = cv2.resize(picture.rgb, self._picture_px, interpolation=cv2.INTER_AREA).astype(picture.rgb.dtype)
            self.place(small, picture.meta.camera.scaled(*self._picture_px), picture.meta.pose)

    def place(self, rgb: NDArray[np.uint8], camera: Camera, pose: Pose) -> None:
        """Take in a picture (h, w, 3) without distortion that is known to be from there."""
        self._map.add_picture(rgb, camera, pose)
        self._new += 1
        if self._new >= BATCH:
            self._update()

    def grid(self) -> VoxelGrid:
        """With all pictures so far."""
        self._update()
        return self._map.grid()

    def _update(self) -> None:
        self._map.update()
        self._new = 0


class AlignedSurveyMap:
    """Where poses are measured: pictures are aligned with each other when all of them are there, and then mapped."""

    needs_time = True

    def __init__(self, within: SurveyMap, explorer: Explorer, mission: Mission, run: RunFolder) -> None:
        """within: is added to. explorer: its pictures stand by where survey pictures have too few neighbours."""
        self._map, self._explorer, self._mission, self._run = within, explorer, mission, run
        self._taken: list[PictureMeta] = []

    def add(self, picture: Picture) -> None:
        """Take in a picture, which is read from disk when it is mapped."""
        self._taken.append(picture.meta)

    def grid(self) -> VoxelGrid:
        """With all pictures that could be aligned; takes as long as aligning takes, half a second per picture."""
        from perception.reconstruct.alignment import align  # a second of imports that flights without do not need
        from perception.reconstruct.bundle import Accuracy

        taken, self._taken = sorted(self._taken, key=lambda meta: meta.view_id), []
        if len(taken) < LEAST_TO_ALIGN:
            return self._map.grid()
        camera, spec = self._mission.camera, self._mission.reconstruct
        pictures = [self._picture(m.vehicle_id, m.view_id, m.camera, m.pose) for m in taken]
        found = align(pictures, Accuracy.of(camera), self._mission.survey.distance_m, self._run.flight_alignment,
                      lens=camera.distortion, calibrate=spec.calibrate, explored=self._explored())
        optics, reduced = found.optics, pictures[0].camera_at(camera.explore_px[0])
        size = reduced.width_px, reduced.height_px
        wanted = optics.pinhole.scaled(*size)
        for picture, pose in zip(found.pictures, found.poses, strict=True):
            if pose.state == "aligned":
                small = redrawn(read_colour(picture, size[0]), optics.camera.scaled(*size), optics.lens, wanted)
                self._map.place(small, wanted, rolled_pose(picture))
        log.info("%d of %d pictures aligned for a second flight", found.numbers["registered"], len(pictures))
        return self._map.grid()

    def _explored(self) -> list[SurveyPicture]:
        camera = self._mission.camera.explore_camera()
        return [self._picture(vehicle_id, view_id, camera, pose)
                for (vehicle_id, view_id), pose in sorted(self._explorer.pictured.items(), key=lambda item: item[0][1])]

    def _picture(self, vehicle_id: int, view_id: int, camera: Camera, pose: Pose) -> SurveyPicture:
        return SurveyPicture(view_id, self._run.picture(vehicle_id, view_id), camera, pose.enu_from_camera,
                             np.array(pose.position_enu_m))


def rolled_pose(picture: SurveyPicture) -> Pose:
    """The pose of a picture by its angles, roll included."""
    return replace(picture.pose, roll_rad=roll_about_axis(picture.enu_from_camera))
