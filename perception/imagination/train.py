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
from rich.console import Console
from rich.progress import Progress

from missions.process import run_process
from perception.imagination.checkpoint import Training, save_net
from perception.imagination.network import ImaginationNet
from perception.imagination.samples import Samples, load_samples

RATE = 3e-3
BATCH = 4096
WARM_STEPS = 40
CHECKPOINT_STEPS = 500


def begin(samples: Samples, seed: int) -> Training:
    """A fresh network for samples like these, and its optimizer."""
    torch.manual_seed(seed)
    net = ImaginationNet()
    net.standardise(torch.from_numpy(samples.known))
    return Training(net, torch.optim.AdamW(net.parameters(), lr=RATE, weight_decay=1e-4))


def train_step(training: Training, samples: Samples, steps: int, seed: int) -> float:
    """One step on BATCH random voxels, with a rate that warms up and then falls to zero as a cosine; mean log loss."""
    drawn = np.random.default_rng([seed, training.step]).integers(len(samples.solid), size=BATCH)
    warm = min(1.0, (training.step + 1) / WARM_STEPS)
    for group in training.optimizer.param_groups:
        group["lr"] = RATE * warm * 0.5 * (1.0 + math.cos(math.pi * min(training.step / steps, 1.0)))
    training.optimizer.zero_grad()
    loss = _loss(training.net, Samples(samples.known[drawn], samples.solid[drawn]))
    loss.backward()  # type: ignore[no-untyped-call]
    training.optimizer.step()
    training.step += 1
    return float(loss.detach())


def log_loss(net: ImaginationNet, samples: Samples) -> float:
    """Mean log loss over samples."""
    with torch.inference_mode():
        return float(_loss(net, samples))


def _loss(net: ImaginationNet, samples: Samples) -> torch.Tensor:
    truth = torch.from_numpy(samples.solid.astype(np.float32))
    return torch.nn.functional.binary_cross_entropy_with_logits(net(torch.from_numpy(samples.known)), truth)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m perception.imagination.train", description=__doc__)
    parser.add_argument("folder", type=Path, help="walks to learn from")
    parser.add_argument("--out", type=Path, required=True, help="weights to write (safetensors); a checkpoint beside "
                        "them is taken up")
    parser.add_argument("--validation", type=Path, help="folder with walks to judge by on the way")
    parser.add_argument("--steps", type=int, default=4000, help="default %(default)s")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--workers", type=int, default=2, help="processes and threads (default %(default)s)")
    options = parser.parse_args(argv)
    torch.set_num_threads(options.workers)
    samples = load_samples(options.folder, options.seed, options.workers)
    judges = load_samples(options.validation, options.seed, options.workers) if options.validation else None
    training = begin(samples, options.seed)
    checkpoint = options.out.with_suffix(".checkpoint")
    if checkpoint.exists():
        training.resume(checkpoint)
    _run(training, samples, judges, checkpoint, options)
    save_net(options.out, training.net)
    return 0


def _run(training: Training, samples: Samples, judges: Samples | None, checkpoint: Path,
         options: argparse.Namespace) -> None:
    with Progress(console=Console(stderr=True)) as progress:
        row, losses = progress.add_task("training", total=options.steps, completed=training.step), []
        while training.step < options.steps:
            losses.append(train_step(training, samples, options.steps, options.seed))
            progress.update(row, completed=training.step)
            if training.step % CHECKPOINT_STEPS == 0 or training.step == options.steps:
                training.save(checkpoint)
                judged = "" if judges is None else f", on validation {log_loss(training.net, judges):.4f}"
                progress.console.print(f"step {training.step}: log loss {np.mean(losses):.4f}{judged}")
                losses.clear()


if __name__ == "__main__":
    sys.exit(run_process(main))
