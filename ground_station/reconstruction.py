"""From the survey's pictures to everything that is made of them, stage by stage: what is there already is kept."""

from __future__ import annotations

import hashlib
import json
import logging
import shutil
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import msgspec

from ground_station.control_file import read_control
from ground_station.report.run_data import RunData, read_run
from ground_station.stage_record import StageRecord
from missions.errors import UserError
from missions.run_folder import RunFolder
from perception.products import mesh, model, model_files
from perception.products.model import ModelSettings
from perception.products.surface import Surface
from perception.reconstruct import depth_stage, free_space, fuse_stage, outliers
from perception.reconstruct.aligned_poses import alignment_numbers, read_poses
from perception.reconstruct.alignment import align
from perception.reconstruct.bundle import Accuracy
from perception.reconstruct.cloud import Cloud, read_cloud, write_cloud
from perception.reconstruct.control_points import ControlPoint
from perception.reconstruct.optics import Optics
from perception.reconstruct.pictures import SurveyPicture, picture_key, require_enough
from perception.reconstruct.pipeline import reconstruct, with_thin_members
from perception.reconstruct.settings import Settings
from perception.reconstruct.straighten import straightened
from perception.wires import stage as thin_stage

log = logging.getLogger(__name__)

Tell = Callable[[str, int, int], None]
MESH_SPACINGS = 2.0
"""Detail of the mesh, in spacings of the cloud."""


def reconstruct_run(run: RunFolder, keep_depth: bool = False, tell: Tell = lambda stage, done, total: None,
                    cloud_there: Callable[[], None] = lambda: None) -> dict[str, Any]:
    """Survey pictures to aligned poses, cloud.ply, mesh.ply and the textured model/.

    Products that are there from the same pictures, poses and settings are kept. Depth maps stay in depth/ until it is
    done, and after it on request. `cloud_there` is called once cloud.ply can be read. Returns counts and seconds.
    Raises UserError when there are too few pictures, one cannot be read, or the memory is too little.
    """
    work = Reconstruction(read_run(run), tell)
    with work.record.stage("align"):
        pictures = work.pictures
    spec = work.data.mission.reconstruct
    cloud = work.cloud
    cloud_there()
    result: dict[str, Any] = {"pictures": len(pictures), "points": len(cloud), "cloud": str(run.cloud)}
    if spec.mesh:
        result |= {"triangles": len(work.mesh), "mesh": str(run.mesh)}
    if spec.mesh and spec.texture and len(work.mesh):
        work.write_model()
        result |= {"model": str(run.model)}
    if not keep_depth:
        shutil.rmtree(run.root / "depth", ignore_errors=True)
    return {**result, **work.record.write(run)}


