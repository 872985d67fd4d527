"""The network's layers, compiled: every voxel is reckoned alone and in a fixed order, so that the result does not
depend on the number of threads, as that of a BLAS library does."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from perception.depth.compiled import compiled

Floats = NDArray[np.float32]


@compiled
def logits(known: Floats, mean: Floats, scale: Floats, first: Floats, first_bias: Floats, second: Floats,
           second_bias: Floats, last: Floats, last_bias: Floats) -> Floats:
    """(n,) from known (inputs, n): two hidden layers with ReLU. first (inputs, hidden), second (hidden, hidden),
    last (hidden,)."""
    result = np.empty(known.shape[1], np.float32)
    a, b = np.empty_like(first_bias), np.empty_like(second_bias)
    for voxel in range(known.shape[1]):
        a[:], b[:] = first_bias, second_bias
        for j in range(known.shape[0]):
            x = (known[j, voxel] - mean[j]) * scale[j]
            for h in range(len(a)):
                a[h] += x * first[j, h]
        for j in range(len(a)):
            if a[j] > 0.0:
                for h in range(len(b)):
                    b[h] += a[j] * second[j, h]
        total = last_bias[0]
        for h in range(len(b)):
            total += max(b[h], np.float32(0.0)) * last[h]
        result[voxel] = total
    return result


@compiled
def gradients(known: Floats, target: Floats, weight: Floats, mean: Floats, scale: Floats, first: Floats,
              first_bias: Floats, second: Floats, second_bias: Floats, last: Floats,
              last_bias: Floats) -> tuple[Floats, Floats, Floats, Floats, Floats, Floats]:
    """Of the log loss of voxels known (n, inputs), weighted (n,), against chances (n,), by each of the last six."""
    d_first, d_first_bias = np.zeros_like(first), np.zeros_like(first_bias)
    d_second, d_second_bias = np.zeros_like(second), np.zeros_like(second_bias)
    d_last, d_last_bias = np.zeros_like(last), np.zeros_like(last_bias)
    back = np.empty_like(first_bias)
    for voxel in range(len(known)):
        a, b = first_bias.copy(), second_bias.copy()
        x = (known[voxel] - mean) * scale
        for j in range(len(x)):
            for h in range(len(a)):
                a[h] += x[j] * first[j, h]
        for j in range(len(a)):
            if a[j] > 0.0:
                for h in range(len(b)):
                    b[h] += a[j] * second[j, h]
        logit = last_bias[0]
        for h in range(len(b)):
            logit += max(b[h], np.float32(0.0)) * last[h]
        error = weight[voxel] * (np.float32(1.0) / (np.float32(1.0) + np.exp(-logit)) - target[voxel])
        d_last_bias[0] += error
        back[:] = 0.0
        for h in range(len(b)):
            if b[h] > 0.0:
                d_last[h] += error * b[h]
                b[h] = error * last[h]
            else:
                b[h] = 0.0
            d_second_bias[h] += b[h]
        for j in range(len(a)):
            if a[j] > 0.0:
                for h in range(len(b)):
                    d_second[j, h] += a[j] * b[h]
                    back[j] += second[j, h] * b[h]
                d_first_bias[j] += back[j]
        for j in range(len(x)):
            for h in range(len(a)):
                d_first[j, h] += x[j] * back[h]
    return d_first, d_first_bias, d_second, d_second_bias, d_last, d_last_bias
