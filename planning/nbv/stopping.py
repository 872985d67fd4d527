"""When exploring on no longer pays: what the best way ahead is expected to show per metre of flight, against a price.

Expectations are corrected by what the last views brought against what they had promised.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

RECENT = 12
"""Views whose promises are held against what they brought."""
LEAST_LEG_M = 2.0
"""A view costs at least the time of flying this far, even where the vehicle only turns."""
LEAST_TRUST, MOST_TRUST = 0.25, 4.0


@dataclass(frozen=True)
class Price:
    """What a metre of flight must bring."""

    m2_per_m: float | None = None
    """New surface; None: `share` of what a metre has brought on average so far, once no more than `missing` is left."""
    share: float = 0.1
    missing: float = 0.08
    """Promises are worth little while much is hidden behind legs that are not known yet."""


@dataclass
class Returns:
    """What views have promised and brought. Tell it of every view that is given out, and at every decision of the area
    seen by then."""

    seen_m2: float = 0.0
    flown_m: float = 0.0
    _promised_m2: float = 0.0
    """Since the area was told last."""
    _recent: deque[tuple[float, float]] = field(default_factory=lambda: deque(maxlen=RECENT))

    def promise(self, gain_m2: float, leg_m: float) -> None:
        """A view is given out that is expected to show so much new surface after a leg of this length."""
        self._promised_m2 += gain_m2
        self.flown_m += max(leg_m, LEAST_LEG_M)

    def settle(self, seen_m2: float) -> None:
        """By now this area was seen."""
        if self._promised_m2 > 0.0:
            self._recent.append((self._promised_m2, seen_m2 - self.seen_m2))
        self.seen_m2, self._promised_m2 = seen_m2, 0.0

    @property
    def trust(self) -> float:
        """What the last views brought over what they had promised; 1 before any."""
        promised, shown = np.sum(self._recent, axis=0) if self._recent else (0.0, 0.0)
        return float(np.clip(shown / promised, LEAST_TRUST, MOST_TRUST)) if promised > 0.0 else 1.0

    @property
    def mean_m2_per_m(self) -> float:
        """What a metre has brought on average."""
        return self.seen_m2 / self.flown_m if self.flown_m > 0.0 else 0.0

    def expected_m2_per_m(self, gains_m2: Sequence[float], legs_m: Sequence[float]) -> float:
        """What a metre of a way of several views (k,) should bring, up to whichever view is best to end with."""
        flown = np.cumsum(np.maximum(legs_m, LEAST_LEG_M))
        return self.trust * float((np.cumsum(gains_m2) / flown).max(initial=0.0))


def pays(expected_m2_per_m: float, returns: Returns, coverage: float, price: Price) -> bool:
    """Whether a way is worth its flight. coverage: the estimated share of the visible surface seen so far, 0 to 1."""
    if price.m2_per_m is not None:
        return expected_m2_per_m >= price.m2_per_m
    return coverage < 1.0 - price.missing or expected_m2_per_m >= price.share * returns.mean_m2_per_m
