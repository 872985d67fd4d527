"""What set-up compiles: after it neither a mission nor a second warm-up compiles anything."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

pytestmark = pytest.mark.xdist_group("compile")

REPORT = """
import importlib, json, pkgutil, sys
from pathlib import Path
from numba.core.dispatcher import Dispatcher

room = importlib.import_module(sys.argv[1])
specs = [m.module_finder.find_spec(m.name) for m in pkgutil.walk_packages(room.__path__, room.__name__ + ".")]
marks = ("njit", "compiled", "def warm_up")
names = [s.name for s in specs if any(mark in Path(s.origin).read_text() for mark in marks)]
modules = [importlib.import_module(name) for name in names]
sys.modules[f"{sys.argv[1]}.warm_up"].warm_up()
kernels = {f"{k.py_func.__module__}.{k.py_func.__name__}": k for module in modules for k in vars(module).values()
           if isinstance(k, Dispatcher) and k.py_func.__module__ in names}
# numba tells of no other way what the cache on disk holds for the present source
json.dump({name: {"cached": len(k._cache._cache_file._load_index()), "compiled": sum(k.stats.cache_misses.values())}
           for name, k in kernels.items()}, sys.stdout)
"""


def warmed(room: str) -> dict[str, dict[str, int]]:
    """Per kernel of a room: types in the cache on disk, and types compiled by a warm-up in a fresh process."""
    done = subprocess.run([sys.executable, "-c", REPORT, room], capture_output=True, text=True, check=True)
    return dict(json.loads(done.stdout))


@pytest.mark.parametrize(("room", "least"), [("planning", 20), ("perception", 10), ("vehicle", 1)])
def test_after_a_warm_up_every_kernel_is_cached_and_nothing_is_compiled_again(room: str, least: int) -> None:
    warmed(room)
    kernels = warmed(room)
    assert len(kernels) >= least
    assert [name for name, kernel in kernels.items() if not kernel["cached"]] == []
    assert [name for name, kernel in kernels.items() if kernel["compiled"]] == []
