"""The GPU, where there is one: chosen by itself, never needed."""

from __future__ import annotations

from functools import cache
from pathlib import Path

DRIVERS = (Path("/dev/nvidiactl"), Path("/dev/dxg"))
"""There with NVIDIA's driver on Linux and under Windows' Linux. Without them torch, which takes seconds and memory, is
not imported to ask."""


@cache
def torch_device() -> str:
    """"cuda" where torch can use a GPU, "" where compiled loops and OpenCV do the work. `CUDA_VISIBLE_DEVICES=` in the
    environment keeps a GPU out of it."""
    if not any(driver.exists() for driver in DRIVERS):
        return ""
    import torch

    return "cuda" if torch.cuda.is_available() else ""
