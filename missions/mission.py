"""What a mission is: one typed tree. Every field has its unit in its name; `mission_file` reads and writes it."""

from __future__ import annotations

import hashlib
from typing import Annotated, Literal

import msgspec
from msgspec import Meta, field

from missions.camera import Camera
from missions.frames import Site
from missions.lens import NONE, Distortion
from missions.mission_section import NonNegative, Percent, Point, Positive, Section
from missions.simulation import ClockSpec, FaultSpec, ObstacleSpec, RenderSpec, SceneSpec


class SiteSpec(Section, frozen=True, kw_only=True):
    """Where the world's ENU origin lies, and what the operator knows of the object: its box."""

    origin_lat_deg: Annotated[float, Meta(ge=-89, le=89)] = 52.2205
    origin_lon_deg: Annotated[float, Meta(ge=-180, le=180)] = 6.8861
    origin_alt_m: float = 40.0
    """Of the ENU origin above the WGS 84 ellipsoid (latitude, longitude and this are EPSG:4979), not above the sea."""
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
    geofence_room_m: NonNegative = 0.0
    """So far, sideways and upwards, an operator may move the geofence out in flight. Maps reach so far; without a prior
    model only."""

    @property
    def anchor(self) -> Site:
        """The ENU frame's place on Earth."""
        return Site(self.origin_lat_deg, self.origin_lon_deg, self.origin_alt_m)


class FleetSpec(Section, frozen=True, kw_only=True):
    """The vehicles: how many, how large, how fast."""

    vehicles: Annotated[int, Meta(ge=1, le=64)] = 2
    reserve: Annotated[int, Meta(ge=0)] = 0
    """So many of the vehicles, the last ones, stay on their pads and take no part until an operator adds them."""
    takeoff_enu_m: list[Point] = field(default_factory=list)
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
    lost_after_s: NonNegative = 20.0
    """A vehicle that has vanished keeps its views for so long; then the others get them. It may come back later too."""
    restarts: Annotated[int, Meta(ge=0)] = 3
    """How often `swarmscan fly` starts sim_bridge or a vehicle's process again that was killed; never a real
    autopilot's."""
    range_sensor_m: Positive = 8.0
    """Reach of the simulated obstacle sensor. It keeps ways clear, on board and on the ground; no map is made of it."""


class BatterySpec(Section, frozen=True, kw_only=True):
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
    start_percent: list[Percent] = field(default_factory=list)
    """Charge of the first vehicles at the start; those beyond the list start full."""
    threshold_percent: Percent = 20.0
    """At this level a vehicle returns and its remaining views go to the others (thesis section 4.4.6)."""

    def start_of(self, vehicle_id: int) -> float:
        """Charge of a vehicle (counted from 1) at the start, percent."""
        return self.start_percent[vehicle_id - 1] if vehicle_id <= len(self.start_percent) else 100.0


class AirframeSpec(Section, frozen=True, kw_only=True):
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


class WindSpec(Section, frozen=True, kw_only=True):
    """The steady wind that flights are reckoned with. It costs energy; simulated vehicles hold their course in it."""

    velocity_enu_m_s: Point = (0.0, 0.0, 0.0)
    """Where the air moves to."""


class CameraSpec(Section, frozen=True, kw_only=True):
    """Optics shared by exploration and survey. The thesis's 9.6 x 7.2 mm sensor with f = 20 mm would see 27 deg; the
    84 deg of its text (and of the DJI Mini 4 Pro) is the default."""

    diagonal_fov_deg: Annotated[float, Meta(gt=10, lt=150)] = 84.0
    focal_px: Positive | None = None
    """Focal length at survey resolution; replaces diagonal_fov_deg when given."""
    principal_point_px: tuple[float, float] | None = None
    distortion: Distortion = NONE
    """k1, k2, p1, p2 of the lens (see missions/lens.py). Simulated pictures have it, and whoever measures in a picture
    takes it out."""
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

    @property
    def exact_poses(self) -> bool:
        """Whether survey pictures carry the poses that they were taken from."""
        return self.position_sigma_m == 0.0 and self.attitude_sigma_deg == 0.0

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


class ExploreSpec(Section, frozen=True, kw_only=True):
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
    view promises something. Left out: when a metre shows less than 10 % of what it has shown on average and 8 % of the
    surface that can be seen is believed missing at most."""


class SurveySpec(Section, frozen=True, kw_only=True):
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


class ReconstructSpec(Section, frozen=True, kw_only=True):
    """From survey pictures to cloud and mesh."""

    enabled: bool = True
    align: bool = True
    """Bundle adjustment of the measured poses before anything is made of them. Without noise there is nothing to do."""
    calibrate: bool = False
    """The alignment finds focal length and distortion of the camera by itself; what the mission says is where it
    begins."""
    depth_width_px: Annotated[int, Meta(ge=160)] = 960
    pairs_per_picture: Annotated[int, Meta(ge=1)] = 4
    min_confidence: Annotated[int, Meta(ge=1)] = 3
    """Agreeing depth maps that a point needs (the thesis drops confidence 0-2)."""
    cloud_spacing_m: Positive = 0.03
    thin_members: bool = False
    """Look for wires, cables and bars that stereo does not resolve as lines that several pictures show, and drop what
    has open sky in its place. Twice the time that the cloud takes otherwise."""
    mesh: bool = True
    texture: bool = True
    """Make a textured model of the mesh, of at most model_triangles, with a square texture of at most texture_px."""
    model_triangles: Annotated[int, Meta(ge=1000)] = 400_000
    texture_px: Annotated[int, Meta(ge=512, le=16384)] = 8192
    memory_gib: Positive = 4.0
    """What depth maps and fusion may take; fewer threads work and more is read again where that is little."""
    near_m: Positive = 2.0
    """Surface is looked for from here on, measured from the camera."""
    far_m: Positive = 60.0


class MavlinkSpec(Section, frozen=True, kw_only=True):
    """Doors for other ground stations (QGroundControl, MAVProxy, MAVSDK programs), opened by sim_bridge."""

    open: list[str] = field(default_factory=list)
    """Where all vehicles are behind one door: "udpin://127.0.0.1:14540" waits there, "udpout://127.0.0.1:14550" (or
    "udp://...") speaks first to whoever listens there. Nothing is opened when left out."""
    open_each: str = ""
    """The same for a door per vehicle: vehicle K's has a port number higher by K - 1."""
    identity: Literal["px4", "ardupilot"] = "px4"
    """Which autopilot the vehicles speak like at the doors."""
    signing_key: str = ""
    """A file with 64 hexadecimal digits and mode 0600: with it vehicles sign what they say at the doors (MAVLink 2) and
    hear only who signs with the same key."""

    @property
    def doors(self) -> bool:
        """Whether anybody may come in."""
        return bool(self.open or self.open_each)


class Mission(Section, frozen=True, kw_only=True):
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
    mavlink: MavlinkSpec = MavlinkSpec()
    obstacles: list[ObstacleSpec] = field(default_factory=list)
    faults: list[FaultSpec] = field(default_factory=list)
    """That built-in vehicles simulate (vehicle, kind, at_s, until_s, amount), see docs/failsafe.md."""

    @property
    def mission_hash(self) -> str:
        """SHA-256 over the canonical content, first 16 hex digits."""
        return hashlib.sha256(msgspec.json.encode(self)).hexdigest()[:16]


def without_scene(mission: Mission) -> Mission:
    """The mission as the ground station and the vehicles get it: nothing of the true world in it."""
    return msgspec.structs.replace(mission, scene=SceneSpec(name="", path=""), obstacles=[])
