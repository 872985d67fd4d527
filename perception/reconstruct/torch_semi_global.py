"""Semi-global matching in torch, for a GPU: OpenCV's StereoSGBM (mode SGBM, five directions) to the bit, some pairs at
a time, since paths go pixel by pixel and a GPU has time for many of them."""

from __future__ import annotations

import threading
from collections.abc import Iterable, Iterator

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from perception.reconstruct.semi_global import (
    BLOCK_PX,
    BOTH_WAYS_PX,
    CLIPPED_AT,
    JUMP_PENALTY,
    NONE,
    STEP_PENALTY,
    UNIQUENESS_PERCENT,
    RectifiedPair,
)

BATCH_CELLS = 2**30
"""Pixels times disparities matched at once, two times two bytes each."""
BAND_ROWS = 64
"""Rows whose costs are made, and whose best are found, at once: what that takes beside the batch stays small."""
NEVER = 16_000
"""Cost of a disparity that a pair does not have: more than any, and no sum of penalties on it leaves 16 bits."""
_one_at_a_time = threading.Lock()


def disparities(pairs: list[RectifiedPair], device_name: str) -> list[NDArray[np.int16]]:
    """(height, width) for each pair: sixteenths of a pixel, `NONE` where nothing is trusted, before speckles go."""
    device, found = torch.device(device_name), []
    with _one_at_a_time, torch.inference_mode():
        for batch in _batches(pairs):
            costs = [_cost_volume(torch.from_numpy(p.left).to(device), torch.from_numpy(p.right).to(device),
                                  p.disparities) for p in batch]
            sums = _along_paths(_stacked(costs), [c.shape[1] for c in costs])
            for pair, cost, total in zip(batch, costs, sums, strict=True):
                h, w, d = cost.shape
                bands = total[:h, :w, :d].split(BAND_ROWS)
                found.append(torch.cat([_winners(band, pair.left.shape[1]) for band in bands]).cpu().numpy())
    return found


def _batches(pairs: list[RectifiedPair]) -> Iterator[list[RectifiedPair]]:
    batch: list[RectifiedPair] = []
    for pair in pairs:
        if batch and _cells([*batch, pair]) > BATCH_CELLS:
            yield batch
            batch = []
        batch.append(pair)
    if batch:
        yield batch


def _cells(pairs: list[RectifiedPair]) -> int:
    sizes = [(*p.left.shape, p.disparities) for p in pairs]
    return len(pairs) * int(np.prod(np.max(sizes, axis=0)))


def _stacked(costs: list[Tensor]) -> Tensor:
    """(pairs, h, w, d) of the largest, filled up with NEVER."""
    size = [max(c.shape[axis] for c in costs) for axis in range(3)]
    stack = torch.full((len(costs), *size), NEVER, dtype=torch.int16, device=costs[0].device)
    for own, cost in zip(stack, costs, strict=True):
        own[: cost.shape[0], : cost.shape[1], : cost.shape[2]] = cost
    return stack


def _cost_volume(left: Tensor, right: Tensor, count: int) -> Tensor:
    """(h, w - count, count) int16 costs of blocks, from the first column that has all disparities on."""
    h, half = left.shape[0], BLOCK_PX // 2
    channels = [(a, *_between(a), b, *_between(b), shift)
                for a, b, shift in zip(_channels(left), _channels(right), (0, 2), strict=True)]
    cost = torch.empty((h, left.shape[1] - count, count), dtype=torch.int16, device=left.device)
    for first in range(0, h, BAND_ROWS):
        rows = torch.arange(first - half, min(first + BAND_ROWS, h) + half, device=left.device).clamp(0, h - 1)
        pixels = _pixel_costs(channels, rows, count)
        wide = torch.cat([pixels[:, :1]] * half + [pixels] + [pixels[:, -1:]] * half, dim=1)
        cost[first : first + BAND_ROWS] = _windows(_windows(wide, 1), 0)
    return cost


def _windows(values: Tensor, axis: int) -> Tensor:
    """Sums of BLOCK_PX neighbours along the axis."""
    count = values.shape[axis] - BLOCK_PX + 1
    total = values.narrow(axis, 0, count).clone()
    for i in range(1, BLOCK_PX):
        total += values.narrow(axis, i, count)
    return total


def _channels(image: Tensor) -> tuple[Tensor, Tensor]:
    """Clipped horizontal gradient (Sobel) and grey, int16; the outermost columns of both say nothing."""
    grey = image.to(torch.int16)
    step = torch.zeros_like(grey)
    step[:, 1:-1] = grey[:, 2:] - grey[:, :-2]
    around = torch.cat([step[:1], step[:-1]]) + 2 * step + torch.cat([step[1:], step[-1:]])
    gradient = around.clamp(-CLIPPED_AT, CLIPPED_AT) + CLIPPED_AT
    for channel in (gradient, grey):
        channel[:, 0] = channel[:, -1] = CLIPPED_AT
    return gradient, grey


def _between(values: Tensor) -> tuple[Tensor, Tensor]:
    """Least and largest value within half a pixel to either side (Birchfield & Tomasi 1998)."""
    middle = (values[:, 1:] + values[:, :-1]) >> 1
    before, after = torch.cat([values[:, :1], middle], dim=1), torch.cat([middle, values[:, -1:]], dim=1)
    return (torch.minimum(torch.minimum(before, after), values), torch.maximum(torch.maximum(before, after), values))


