"""Trains the confidence of depth. Apart from the rest, because it needs torch."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np
import torch
from numpy.typing import NDArray

from perception.depth.confidence import Confidence

HIDDEN = (24, 12)
BATCH, RATE = 8192, 4e-3


def learnt(evidence: NDArray[np.float32], right: NDArray[np.bool_], epochs: int = 6,
           seed: int = 0) -> tuple[Confidence, float]:
    """A perceptron that tells right (n,) from evidence (n, features), and its mean log loss over the last epoch.

    AdamW with one cycle of the rate (Smith & Topin 2019). The same numbers give the same weights on one machine.
    """
    torch.manual_seed(seed)
    mean, scale = evidence.mean(axis=0, dtype=np.float64), 1.0 / (evidence.std(axis=0, dtype=np.float64) + 1e-3)
    known = torch.from_numpy(((evidence - mean) * scale).astype(np.float32))
    truth = torch.from_numpy(right.astype(np.float32))
    hidden = [m for a, b in itertools.pairwise((known.shape[1], *HIDDEN))
              for m in (torch.nn.Linear(a, b), torch.nn.ReLU())]
    net = torch.nn.Sequential(*hidden, torch.nn.Linear(HIDDEN[-1], 1))
    optimizer = torch.optim.AdamW(net.parameters(), lr=RATE, weight_decay=1e-4)
    batches = -(-len(known) // BATCH)
    rate = torch.optim.lr_scheduler.OneCycleLR(optimizer, RATE, total_steps=epochs * batches)
    losses = []
    for drawn in _batches(len(known), epochs):
        loss = torch.nn.functional.binary_cross_entropy_with_logits(net(known[drawn])[:, 0], truth[drawn])
        optimizer.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        optimizer.step()
        rate.step()
        losses.append(float(loss.detach()))
    *weights, last, last_bias = (np.ascontiguousarray(p.detach().numpy().T) for p in net.parameters())
    layers = mean.astype(np.float32), scale.astype(np.float32), *weights, last[:, 0].copy(), last_bias
    return Confidence(layers, np.array([0.0, 1.0], np.float32)), float(np.mean(losses[-batches:]))


def line(odds: NDArray[np.float32], right: NDArray[np.bool_], steps: int = 15) -> NDArray[np.float32]:
    """(a, b) such that a + b * odds are the log odds of right (n,): Platt scaling, by Newton's method."""
    x, weights = np.stack([np.ones(len(odds)), odds], axis=1).astype(np.float64), np.zeros(2)
    for _ in range(steps):
        p = 1.0 / (1.0 + np.exp(-(x @ weights)))
        curvature = (x * (p * (1.0 - p))[:, None]).T @ x + 1e-3 * np.eye(2)
        weights += np.linalg.solve(curvature, x.T @ (right - p) - 1e-3 * weights)
    return weights.astype(np.float32)


def _batches(count: int, epochs: int) -> Iterator[torch.Tensor]:
    for _ in range(epochs):
        yield from torch.split(torch.randperm(count), BATCH)
