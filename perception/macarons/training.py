"""Training runs: epochs over walks, with checkpoints after each from which a run goes on to bit-equal weights."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import msgspec
import numpy as np
import torch

from missions.errors import UserError
from perception.macarons.learner import Learner, LearnSettings
from perception.macarons.memory import Memory
from perception.macarons.online import online_pass
from perception.macarons.pretrain import depth_pass, scone_pass, validation
from perception.macarons.tracks import Track
from perception.macarons.weights import Networks, load_network, load_optimiser, save_network, save_optimiser, write_json

NAMES = ("depth", "occupancy", "gain")
Report = Callable[[int, str, list[float]], None]
"""Told the epoch, what was measured, and the values."""


class TrainSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A training run."""

    learn: LearnSettings = LearnSettings()
    online: bool = False
    """Learn as in flight, from pictures alone; otherwise from the truth of the walks."""
    parts: tuple[str, ...] = NAMES
    """Networks that learn; the others stay as they are."""
    together: int = 6
    """Walks in memory at a time, from which the pictures of a batch of depth come, and the queries of occupancy."""
    depth_steps: int = 16
    """Updates of depth per walk and epoch while pretraining."""
    scone_steps: int = 8
    """Updates of occupancy and gain, likewise."""
    range_m: float = 25.0
    """How far pictures count in the walks."""


class TrainingRun:
    """Networks, optimisers, memory and the number of epochs done, kept in a folder."""

    def __init__(self, folder: Path, settings: TrainSettings, walks: list[Path],
                 begin_with: Path | None = None) -> None:
        """begin_with: a folder of weights to begin with. Raises UserError."""
        self.folder, self.settings, self.walks, self.epochs = folder, settings, walks, 0
        networks = Networks.fresh(settings.learn.seed)
        if begin_with is not None:
            networks = Networks.load(begin_with)
        self.learner = Learner(networks, settings.learn)
        self.memory = Memory(settings.learn.memory)

    @property
    def _checkpoint(self) -> Path:
        return self.folder / "checkpoint"

    def resume(self) -> None:
        """Go on from the folder's checkpoint. Raises UserError where there is none, or one of other settings."""
        state_file = self._checkpoint / "state.json"
        if not state_file.is_file():
            raise UserError(f"{self.folder}: there is no checkpoint to resume; leave --resume out.")
        state = msgspec.json.decode(state_file.read_bytes())
        kept = msgspec.convert(state["settings"], TrainSettings)
        if kept != self.settings:
            raise UserError(f"{self.folder}: the checkpoint was trained with other settings; give the same ones or "
                            "another --out.")
        for name, part in self.learner.parts.items():
            load_network(part.net, self._checkpoint / f"{name}.safetensors")
            part.updates = state["updates"][name]
            if part.updates:
                load_optimiser(part.optimiser, self._checkpoint / f"{name}.optimiser.safetensors")
        self.memory.load(self._checkpoint / "memory")
        self.epochs = state["epochs"]

    def epoch(self, report: Report) -> None:
        """One pass over all walks in a random order, then a checkpoint."""
        for paths, rng in self._visits():
            tracks = [Track.read(path, self.settings.learn.picture_px, self.settings.range_m) for path in paths]
            for name, losses in self._visit(tracks, rng):
                report(self.epochs, name, losses)
        self.epochs += 1
        self.save()

    def _visits(self) -> Iterator[tuple[list[Path], np.random.Generator]]:
        rng = np.random.default_rng([self.settings.learn.seed, self.epochs])
        order = [self.walks[int(k)] for k in rng.permutation(len(self.walks))]
        for first in range(0, len(order), self.settings.together):
            torch.manual_seed(int(rng.integers(2**31)))
            yield order[first:first + self.settings.together], rng

    def _visit(self, tracks: list[Track], rng: np.random.Generator) -> Iterator[tuple[str, list[float]]]:
        s = self.settings
        if not s.online and "depth" in s.parts:
            yield from depth_pass(self.learner, tracks, s.depth_steps * len(tracks), rng).items()
        if s.online:
            for track in tracks:
                yield from online_pass(self.learner, self.memory, track, rng).items()
        elif "occupancy" in s.parts or "gain" in s.parts:
            yield from scone_pass(self.learner, tracks, s.scone_steps, rng).items()

    def validate(self, walks: list[Path]) -> dict[str, float]:
        """Mean errors over walks that were not trained on; the same examples every time."""
        found: dict[str, list[float]] = {}
        for number, path in enumerate(walks):
            track = Track.read(path, self.settings.learn.picture_px, self.settings.range_m)
            for name, value in validation(self.learner, track, np.random.default_rng([0, number])).items():
                found.setdefault(name, []).append(value)
        return {name: float(np.mean(values)) for name, values in found.items()}

    def save(self) -> None:
        """Write the checkpoint; the one before stays until this one is whole."""
        fresh = self.folder / "checkpoint.new"
        shutil.rmtree(fresh, ignore_errors=True)
        fresh.mkdir(parents=True)
        for name, part in self.learner.parts.items():
            save_network(part.net, fresh / f"{name}.safetensors")
            save_optimiser(part.optimiser, fresh / f"{name}.optimiser.safetensors")
        self.memory.save(fresh / "memory")
        write_json({"epochs": self.epochs, "settings": msgspec.to_builtins(self.settings),
                    "updates": {name: part.updates for name, part in self.learner.parts.items()}}, fresh / "state.json")
        shutil.rmtree(self._checkpoint, ignore_errors=True)
        fresh.rename(self._checkpoint)

    def export(self, folder: Path) -> None:
        """Write the weights alone, float16, as they ship."""
        self.learner.networks.save(folder, torch.float16)
