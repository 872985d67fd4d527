"""Ray casting through occupancy to faces not seen yet, and sums over what the rays met, compiled.

Each result is written in its own slot and summed in a fixed order: no result depends on the number of threads.
"""
# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import numba as nb
import numpy as np

from planning.nbv.rays import box_span, inside, next_voxel, walk

LEAST_ARRIVING = 0.03
FACES = 6
LEAST_SHARE = 0.05
"""A face that makes up less of a voxel's outline is not seen."""
SHARES = 8
"""Parts of the work of `show_from`."""


@nb.njit(cache=True)
def _facing(direction):
    """The faces of a voxel that a ray in this direction can hit, one per axis (0 and 1 are -x and +x, and so on), and
    the share of the voxel's outline that each makes up."""
    x, y, z = abs(direction[0]), abs(direction[1]), abs(direction[2])
    total = x + y + z
    faces = (0 if direction[0] > 0.0 else 1, 2 if direction[1] > 0.0 else 3, 4 if direction[2] > 0.0 else 5)
    return faces, (x / total, y / total, z / total)


@nb.njit(cache=True)
def _last_new(blocks, lower, upper, start, direction, reach):
    """Ray length at which the last marked block within reach is left, 0 where the ray meets none. Lengths in blocks;
    lower, upper (3,): a box that holds all that are marked."""
    enter, leave = box_span(start, direction, lower, upper)
    if enter >= leave:
        return 0.0
    voxel, walls, spans, steps = walk(start, direction)
    t, last = 0.0, 0.0
    while t < reach and t < leave:
        here = inside(blocks.shape, voxel) and blocks[voxel]
        voxel, t, walls = next_voxel(voxel, walls, spans, steps)
        if here:
            last = t
    return last


