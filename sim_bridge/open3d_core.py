"""Open3D without its plots for notebooks: plotly and dash are two thirds of what `import open3d` takes."""

from __future__ import annotations

import sys
from types import ModuleType

PLOTS = "open3d.visualization.draw_plotly"
NAMES = ("get_plotly_fig", "draw_plotly", "draw_plotly_server")
"""What `open3d.visualization` asks of that module."""


def _without_plots() -> ModuleType:
    if "open3d" not in sys.modules:
        stand_in = ModuleType(PLOTS)
        vars(stand_in).update(dict.fromkeys(NAMES))
        sys.modules[PLOTS] = stand_in
    try:
        import open3d
    finally:
        if getattr(sys.modules.get(PLOTS), "__file__", None) is None:
            sys.modules.pop(PLOTS, None)
    return open3d


o3d = _without_plots()
