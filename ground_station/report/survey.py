"""The page's part on the survey: the surface of the map by the number of pictures that show it."""

from __future__ import annotations

import math

import msgspec
import numpy as np

from ground_station.report.renderings import SIDES, WIDTH_PX
from ground_station.report.run_data import RunData
from ground_station.report.sections import row, section
from ground_station.report.splat import Pixels, splat
from ground_station.report.tiles import percent
from missions.messages import SiteBrief
from missions.pads import surface_box
from planning.nbv.survey import SurveyPlan, SurveyViewSpec, plan_survey

COLOURS = ((178, 24, 43), (244, 165, 80), (255, 224, 120), (120, 198, 121), (60, 160, 110), (0, 104, 90))
"""By pictures, none first; the last stands for as many and more."""


def survey_part(data: RunData) -> str:
    """The section; nothing without a map or without survey pictures."""
    found = shown(data)
    if found is None:
        return ""
    keys = "".join(f"<span class=key style='background:rgb{colour}'></span>{n}{' or more' * (n == len(COLOURS) - 1)}"
                   for n, colour in enumerate(COLOURS))
    wanted = data.mission.survey.pictures_per_patch
    in_one, in_enough = (float(np.average(found.pictures >= n, weights=found.patches.voxels)) for n in (1, wanted))
    lead = (f"The explored surface by the number of survey pictures that show it well, by the map; {wanted} are asked "
            f"for. {percent(in_one)} of it is in one or more, {percent(in_enough)} in {wanted} or more.")
    return section("What the survey shows", lead, f"<small>Pictures:{keys}</small>" + row(by_pictures(found)))


def shown(data: RunData) -> SurveyPlan | None:
    """The surface that the survey was planned on, and how many of the pictures show it."""
    views = [v for v in data.views if v.phase == "survey"]
    if not views or not data.run.map.is_file() or "site" not in data.flight:
        return None
    box = surface_box(data.mission, msgspec.convert(data.flight["site"], SiteBrief))
    found = plan_survey(data.grid(), np.zeros((0, 3)), data.mission.camera.survey_camera(), *box,
                        SurveyViewSpec.of(data.mission.survey), [v.pose for v in views])
    return found if len(found.patches) else None


def by_pictures(found: SurveyPlan) -> list[tuple[str, Pixels]]:
    """The patches from every side, coloured by the number of pictures that show them."""
    colours = np.array(COLOURS, dtype=np.uint8)[np.minimum(found.pictures, len(COLOURS) - 1)]
    points = found.patches.position_enu_m.astype(np.float32)
    size_m = SurveyViewSpec().patch_m
    return [(s.name, splat(points, colours, math.radians(s.yaw_deg), math.radians(s.elevation_deg), WIDTH_PX, size_m))
            for s in SIDES]
