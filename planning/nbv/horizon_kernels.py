"""The compiled loops of planning.nbv.horizon."""
# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import numba as nb
import numpy as np

from planning.nbv.sight_kernels import shown, view_sum

SETTLED = 1e-6


@nb.njit(cache=True)
def promise(gains, steps, passable, discount):
    """(n,) best discounted gain within reach: value iteration in place, forwards and backwards in turn, until nothing
    changes any more."""
    best = gains.copy()
    changed, forwards = True, False
    while changed:
        changed, forwards = False, not forwards
        for i in range(len(best)):
            pose = i if forwards else len(best) - 1 - i
            for s in range(steps.shape[1]):
                ahead = steps[pose, s]
                if ahead >= 0:
                    value = discount * passable[pose, s] * best[ahead]
                    if value > best[pose] + SETTLED:
                        best[pose] = value
                        changed = True
    return best


@nb.njit(cache=True, parallel=True)
def promise_each(gains, steps, passable, discount):
    """(k, n) `promise` of gains (k, n)."""
    best = np.empty_like(gains)
    for k in nb.prange(len(gains)):
        best[k] = promise(gains[k], steps, passable, discount)
    return best


@nb.njit(cache=True, parallel=True)
def _scores(first, cell, area, left, seen_first, seen_rays, rays, ends, alive, steps, passable):
    """(width, 30) what each step from the end of each way adds; -1 where there is no such step."""
    gain = np.full((len(ends), steps.shape[1]), -1.0)
    orientations = len(seen_first) - 1
    for job in nb.prange(len(ends) * steps.shape[1]):
        w, s = job // steps.shape[1], job % steps.shape[1]
        ahead = steps[ends[w], s]
        if alive[w] and ahead >= 0 and passable[ends[w], s] > 0.0:
            gain[w, s] = view_sum(first, cell, area, left[w], seen_first, seen_rays, rays, ahead // orientations,
                                  ahead % orientations)
    return gain


@nb.njit(cache=True)
def _contains(values, value):
    return np.any(values == value)


@nb.njit(cache=True)
def _kept(score, ends, steps, width):
    """Indices (way, step) of the best scores, at most one for each pose they end at; score is spoiled."""
    chosen = np.empty((width, 2), np.int64)
    n = 0
    while n < width:
        flat = np.argmax(score)
        w, s = flat // score.shape[1], flat % score.shape[1]
        if score[w, s] == -np.inf:
            break
        chosen[n, 0], chosen[n, 1] = w, s
        n += 1
        pose = steps[ends[w], s]
        for a in range(score.shape[0]):
            for b in range(score.shape[1]):
                if steps[ends[a], b] == pose:
                    score[a, b] = -np.inf
    return chosen[:n]


@nb.njit(cache=True)
def beam(first, cell, area, arrives, left, seen_first, seen_rays, rays, steps, passable, start, first_steps, promised,
         depth, width, discount):
    """The ways that are left after `depth` steps, the first of them into first_steps: their poses (k, depth; -1 after
    the end of a way that could not go on), what each adds, discounted sums (k,), probabilities that every step is open
    (k,) and what they leave to see (k, cells)."""
    orientations = len(seen_first) - 1
    residual = np.empty((width, len(left)), np.float32)
    residual[0] = left
    poses, gains = np.full((width, depth), -1), np.zeros((width, depth))
    value, sure = np.zeros(width), np.ones(width)
    ends, alive = np.full(width, start), np.zeros(width, np.bool_)
    alive[0] = True
    for d in range(depth):
        gain = _scores(first, cell, area, residual, seen_first, seen_rays, rays, ends, alive, steps, passable)
        score = np.full(gain.shape, -np.inf)
        for w in range(width):
            for s in range(steps.shape[1]):
                if gain[w, s] >= 0.0 and (d > 0 or _contains(first_steps, steps[start, s])):
                    worth = gain[w, s] + discount * promised[steps[ends[w], s]]
                    score[w, s] = value[w] + sure[w] * passable[ends[w], s] * discount**d * worth
        kept = _kept(score, ends, steps, width)
        if len(kept) == 0:
            break
        way, step = kept[:, 0], kept[:, 1]
        was = residual.copy()
        poses[: len(kept)], gains[: len(kept)] = poses[way], gains[way]
        value[: len(kept)], sure[: len(kept)], ends[: len(kept)] = value[way], sure[way], ends[way]
        alive[:] = False
        for n in range(len(kept)):
            before, ahead = ends[n], steps[ends[n], step[n]]
            residual[n] = shown(first, cell, arrives, was[way[n]], seen_first, seen_rays, rays,
                                ahead // orientations, ahead % orientations)
            poses[n, d], gains[n, d] = ahead, gain[way[n], step[n]]
            sure[n] *= passable[before, step[n]]
            value[n] += sure[n] * discount**d * gains[n, d]
            ends[n], alive[n] = ahead, True
    found = int(alive.sum()) if poses[0, 0] >= 0 else 0
    return poses[:found], gains[:found], value[:found], sure[:found], residual[:found]
