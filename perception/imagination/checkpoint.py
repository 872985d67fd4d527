"""Weights and the state of training, as safetensors."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import safetensors.torch
import torch
from safetensors import SafetensorError

from missions.errors import UserError
from perception.imagination.network import ImaginationNet

STEP = "step"


def load_net(path: Path) -> ImaginationNet:
    """A network with the weights in a file. Raises UserError when they are not for it."""
    net = ImaginationNet()
    try:
        net.load_state_dict(safetensors.torch.load_file(path))
    except (SafetensorError, RuntimeError, OSError) as e:
        raise UserError(f"{path} holds no weights for imagination: {e}") from e
    return net


def save_net(path: Path, net: ImaginationNet) -> None:
    """Write the weights alone."""
    safetensors.torch.save_file(net.state_dict(), path)


@dataclass
class Training:
    """Everything that a training run carries from step to step."""

    net: ImaginationNet
    optimizer: torch.optim.Optimizer
    step: int = 0

    def save(self, path: Path) -> None:
        """Write a checkpoint, whole or not at all."""
        tensors = {f"net.{name}": t for name, t in self.net.state_dict().items()}
        for number, state in self.optimizer.state_dict()["state"].items():
            tensors |= {f"optimizer.{number}.{name}": t for name, t in state.items()}
        tensors[STEP] = torch.tensor(self.step)
        safetensors.torch.save_file(tensors, path.with_suffix(".part"))
        path.with_suffix(".part").replace(path)

    def resume(self, path: Path) -> None:
        """Take up a checkpoint. Raises UserError when it is none."""
        try:
            tensors = safetensors.torch.load_file(path)
            self.net.load_state_dict({k.removeprefix("net."): t for k, t in tensors.items() if k.startswith("net.")})
            self.step = int(tensors[STEP])
        except (SafetensorError, RuntimeError, KeyError, OSError) as e:
            raise UserError(f"{path} is no checkpoint of imagination ({e}); begin with another --out.") from e
        whole = self.optimizer.state_dict()
        for key, tensor in tensors.items():
            if key.startswith("optimizer."):
                _, number, name = key.split(".")
                whole["state"].setdefault(int(number), {})[name] = tensor
        self.optimizer.load_state_dict(whole)
