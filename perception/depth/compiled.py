"""The one way loops are compiled here: numba without the interpreter lock, cached on disk, typed for the checker."""

from __future__ import annotations

from collections.abc import Callable
from typing import ParamSpec, TypeVar, cast

import numba

P = ParamSpec("P")
R = TypeVar("R")


def compiled(function: Callable[P, R]) -> Callable[P, R]:
    """Compiles a function of arrays and numbers at its first call."""
    return cast(Callable[P, R], numba.njit(function, cache=True, nogil=True))
