"""What a mission says of the simulated world: the true scene, its light, its clock, and what goes wrong in it."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta

from missions.mission_section import NonNegative, Point, Positive, Section


class SceneSpec(Section, frozen=True, kw_only=True):
    """The true world. Only sim_bridge reads this section; the planners never see the scene."""

    name: str = "bridge"
    """A built-in structure (bridge, building, statue, powerline) or a member of a procedural family
    (family:NAME:SEED, see missions/scene_names.py); ignored when path is given."""
    path: str = ""
    """A GLB/OBJ/PLY/STL file, or a folder laid out as in the thesis's Figure 4.2; relative to the working directory."""
    seed: int = 1
    """Of the textures and surroundings of a built-in structure; a family's scene has its seed in its name."""
    units_per_metre: Positive = 1.0
    """How many units of the file make a metre (1000 for a model in millimetres)."""
    up: Literal["y", "z"] = "z"
    """The file's axis that points up. With "y", (x, y, z) becomes (x, -z, y), as in Blender."""
    surroundings: bool = True


class RenderSpec(Section, frozen=True, kw_only=True):
    """Sun and sky of the simulated pictures."""

    sun_azimuth_deg: float = 215.0
    """Clockwise from North."""
    sun_elevation_deg: Annotated[float, Meta(gt=0, le=90)] = 48.0
    backend: Literal["auto", "egl", "raycast"] = "auto"


class ClockSpec(Section, frozen=True, kw_only=True):
    """Simulated time."""

    tick_s: Annotated[float, Meta(ge=0.01, le=1.0)] = 0.1
    link_latency_s: Annotated[float, Meta(ge=0.01, le=1.0)] = 0.01
    speed: NonNegative = 0.0
    """Simulated seconds per wall second; 0 is as fast as the machine goes."""
    max_s: Positive = 7200.0
    world_wait_s: NonNegative = 120.0
    """Wall seconds for which the others hold, their time standing still, when sim_bridge has died; then they end."""
    epoch_utc: str = "2026-06-01T10:00:00Z"
    """Simulated time zero, for EXIF."""


class ObstacleSpec(Section, frozen=True, kw_only=True):
    """A box that appears in the true world in flight (fault injection; known to sim_bridge alone)."""

    center_enu_m: Point
    size_m: Point
    appears_at_s: NonNegative = 0.0
    disappears_at_s: Positive = 1e9


class FaultSpec(Section, frozen=True, kw_only=True):
    """A fault that a built-in vehicle simulates, to show what its failsafe does. The vehicle that it names reads it and
    says so in its texts ("simulated fault: ..."); ground station and planners never do."""

    vehicle: Annotated[int, Meta(ge=1)]
    kind: Literal["position_lost", "range_blind", "battery_sag", "battery_silent", "clock_jump", "ground_link_lost"]
    at_s: NonNegative
    until_s: Positive = 1e9
    amount: NonNegative = 0.0
    """battery_sag: percent that the battery seems to have lost; clock_jump: seconds."""
