"""Parameters of a family: a frozen dataclass whose fields say what they are drawn from."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field, fields
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from sim_bridge.scenes.families.body import Body
from sim_bridge.scenes.scene import Part

Array = NDArray[np.float64]

DRAW = "draw"


@dataclass(frozen=True)
class Family(ABC):
    """A kind of structure; the fields of the dataclass are its parameters."""

    @abstractmethod
    def build(self, rng: np.random.Generator) -> Body:
        """The structure, along x, standing on z = 0. rng gives what is irregular within one structure."""

    def surroundings(self, rng: np.random.Generator, lo: Array, hi: Array) -> list[Part]:
        """The ground and what stands on it, where a family brings its own; lo, hi: (3,) the structure's box."""
        return []

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> Self:
        """One member of the family with parameters drawn in the order of the fields."""
        return cls(**{f.name: f.metadata[DRAW](rng) for f in fields(cls)})


def between(low: float, high: float) -> Any:
    """A field drawn uniformly between two numbers, to the centimetre or percent."""
    return _drawn_by(lambda rng: round(float(rng.uniform(low, high)), 2))


def whole(low: int, high: int) -> Any:
    """A field drawn from the whole numbers low to high, both included."""
    return _drawn_by(lambda rng: int(rng.integers(low, high + 1)))


def one_of(*choices: Any) -> Any:
    """A field drawn from a few values, all equally likely."""
    return _drawn_by(lambda rng: choices[int(rng.integers(len(choices)))])


def _drawn_by(draw: Callable[[np.random.Generator], Any]) -> Any:
    return field(metadata={DRAW: draw})