@nb.njit(cache=True)
def _stops(occupancy, faced, unseen, start, direction, reach, cell_voxels, scale, cell, area, arrives, at):
    """Entries that one ray makes from slot `at` on, one per cell and face that it may stop at; returns how many.

    Nothing is written when the arrays have no room for it (`at` < 0): the entries are only counted. faced, unseen: bits
    of the faces that voxels have, and that are new.
    """
    voxel, walls, spans, steps = walk(start, direction)
    faces, shares = _facing(direction)
    sj_cells = (occupancy.shape[1] + cell_voxels - 1) // cell_voxels
    sk_cells = (occupancy.shape[2] + cell_voxels - 1) // cell_voxels
    t, through, n, last = 0.0, 1.0, 0, -1
    for_face = (-1, -1, -1)
    while t < reach and through > LEAST_ARRIVING:
        if inside(occupancy.shape, voxel):
            p = occupancy[voxel]
            if p > 0.0:
                new = unseen[voxel]
                if new > 0:
                    i, j, k = voxel
                    c = ((i // cell_voxels) * sj_cells + j // cell_voxels) * sk_cells + k // cell_voxels
                    if c != last:
                        last, for_face = c, (-1, -1, -1)
                    whole = 0.0
                    for a in range(3):
                        if (faced[voxel] >> faces[a]) & 1 == 1:
                            whole += shares[a]
                    d = t + 0.5
                    for a in range(3):
                        if (new >> faces[a]) & 1 == 1 and shares[a] > LEAST_SHARE:
                            slot = for_face[a]
                            if slot < 0:
                                slot, n = n, n + 1
                                for_face = (slot if a == 0 else for_face[0], slot if a == 1 else for_face[1],
                                            slot if a == 2 else for_face[2])
                                if at >= 0:
                                    cell[at + slot], area[at + slot] = c * FACES + faces[a], 0.0
                                    arrives[at + slot] = through
                            if at >= 0:
                                area[at + slot] += through * p * shares[a] / whole * d * d * scale
                through *= 1.0 - p
        voxel, t, walls = next_voxel(voxel, walls, spans, steps)
    return n


@nb.njit(cache=True, parallel=True)
def count_stops(occupancy, faced, unseen, blocks, lower, upper, block_voxels, starts, directions, reach, cell_voxels):
    """(p, r) number of cells' faces that each ray may stop at, and how far along it new faces lie at most.

    blocks: which blocks of voxels have new faces, all of them in the box from lower to upper (3,), in blocks; most rays
    meet none, and are not followed.
    """
    nothing = np.zeros(0, np.int32), np.zeros(0, np.float32)
    count = np.zeros((len(starts), len(directions)), np.int64)
    until = np.zeros((len(starts), len(directions)))
    for p in nb.prange(len(starts)):
        start = starts[p] / block_voxels
        for r in range(len(directions)):
            last = _last_new(blocks, lower, upper, start, directions[r], reach / block_voxels)
            until[p, r] = min(reach, last * block_voxels)
            count[p, r] = _stops(occupancy, faced, unseen, starts[p], directions[r], until[p, r], cell_voxels, 0.0,
                                 nothing[0], nothing[1], nothing[1], -1)
    return count, until


@nb.njit(cache=True, parallel=True)
def cast_stops(occupancy, faced, unseen, starts, directions, until, cell_voxels, first, scale):
    """(cell's face, area, arrives) of every entry, in the slots that `count_stops` gave."""
    cell = np.zeros(first[-1], np.int32)
    area, arrives = np.zeros(first[-1], np.float32), np.zeros(first[-1], np.float32)
    for p in nb.prange(len(starts)):
        for r in range(len(directions)):
            at = first[p * len(directions) + r]
            if first[p * len(directions) + r + 1] > at:
                _stops(occupancy, faced, unseen, starts[p], directions[r], until[p, r], cell_voxels, scale, cell, area,
                       arrives, at)
    return cell, area, arrives


@nb.njit(cache=True)
def show(occupancy, shown, start, directions, reach, least):
    """Set in `shown` the bits of the faces that rays reach with a probability of at least `least`."""
    for r in range(len(directions)):
        voxel, walls, spans, steps = walk(start, directions[r])
        faces, shares = _facing(directions[r])
        bits = 0
        for a in range(3):
            if shares[a] > LEAST_SHARE:
                bits |= 1 << faces[a]
        t, through = 0.0, 1.0
        while t < reach and through >= least:
            if inside(occupancy.shape, voxel) and occupancy[voxel] > 0.0:
                shown[voxel] |= np.uint8(bits)
                through *= 1.0 - occupancy[voxel]
            voxel, t, walls = next_voxel(voxel, walls, spans, steps)


@nb.njit(cache=True, parallel=True)
def show_from(occupancy, starts, directions, reach, least):
    """(SHARES, i, j, k) bits that `show` sets from each share of the starts."""
    si, sj, sk = occupancy.shape
    shown_from = np.zeros((SHARES, si, sj, sk), np.uint8)
    for share in nb.prange(SHARES):
        for p in range(share, len(starts), SHARES):
            show(occupancy, shown_from[share], starts[p], directions, reach, least)
    return shown_from


@nb.njit(cache=True)
def view_sum(first, cell, area, left, seen_first, seen_rays, rays, position, orientation):
    """Expected new surface of one view, given what is left of each cell."""
    total = 0.0
    for s in range(seen_first[orientation], seen_first[orientation + 1]):
        ray = position * rays + seen_rays[s]
        for e in range(first[ray], first[ray + 1]):
            total += area[e] * left[cell[e]]
    return total


@nb.njit(cache=True, parallel=True)
def view_sums(first, cell, area, left, seen_first, seen_rays, positions, rays):
    """(p, o) `view_sum` of every view."""
    gains = np.zeros((positions, len(seen_first) - 1))
    for p in nb.prange(positions):
        if first[p * rays] == first[(p + 1) * rays]:
            continue
        per_ray = np.zeros(rays)
        for r in range(rays):
            for e in range(first[p * rays + r], first[p * rays + r + 1]):
                per_ray[r] += area[e] * left[cell[e]]
        for o in range(len(seen_first) - 1):
            total = 0.0
            for s in range(seen_first[o], seen_first[o + 1]):
                total += per_ray[seen_rays[s]]
            gains[p, o] = total
    return gains


@nb.njit(cache=True)
def shown(first, cell, arrives, left, seen_first, seen_rays, rays, position, orientation):
    """What is left of each cell after one view: the ray that is likeliest to arrive decides."""
    after = left.copy()
    for s in range(seen_first[orientation], seen_first[orientation + 1]):
        ray = position * rays + seen_rays[s]
        for e in range(first[ray], first[ray + 1]):
            c = cell[e]
            after[c] = min(after[c], left[c] * (np.float32(1.0) - arrives[e]))
    return after