def _pixel_costs(channels: Iterable[tuple[Tensor, Tensor, Tensor, Tensor, Tensor, Tensor, int]], rows: Tensor,
                 count: int) -> Tensor:
    """(rows, w - count, count) cost of every pixel by itself."""
    total: Tensor | None = None
    for a, a_low, a_high, b, b_low, b_high, shift in channels:
        own, own_low, own_high = (v[rows, count:, None] for v in (a, a_low, a_high))
        other, low, high = (v[rows].unfold(1, count, 1)[:, 1:].flip(-1) for v in (b, b_low, b_high))
        there = torch.maximum(own - high, low - own).clamp_min_(0)
        back = torch.maximum(other - own_high, own_low - other).clamp_min_(0)
        cost = torch.minimum(there, back) >> shift
        total = cost if total is None else total + cost
    assert total is not None
    return total


def _along_paths(cost: Tensor, widths: list[int]) -> Tensor:
    """Sum over five directions (along rows both ways, down, down to either side) of the cheapest paths' costs."""
    pairs, h, w, count = cost.shape
    total = torch.zeros_like(cost)
    index = torch.arange(pairs, device=cost.device)
    last = torch.tensor(widths, device=cost.device) - 1
    ahead = back = cost.new_zeros((pairs, h, count))
    for x in range(w):
        ahead = _next(cost[:, :, x], ahead)
        total[:, :, x] += ahead
        mirrored = last - x  # below 0, that is from the right end, it is the filling's turn
        back = _next(cost[index, :, mirrored], back)
        total[index, :, mirrored] += back
    inside = (torch.arange(w, device=cost.device) <= last[:, None])[..., None].to(cost.dtype)
    down = cost.new_zeros((3, pairs, w, count))
    for y in range(h):
        before = torch.stack([functional.pad(down[0, :, :-1], (0, 0, 1, 0)), down[1],
                              functional.pad(down[2, :, 1:], (0, 0, 0, 1))])
        down = _next(cost[:, y], before) * inside
        total[:, y] += down.sum(dim=0, dtype=cost.dtype)
    return total


def _next(cost: Tensor, before: Tensor) -> Tensor:
    """Equation 13 of Hirschmüller 2008: cheapest paths' costs (..., count) a pixel farther on."""
    least = before.amin(dim=-1, keepdim=True)
    beside = torch.minimum(functional.pad(before[..., :-1], (1, 0), value=NEVER),
                           functional.pad(before[..., 1:], (0, 1), value=NEVER))
    return cost + torch.minimum(torch.minimum(before, beside + STEP_PENALTY), least + JUMP_PENALTY) - least


def _winners(total: Tensor, width: int) -> Tensor:
    """(rows, width) int16 of sums (rows, w, count): the cheapest, between steps, where no other is nearly as cheap and
    the right picture chooses it too."""
    rows, _, count = total.shape
    steps = torch.arange(count, device=total.device, dtype=torch.int32)
    wide = total.to(torch.int32)
    least_first = (wide * count + steps).amin(dim=-1)
    best, least = least_first % count, least_first // count
    rivals = (wide * (100 - UNIQUENESS_PERCENT) < 100 * least[..., None]) & ((steps - best[..., None]).abs() > 1)
    unique = ~rivals.any(dim=-1)
    at = [wide.gather(-1, (best + i).clamp(0, count - 1).long()[..., None])[..., 0] for i in (-1, 0, 1)]
    curve = (at[0] + at[2] - 2 * at[1]).clamp_min(1)
    part = torch.div((at[0] - at[2]) * 16 + curve, 2 * curve, rounding_mode="trunc")
    fine = 16 * best + torch.where((best > 0) & (best < count - 1), part, 0)
    chosen = _of_right(best, least, unique, width)
    apart = _contradicted(fine >> 4, chosen) & _contradicted((fine + 15) >> 4, chosen)
    result = torch.full((rows, width), NONE, dtype=torch.int16, device=total.device)
    result[:, count:] = torch.where(unique & ~apart, fine, NONE).to(torch.int16)
    return result


def _of_right(best: Tensor, least: Tensor, unique: Tensor, width: int) -> Tensor:
    """(rows, width) disparity of each pixel of the right picture: of the cheapest that claims it; -1 without any."""
    rows, w = best.shape
    first = width - w
    x = torch.arange(w, device=best.device)
    nobody = torch.iinfo(torch.int64).max
    claims = torch.where(unique, least.long() * w + (w - 1 - x), nobody)
    cheapest = torch.full((rows, width), nobody, dtype=torch.int64, device=best.device)
    cheapest = cheapest.scatter_reduce(1, (x + first - best).long(), claims, "amin")
    column = w - 1 - cheapest % w + first
    return torch.where(cheapest == nobody, -1, column - torch.arange(width, device=best.device))


def _contradicted(disparity: Tensor, chosen: Tensor) -> Tensor:
    """Where the right picture has another disparity for the pixel that this one leads to."""
    w, width = disparity.shape[1], chosen.shape[1]
    column = torch.arange(width - w, width, device=chosen.device) - disparity
    other = chosen.gather(1, column.clamp(0, width - 1).long())
    return (column >= 0) & (column < width) & (other >= 0) & ((other - disparity).abs() > BOTH_WAYS_PX)
