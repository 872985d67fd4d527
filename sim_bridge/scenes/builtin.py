"""The built-in structures by name."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from sim_bridge.scenes.bridge import bridge
from sim_bridge.scenes.building import building
from sim_bridge.scenes.powerline import powerline
from sim_bridge.scenes.scene import Part
from sim_bridge.scenes.statue import statue

BUILT_IN: dict[str, Callable[[np.random.Generator], list[Part]]] = {
    "bridge": bridge, "building": building, "powerline": powerline, "statue": statue,
}
"""Each returns the object's parts, centred on the origin in x and y, standing on z = 0."""
