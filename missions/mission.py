"""What a mission is: one typed tree. Every field has its unit in its name; `mission_file` reads and writes it."""

from __future__ import annotations

import hashlib
from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from missions.camera import Camera
from missions.frames import Site

Positive = Annotated[float, Meta(gt=0)]
NonNegative = Annotated[float, Meta(ge=0)]
Percent = Annotated[float, Meta(ge=0, le=100)]
Point = tuple[float, float, float]


class _Section(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    pass


class SceneSpec(_Section, frozen=True, kw_only=True):
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


class SiteSpec(_Section, frozen=True, kw_only=True):
    """Where the world's ENU origin lies, and what the operator knows of the object: its box."""

    origin_lat_deg: Annotated[float, Meta(ge=-89, le=89)] = 52.2205
    origin_lon_deg: Annotated[float, Meta(ge=-180, le=180)] = 6.8861
    origin_alt_m: float = 40.0
    object_min_enu_m: Point | None = None
    """Lower corner of the object's bounding box; taken from the scene's bounds when left out."""
    object_max_enu_m: Point | None = None
    ground_up_m: float | None = None
    camera_margin_m: Positive = 9.0
    """Cameras may stand up to this far outside the object's box, sideways and above."""
    camera_floor_m: Positive = 2.0
    """Lowest height above ground at which a picture may be taken."""
    geofence_margin_m: Positive = 12.0
    """The geofence reaches this far beyond the camera bounds (take-off points lie inside it)."""

    @property
    def anchor(self) -> Site:
        """The ENU frame's place on Earth."""
        return Site(self.origin_lat_deg, self.origin_lon_deg, self.origin_alt_m)


class FleetSpec(_Section, frozen=True, kw_only=True):
    """The vehicles: how many, how large, how fast."""

    vehicles: Annotated[int, Meta(ge=1, le=32)] = 2
    takeoff_enu_m: list[Point] = []
    """One point per vehicle; when empty, in a row beside the object, outside its box."""
    radius_m: Positive = 0.3
    clearance_m: Positive = 1.0
    """Least distance between the vehicle's centre and anything it knows to be solid."""
    separation_m: Positive = 2.5
    """Least distance between the centres of two vehicles."""
    speed_m_s: Positive = 3.0
    acceleration_m_s2: Positive = 2.0
    jerk_m_s3: Positive = 6.0
    yaw_rate_deg_s: Positive = 60.0
    range_sensor_m: Positive = 8.0
    """Reach of the simulated obstacle sensor. It keeps ways clear, on board and on the ground; no map is made of it."""


class BatterySpec(_Section, frozen=True, kw_only=True):
    """What flying takes out of a battery, and what must stay in it."""

    model: Literal["power", "distance"] = "power"
    """The multirotor power model over the flown trajectory, or Algorithm 1 of the thesis: percent per metre."""
    percent_per_m: NonNegative = 0.055
    """For "distance". A small camera drone (34 min rated flight, DJI Mini 4 Pro) at 1 m/s mean inspection speed with
    10 % lost to wind and stops flies about 1.8 km: 100 % / 1836 m."""
    reserve_percent: Percent = 5.0
    """What must be left after the last landing."""
    swaps: Annotated[int, Meta(ge=0)] = 0
    """Fresh batteries per vehicle at its pad: as many further sorties."""
    swap_s: NonNegative = 120.0
    start_percent: list[Percent] = []
    """Charge of the first vehicles at the start; those beyond the list start full."""
    threshold_percent: Percent = 20.0
    """At this level a vehicle returns and its remaining views go to the others (thesis section 4.4.6)."""

    def start_of(self, vehicle_id: int) -> float:
        """Charge of a vehicle (counted from 1) at the start, percent."""
        return self.start_percent[vehicle_id - 1] if vehicle_id <= len(self.start_percent) else 100.0


class AirframeSpec(_Section, frozen=True, kw_only=True):
    """Published figures of the multirotor; the power model is fitted to them. Defaults: DJI Mini 4 Pro with its
    standard battery (the manufacturer's specification page: still air, sea level, battery flown empty)."""

    mass_kg: Positive = 0.249
    battery_wh: Positive = 18.96
    rotors: Annotated[int, Meta(ge=3)] = 4
    rotor_diameter_m: Positive = 0.1524
    hover_min: Positive = 30.0
    """How long a full battery hovers."""
    endurance_min: Positive = 34.0
    """The longest flight, at endurance_m_s."""
    endurance_m_s: Positive = 6.0
    range_km: Positive = 18.0
    """The farthest flight, at range_m_s."""
    range_m_s: Positive = 11.306
    base_load_w: NonNegative = 6.0
    """Camera, gimbal, computer and radio. Not published: an assumption, which the fit takes off the rotors' share."""
    payload_kg: NonNegative = 0.0
    """Carried beside what the published figures were measured with."""


class WindSpec(_Section, frozen=True, kw_only=True):
    """The steady wind that flights are reckoned with. It costs energy; simulated vehicles hold their course in it."""

    velocity_enu_m_s: Point = (0.0, 0.0, 0.0)
    """Where the air moves to."""


class CameraSpec(_Section, frozen=True, kw_only=True):
    """Optics shared by exploration and survey. The thesis's 9.6 x 7.2 mm sensor with f = 20 mm would see 27 deg; the
    84 deg of its text (and of the DJI Mini 4 Pro) is the default."""

    diagonal_fov_deg: Annotated[float, Meta(gt=10, lt=150)] = 84.0
    focal_px: Positive | None = None
    """Focal length at survey resolution; replaces diagonal_fov_deg when given."""
    principal_point_px: tuple[float, float] | None = None
    explore_px: tuple[int, int] = (456, 256)
    survey_px: tuple[int, int] = (1920, 1080)
    exposure_s: Positive = 0.001
    max_blur_px: Positive = 0.5
    """Motion blur of a survey picture that is taken in passing, at most: speed at the shutter is limited so."""
    jpeg_quality: Annotated[int, Meta(ge=50, le=100)] = 95
    noise_dn: NonNegative = 1.0
    """Standard deviation of simulated sensor noise, in 8-bit steps."""
    position_sigma_m: NonNegative = 0.0
    """How exactly the position of a survey picture is measured: standard deviation per axis (RTK GNSS: about 0.02).
    Simulated pictures carry poses that are off by it, and alignment trusts measured poses by it; 0 is exact."""
    attitude_sigma_deg: NonNegative = 0.0
    """The same for yaw, elevation and roll of the camera (a stabilised gimbal: about 0.3)."""

    def survey_camera(self) -> Camera:
        """Intrinsics of a survey picture."""
        w, h = self.survey_px
        camera = Camera.from_diagonal_fov(w, h, self.diagonal_fov_deg)
        f = self.focal_px if self.focal_px is not None else camera.fx_px
        cx, cy = self.principal_point_px or (camera.cx_px, camera.cy_px)
        return Camera(w, h, f, f, cx, cy)

    def explore_camera(self) -> Camera:
        """Intrinsics of an exploration picture: the same diagonal field of view, fewer pixels."""
        if self.focal_px is None and self.principal_point_px is None:
            return Camera.from_diagonal_fov(*self.explore_px, self.diagonal_fov_deg)
        return self.survey_camera().scaled(*self.explore_px)


class ExploreSpec(_Section, frozen=True, kw_only=True):
    """Next-best-view exploration."""

    enabled: bool = True
    max_views: Annotated[int, Meta(ge=0)] = 120
    """Decisions (key views) over all vehicles."""
    frames_per_leg: Annotated[int, Meta(ge=1, le=20)] = 4
    """Pictures per leg, the key view included (MACARONS takes 4)."""
    lattice_step_m: Positive = 4.0
    elevations_deg: tuple[float, ...] = (-60.0, -30.0, 0.0, 30.0, 60.0)
    azimuths: Annotated[int, Meta(ge=4, le=36)] = 10
    voxel_m: Positive = 0.5
    sensing_range_m: Positive = 25.0
    """Depth beyond this is not used for mapping; also the range within which the referee counts a point as seen."""
    adapt: bool = False
    """The network that imagines what is not seen yet learns in flight from what the map has come to know."""
    price_m2_per_m: NonNegative | None = None
    """Exploration ends when a metre of flight is expected to show less new surface than this; 0 flies on as long as any
    view promises something. Left out: when 3 % of the surface that can be seen is believed missing at most and a metre
    shows less than 10 % of what it has shown on average."""


class SurveySpec(_Section, frozen=True, kw_only=True):
    """The thesis's exploit phase: full-resolution pictures for photogrammetry."""

    enabled: bool = True
    views: Literal["map", "exploration", "frames", "file"] = "map"
    """Where the survey's views come from: planned on the explored map, the exploration's key views, all of its pictures
    as in the thesis, or a file."""
    views_path: str = ""
    max_views: Annotated[int, Meta(ge=1)] = 160
    refine: Annotated[int, Meta(ge=0)] = 0
    """Views of a second, short flight to what too few pictures show, by the map that the survey's own pictures have
    completed; as many of them as energy allows."""
    distance_m: Positive = 8.0
    """Distance to the surface: views stand 0.35 to 1.7 times as far."""
    pictures_per_patch: Annotated[int, Meta(ge=1)] = 3
    """Pictures that every place should be in; two more count a little."""
    gsd_m: Positive = 0.01
    """Ground sampling distance that is asked for: a picture that shows a place coarser counts as much less. The camera
    moves at most this far over the surface in an exposure."""
    method: Literal["swarmscan", "thesis"] = "swarmscan"
    """Who flies which views in which order: shortest time until the last vehicle is done over flown legs, or the
    thesis's Ward clusters, networkx tours and reassignment."""
    cost: Literal["distance", "distance_elevation"] = "distance"
    """Cost of a leg for "thesis": 3-D length, or alpha * horizontal + beta * vertical (thesis Eq. 4.4)."""
    alpha: NonNegative = 1.0
    beta: NonNegative = 0.5
    stop_at_views: bool = False
    """Come to rest for every picture instead of taking it in passing."""
    pass_m: NonNegative = 0.25
    """How far beside a view the vehicle may pass, so that it need not stop at corners."""
    settle_s: NonNegative = 0.5
    """Rest before a picture where the vehicle stops for it."""


class ReconstructSpec(_Section, frozen=True, kw_only=True):
    """From survey pictures to cloud and mesh."""

    enabled: bool = True
    align: bool = True
    """Bundle adjustment of the measured poses before anything is made of them. Without noise there is nothing to do."""
    depth_width_px: Annotated[int, Meta(ge=160)] = 960
    pairs_per_picture: Annotated[int, Meta(ge=1)] = 4
    min_confidence: Annotated[int, Meta(ge=1)] = 3
    """Agreeing depth maps that a point needs (the thesis drops confidence 0-2)."""
    cloud_spacing_m: Positive = 0.03
    mesh: bool = True


class RenderSpec(_Section, frozen=True, kw_only=True):
    """Sun and sky of the simulated pictures."""

    sun_azimuth_deg: float = 215.0
    """Clockwise from North."""
    sun_elevation_deg: Annotated[float, Meta(gt=0, le=90)] = 48.0
    backend: Literal["auto", "egl", "raycast"] = "auto"


class ClockSpec(_Section, frozen=True, kw_only=True):
    """Simulated time."""

    tick_s: Annotated[float, Meta(ge=0.01, le=1.0)] = 0.1
    link_latency_s: Annotated[float, Meta(ge=0.01, le=1.0)] = 0.01
    speed: NonNegative = 0.0
    """Simulated seconds per wall second; 0 is as fast as the machine goes."""
    max_s: Positive = 7200.0
    epoch_utc: str = "2026-06-01T10:00:00Z"
    """Simulated time zero, for EXIF."""


class ObstacleSpec(_Section, frozen=True, kw_only=True):
    """A box that appears in the true world in flight (fault injection; known to sim_bridge alone)."""

    center_enu_m: Point
    size_m: Point
    appears_at_s: NonNegative = 0.0
    disappears_at_s: Positive = 1e9


class Mission(_Section, frozen=True, kw_only=True):
    """A whole mission."""

    title: str
    description: str = ""
    seed: int = 1
    knowledge: Literal["none", "mesh"] = "none"
    """What is known of the structure before the flight: its box alone, or a prior model, as in the thesis's exploit
    phase. Ground station and vehicles then plan on the model."""
    prior_path: str = ""
    """For knowledge = "mesh": a GLB, OBJ, PLY or STL file in ENU metres; empty: the true scene's mesh."""
    scene: SceneSpec = SceneSpec()
    site: SiteSpec = SiteSpec()
    fleet: FleetSpec = FleetSpec()
    battery: BatterySpec = BatterySpec()
    airframe: AirframeSpec = AirframeSpec()
    wind: WindSpec = WindSpec()
    camera: CameraSpec = CameraSpec()
    explore: ExploreSpec = ExploreSpec()
    survey: SurveySpec = SurveySpec()
    reconstruct: ReconstructSpec = ReconstructSpec()
    render: RenderSpec = RenderSpec()
    clock: ClockSpec = ClockSpec()
    obstacles: list[ObstacleSpec] = []

    @property
    def mission_hash(self) -> str:
        """SHA-256 over the canonical content, first 16 hex digits."""
        return hashlib.sha256(msgspec.json.encode(self)).hexdigest()[:16]


def without_scene(mission: Mission) -> Mission:
    """The mission as the ground station and the vehicles get it: nothing of the true world in it."""
    return msgspec.structs.replace(mission, scene=SceneSpec(name="", path=""), obstacles=[])