@dataclass
class Reconstruction:
    """A run's products; each is made, or read, when it is asked for."""

    data: RunData
    tell: Tell
    record: StageRecord = field(default_factory=lambda: StageRecord("reconstruct"))

    @property
    def run(self) -> RunFolder:
        """Where everything is."""
        return self.data.run

    @cached_property
    def pictures(self) -> list[SurveyPicture]:
        """The survey's pictures without distortion, with aligned poses where the mission asks for them and there is
        something to find."""
        pictures, mission = self.data.survey_pictures(), self.data.mission
        require_enough(pictures)
        accuracy, spec, lens = Accuracy.of(mission.camera), mission.reconstruct, mission.camera.distortion
        if (mission.camera.exact_poses and not spec.calibrate) or not spec.align:
            shutil.rmtree(self.run.alignment, ignore_errors=True)
            return straightened(pictures, Optics(pictures[0].camera, lens), self.run.straightened, self.tell)
        alignment = align(pictures, accuracy, mission.survey.distance_m, self.run.alignment, self.settings.threads,
                          self.tell, lens, spec.calibrate, self._control(pictures),
                          self.data.exploration_pictures())
        log.info("%d of %d pictures aligned, reprojection error %s px", alignment.numbers["registered"], len(pictures),
                 alignment.numbers["reprojection_px"])
        return straightened(alignment.pictures, alignment.optics, self.run.straightened, self.tell)

    def _control(self, pictures: list[SurveyPicture]) -> list[ControlPoint]:
        """Ground control and check points, where the run has some."""
        if not self.run.control_points.is_file():
            return []
        number_of = {p.path.name: i for i, p in enumerate(pictures)}
        return [p.placed(self.data.mission.site.anchor, number_of) for p in read_control(self.run.control_points)]

    @cached_property
    def cloud(self) -> Cloud:
        """Read when it was made from the same, else made and written."""
        key = self._cloud_key
        if self._made_from("cloud", key, self.run.cloud):
            return read_cloud(self.run.cloud)
        with self.record.stage("cloud"):
            cloud = reconstruct(self.pictures, self.data.region(), self.settings, self.run.root / "depth", self.tell)
            if self.data.mission.reconstruct.thin_members:
                cloud = with_thin_members(cloud, self._trusted, self.data.region(), self.settings, self.tell)
            log.info("%d pictures gave %d points", len(self.pictures), len(cloud))
            if not len(cloud):
                raise UserError(f"{self.run.views_csv}: fewer than {self.settings.min_confidence} depth maps agree on "
                                "any point; lower reconstruct.min_confidence in mission.toml and run it again, or fly "
                                "more views.")
            write_cloud(cloud, self.run.cloud)
        self._remember("cloud", key)
        return cloud

    @property
    def _trusted(self) -> list[SurveyPicture]:
        """Pictures that were aligned with most others; all where nothing had to be aligned."""
        if alignment_numbers(self.run.alignment) is None:
            return self.pictures
        together = {p.view_id for p in read_poses(self.run.alignment) if p.trusted}
        return [p for p in self.pictures if p.view_id in together]

    @cached_property
    def mesh(self) -> Surface:
        """Likewise, through the cloud."""
        key = f"{self._cloud_key} {mesh.METHOD} {MESH_SPACINGS}"
        if self._made_from("mesh", key, self.run.mesh):
            return mesh.read_mesh(self.run.mesh)
        with self.record.stage("mesh"):
            self.tell("mesh", 0, 1)
            made = mesh.poisson_mesh(self.cloud, self._mesh_spacing_m)
            mesh.write_mesh(made, self.run.mesh)
            self.tell("mesh", 1, 1)
        self._remember("mesh", key)
        return made

    def write_model(self) -> None:
        """The textured model, where it was not made from the same."""
        spec = self.data.mission.reconstruct
        asked = ModelSettings(triangles=spec.model_triangles, texture_px=spec.texture_px,
                              spacing_m=self._mesh_spacing_m, threads=self.settings.threads)
        key = f"{self._cloud_key} {mesh.METHOD} {model.METHOD} {asked.triangles} {asked.texture_px} {asked.spacing_m}"
        folder = self.run.model
        if self._made_from("model", key, folder / model_files.OBJ, folder / model_files.GLB):
            return
        with self.record.stage("model"):
            made, cut = model.textured_model(self.mesh, self.pictures, asked, self.tell)
            log.info("%d triangles in %d pieces at %.2f of the pictures' resolution, %.3f of them in no picture",
                     len(made.surface), cut.pieces, cut.scale, cut.unseen)
            model_files.write_model(made, folder)
        self._remember("model", key)

    @property
    def settings(self) -> Settings:
        """Reconstruction settings of the run's mission."""
        spec = self.data.mission.reconstruct
        return Settings(depth_width_px=min(spec.depth_width_px, self.data.mission.camera.survey_px[0]),
                        pairs_per_picture=spec.pairs_per_picture, min_confidence=spec.min_confidence,
                        spacing_m=spec.cloud_spacing_m, distance_m=self.data.mission.survey.distance_m,
                        memory_gib=spec.memory_gib, near_m=spec.near_m, far_m=spec.far_m)

    @property
    def _mesh_spacing_m(self) -> float:
        return MESH_SPACINGS * self.settings.spacing_m

    @cached_property
    def _cloud_key(self) -> str:
        """Hash of all that the cloud depends on."""
        settings = msgspec.structs.replace(self.settings, threads=0, memory_gib=0.0)
        region = self.data.region()
        about = [depth_stage.METHOD, fuse_stage.METHOD, free_space.METHOD, outliers.METHOD,
                 msgspec.json.encode(settings).decode(),
                 picture_key(self.pictures), region.lower_enu_m.tolist(), region.upper_enu_m.tolist()]
        if self.data.mission.reconstruct.thin_members:
            about.append(f"thin members {thin_stage.METHOD}")
        return hashlib.sha256(json.dumps(about).encode()).hexdigest()[:16]

    def _made_from(self, product: str, key: str, *files: Path) -> bool:
        return self._known().get(product) == key and all(path.is_file() for path in files)

    def _remember(self, product: str, key: str) -> None:
        self.run.products.write_text(json.dumps({**self._known(), product: key}, indent=1), encoding="utf-8")

    def _known(self) -> dict[str, str]:
        try:
            return dict(json.loads(self.run.products.read_text(encoding="utf-8")))
        except (OSError, ValueError):
            return {}
