"""How good probabilities are: Brier score, log loss, reliability."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from missions.frames import Array

BINS = 10
LEAST_CHANCE = 1e-6


@dataclass
class Scores:
    """Sums over predictions."""

    brier_sum: float = 0.0
    log_loss_sum: float = 0.0
    count: Array = field(default_factory=lambda: np.zeros(BINS))
    """(BINS,) predictions between b / BINS and (b + 1) / BINS."""
    predicted_sum: Array = field(default_factory=lambda: np.zeros(BINS))
    true_sum: Array = field(default_factory=lambda: np.zeros(BINS))

    def add(self, chance: NDArray[np.float32], true: NDArray[np.bool_]) -> None:
        """Take in predictions (n,) and what turned out (n,)."""
        p = np.clip(chance.astype(np.float64), LEAST_CHANCE, 1.0 - LEAST_CHANCE)
        self.brier_sum += float(((p - true) ** 2).sum())
        self.log_loss_sum -= float(np.log(np.where(true, p, 1.0 - p)).sum())
        bins = np.minimum((p * BINS).astype(int), BINS - 1)
        self.count += np.bincount(bins, minlength=BINS)
        self.predicted_sum += np.bincount(bins, p, BINS)
        self.true_sum += np.bincount(bins, true, BINS)

    @property
    def total(self) -> float:
        """Number of predictions."""
        return float(self.count.sum())

    @property
    def base_rate(self) -> float:
        """Share of what came true."""
        return float(self.true_sum.sum()) / max(self.total, 1.0)

    @property
    def brier(self) -> float:
        """Mean squared error of the probabilities (Brier 1950)."""
        return self.brier_sum / max(self.total, 1.0)

    @property
    def log_loss(self) -> float:
        """Mean negative log likelihood, nats."""
        return self.log_loss_sum / max(self.total, 1.0)

    @property
    def calibration_error(self) -> float:
        """Mean distance, weighted by count, of predicted and true share in each bin."""
        return float(np.abs(self.predicted_sum - self.true_sum).sum()) / max(self.total, 1.0)

    @property
    def reliability(self) -> list[tuple[float, float, int]]:
        """(mean prediction, true share, count) of every bin that holds something."""
        return [(float(p / n), float(t / n), int(n))
                for p, t, n in zip(self.predicted_sum, self.true_sum, self.count, strict=True) if n]
