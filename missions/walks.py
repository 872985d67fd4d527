"""Pictures and poses of walks through one scene: what the depth benchmark hands to perception. No truth in it."""

from __future__ import annotations

from pathlib import Path

import msgspec

from missions.camera import Camera, Pose


class Shot(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One picture of a walk; key views end a move."""

    walk: int
    pose: Pose
    key: bool


class Walks(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """All walks through one scene, in order."""

    scene: str
    camera: Camera
    sensing_range_m: float
    shots: list[Shot]
    jpegs: list[bytes]


def walks_path(folder: Path, scene: str) -> Path:
    """The pictures' file; the truth lies beside it in `truth_path`."""
    return folder / f"{_stem(scene)}.walks"


def truth_path(folder: Path, scene: str) -> Path:
    """npz with depth_m (n, h, w) float32 along the optical axis, inf in the sky; on_object, on_water (n, h, w);
    wires_enu_m, empty_enu_m (m, 3) places on wires, and places with nothing near."""
    return folder / f"{_stem(scene)}.truth.npz"


def _stem(scene: str) -> str:
    return Path(scene).name.replace(":", "_")
