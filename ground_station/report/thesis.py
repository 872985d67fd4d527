"""What the thesis reports for its scenes, to stand beside ours (its sections 5.1 to 5.5, Table 5.1)."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(frozen=True)
class Reported:
    """Shares are 0-1, lengths metres; None where the thesis gives no number."""

    coverage: float | None
    c2c_025: float | None
    mean_m: float | None
    rms_m: float | None
    within_2cm: float | None


REPORTED = {
    "bridge": Reported(0.94, 0.8406, 0.013, 0.024, 0.9096),
    "building": Reported(0.77, 0.8031, 0.004, 0.005, 0.9983),
    "powerline": Reported(0.97, 0.8880, 0.001, 0.001, 1.0),
}
"""By built-in scene. The thesis used about 400 (bridge, building) and 600 (powerline) 4K pictures and Metashape."""

NOTHING = Reported(None, None, None, None, None)


@dataclass(frozen=True)
class ReportedStop:
    """Where UAV 0 met the threshold: waypoint index, level there, and how many points it left to UAV 1."""

    index: int
    level_percent: float
    left: int


@dataclass(frozen=True)
class ReportedPlan:
    """Section 5.3 for one scene."""

    points: int
    """Of the whole trajectory."""
    points_per_uav: tuple[int, ...] = ()
    """Where the text gives them."""
    percent_per_m: float = 1.0
    figures: dict[str, str] = field(default_factory=dict)
    """Battery figure by cost."""
    tours_figure: str = ""
    stops: dict[str, ReportedStop] = field(default_factory=dict)
    """By cost; a cost that was flown without a stop is in `figures` alone."""


PLANS = {
    "bridge": ReportedPlan(405, figures={"distance": "5.10 top", "distance_elevation": "5.10 bottom"},
                           tours_figure="5.11", stops={"distance": ReportedStop(210, 19.88, 9),
                                                       "distance_elevation": ReportedStop(208, 19.86, 12)}),
    "building": ReportedPlan(405, figures={"distance_elevation": "5.12"}, tours_figure="5.13"),
    "powerline": ReportedPlan(603, (401, 194), 0.85, figures={"distance": "5.14"}, tours_figure="5.15",
                              stops={"distance": ReportedStop(300, 19.65, 109)}),
}
"""By built-in scene. 405 is the length of a MACARONS trajectory; the text counts only the power line's points."""
