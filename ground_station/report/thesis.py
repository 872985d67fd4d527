"""What the thesis reports for its scenes, to stand beside ours (its sections 5.1 to 5.5, Table 5.1)."""

from __future__ import annotations

from dataclasses import dataclass


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
