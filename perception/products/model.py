"""From a mesh and pictures to a textured model."""

from __future__ import annotations

import msgspec

from perception.products.atlas import Cut, Textured, textured
from perception.products.best_pictures import best_pictures, candidates
from perception.products.mesh import simplified, standing
from perception.products.surface import Surface
from perception.reconstruct.pictures import SurveyPicture
from perception.reconstruct.resources import single_threaded_libraries
from perception.reconstruct.settings import Progress

METHOD = 1
"""Raised whenever the model changes for the same mesh and pictures."""


class ModelSettings(msgspec.Struct, frozen=True, kw_only=True):
    """How fine a model is to be."""

    triangles: int = 400_000
    texture_px: int = 8192
    """Largest side of the texture."""
    spacing_m: float = 0.06
    """Of the mesh."""
    threads: int = 3


def textured_model(mesh: Surface, pictures: list[SurveyPicture], settings: ModelSettings,
                   progress: Progress = lambda stage, done, total: None) -> tuple[Textured, Cut]:
    """The mesh, simplified, without what pictures show to be sky, with a texture made of the pictures."""
    surface = simplified(mesh, settings.triangles)
    total = len(pictures)
    with single_threaded_libraries():
        found = candidates(surface, pictures, settings.threads, lambda done: progress("look", done, total))
        keep = found.solid.copy()
        keep[keep] = standing(surface.select(keep), settings.spacing_m)
        if keep.any():
            surface, found = surface.select(keep), found.select(keep)
        chosen = best_pictures(surface, found)
        return textured(surface, pictures, chosen, settings.texture_px, settings.threads,
                        lambda done: progress("texture", done, total))
