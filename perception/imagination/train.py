"""Train imagination on walks that `swarmscan scenes walks` has written: python -m perception.imagination.train DIR.

Every step draws from its own number, so that a run that was cut off ends, when resumed, with the same weights.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from rich.progress import MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from missions.process import run_process
from perception.imagination.checkpoint import Training, save_net
from perception.imagination.network import ImaginationNet
from perception.imagination.partial_maps import load_maps
from perception.imagination.samples import Sample, samples_of
from perception.imagination.window import Floats

WARM_STEPS = 40
CHECKPOINT_STEPS = 50
VALIDATION_SAMPLES = 60


def begin(seed: int, rate: float) -> Training:
    """A fresh network and optimizer."""
    torch.manual_seed(seed)
    net = ImaginationNet()
    return Training(net, torch.optim.AdamW(net.parameters(), lr=rate, weight_decay=1e-4))


def train_step(training: Training, samples: Sequence[Sample], steps: int, rate: float, batch: int, seed: int) -> float:
    """One step on `batch` random patches, with a rate that warms up and then falls to zero as a cosine; mean loss."""
    rng = np.random.default_rng([seed, training.step])
    patches = [samples[int(k)].patch(rng) for k in rng.integers(len(samples), size=batch)]
    weights = [p.weight for p in patches]
    whole = max(sum(float(w.sum()) for w in weights), 1.0)
    warm = min(1.0, (training.step + 1) / WARM_STEPS)
    for group in training.optimizer.param_groups:
        group["lr"] = rate * warm * 0.5 * (1.0 + math.cos(math.pi * min(training.step / steps, 1.0)))
    training.optimizer.zero_grad()
    total = 0.0
    for patch, weight in zip(patches, weights, strict=True):
        loss = _loss(training.net, patch, weight) / whole
        loss.backward()  # type: ignore[no-untyped-call]
        total += float(loss.detach())
    torch.nn.utils.clip_grad_norm_(training.net.parameters(), 1.0)
    training.optimizer.step()
    training.step += 1
    return total


def validation_loss(net: ImaginationNet, samples: Sequence[Sample]) -> float:
    """Mean loss over samples, whole and unturned."""
    loss = whole = 0.0
    with torch.inference_mode():
        for sample in samples:
            weight = sample.weight
            loss += float(_loss(net, sample, weight))
            whole += float(weight.sum())
    return loss / max(whole, 1.0)


def _loss(net: ImaginationNet, sample: Sample, weight: Floats) -> torch.Tensor:
    """Weighted sum of log losses."""
    logits = net(torch.from_numpy(sample.known)[None], torch.from_numpy(sample.place)[None])[0]
    truth = torch.from_numpy(sample.solid).float()
    return torch.nn.functional.binary_cross_entropy_with_logits(logits, truth, torch.from_numpy(weight),
                                                                reduction="sum")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m perception.imagination.train", description=__doc__)
    parser.add_argument("folder", type=Path, help="walks to learn from")
    parser.add_argument("--out", type=Path, required=True, help="weights to write (safetensors)")
    parser.add_argument("--validation", type=Path, help="folder with walks to judge by on the way")
    parser.add_argument("--steps", type=int, default=1500, help="default %(default)s")
    parser.add_argument("--batch", type=int, default=2, help="patches per step (default %(default)s)")
    parser.add_argument("--rate", type=float, default=3e-3, help="highest learning rate (default %(default)s)")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--threads", type=int, default=2, help="default %(default)s")
    options = parser.parse_args(argv)
    torch.set_num_threads(options.threads)
    samples = samples_of(load_maps(options.folder))
    judges = samples_of(load_maps(options.validation)) if options.validation else []
    training = begin(options.seed, options.rate)
    checkpoint = options.out.with_suffix(".checkpoint")
    if checkpoint.exists():
        training.resume(checkpoint)
    _run(training, samples, judges[:: max(1, len(judges) // VALIDATION_SAMPLES)], checkpoint, options)
    save_net(options.out, training.net)
    return 0


def _run(training: Training, samples: list[Sample], judges: list[Sample], checkpoint: Path,
         options: argparse.Namespace) -> None:
    columns = (TextColumn("{task.description}"), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns) as progress:
        row, mean, judged = progress.add_task("", total=options.steps, completed=training.step), math.nan, ""
        while training.step < options.steps:
            loss = train_step(training, samples, options.steps, options.rate, options.batch, options.seed)
            mean = loss if math.isnan(mean) else 0.97 * mean + 0.03 * loss
            if training.step % CHECKPOINT_STEPS == 0 or training.step == options.steps:
                training.save(checkpoint)
                judged = f", validation {validation_loss(training.net, judges):.4f}" if judges else ""
                progress.console.print(f"step {training.step}: loss {mean:.4f}{judged}")
            progress.update(row, completed=training.step, description=f"loss {mean:.4f}{judged}")


if __name__ == "__main__":
    sys.exit(run_process(main))
