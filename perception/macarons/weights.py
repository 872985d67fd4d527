"""The three networks together, and how they and their optimisers are kept: safetensors and JSON, never pickle."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from torch import Tensor, nn

from missions.errors import UserError
from perception.macarons.depth_net import DepthNet
from perception.macarons.gain_net import GainNet
from perception.macarons.occupancy_net import OccupancyNet

SHIPPED = Path(__file__).resolve().parent / "weights"
"""depth, occupancy and gain .safetensors, float16, with a model card each."""


@dataclass(frozen=True)
class Networks:
    """Depth, occupancy and coverage gain."""

    depth: DepthNet
    occupancy: OccupancyNet
    gain: GainNet

    @classmethod
    def fresh(cls, seed: int) -> Networks:
        """Untrained; equal seeds give equal weights."""
        torch.manual_seed(seed)
        return cls(DepthNet(), OccupancyNet(), GainNet())

    @classmethod
    def load(cls, folder: Path) -> Networks:
        """The networks of a folder, ready to predict. Raises UserError."""
        networks = cls.fresh(0)
        for name, net in networks.named().items():
            load_network(net, folder / f"{name}.safetensors")
            net.eval()
        return networks

    def named(self) -> dict[str, nn.Module]:
        """By name."""
        return {"depth": self.depth, "occupancy": self.occupancy, "gain": self.gain}

    def save(self, folder: Path, kind: torch.dtype = torch.float32) -> None:
        """Write one file per network."""
        folder.mkdir(parents=True, exist_ok=True)
        for name, net in self.named().items():
            save_network(net, folder / f"{name}.safetensors", kind)


def save_network(net: nn.Module, path: Path, kind: torch.dtype = torch.float32) -> None:
    """Write a network's weights; floats as `kind`."""
    state = {key: (v.to(kind) if v.is_floating_point() else v).contiguous() for key, v in net.state_dict().items()}
    save_file(state, path)


def load_network(net: nn.Module, path: Path) -> None:
    """Read a network's weights, of whatever precision. Raises UserError where the file does not fit."""
    try:
        net.load_state_dict(load_file(path))
    except (OSError, SafetensorError, RuntimeError) as e:
        first = str(e).splitlines()[0]
        raise UserError(f"{path}: not weights of {type(net).__name__} ({first}); train or give another file.") from e


def save_optimiser(optimiser: torch.optim.Optimizer, path: Path) -> None:
    """Write an optimiser's moments and steps."""
    state = optimiser.state_dict()["state"]
    save_file({f"{index}.{key}": value.contiguous() for index, entry in state.items() for key, value in entry.items()},
              path)


def load_optimiser(optimiser: torch.optim.Optimizer, path: Path) -> None:
    """Read what `save_optimiser` wrote into an optimiser over the same weights."""
    entries: dict[int, dict[str, Tensor]] = {}
    for name, value in load_file(path).items():
        index, key = name.split(".", 1)
        entries.setdefault(int(index), {})[key] = value
    optimiser.load_state_dict({"state": entries, "param_groups": optimiser.state_dict()["param_groups"]})


def write_json(document: dict[str, Any], path: Path) -> None:
    """Write a JSON document readably."""
    path.write_text(json.dumps(document, indent=1, sort_keys=True) + "\n", encoding="utf-8")
