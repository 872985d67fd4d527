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
    for voxel in range(known.shape[1]):
        a, b = first_bias.copy(), second_bias.copy()
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
