"""Ray casting through occupancy to faces not seen yet, and sums over what the rays met, compiled.

Each result is written in its own slot and summed in a fixed order: no result depends on the number of threads.
"""
# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import numba as nb
import numpy as np

from planning.nbv.rays import box_span, inside, next_axis, next_voxel, walk

LEAST_ARRIVING = 0.03
FACES = 6
LEAST_SHARE = 0.05
"""A face that makes up less of a voxel's outline is not seen."""
SHARES = 8
"""Parts of the work of `show_from`."""
ALIKE = 0.97
"""How likely the next voxel of a ray shares the fate of the one before: what is unknown is free or solid in whole
pieces, not voxel by voxel."""


@nb.njit(cache=True)
def _facing(direction):
    """The faces of a voxel that a ray in this direction can hit, one per axis (0 and 1 are -x and +x, and so on), and
    the share of the voxel's outline that each makes up."""
    x, y, z = abs(direction[0]), abs(direction[1]), abs(direction[2])
    total = x + y + z
    faces = (0 if direction[0] > 0.0 else 1, 2 if direction[1] > 0.0 else 3, 4 if direction[2] > 0.0 else 5)
    return faces, (x / total, y / total, z / total)


@nb.njit(cache=True)
def _stopping(chance, passed, alike):
    """How likely a voxel of this chance to be solid stops a ray that has come to it, and what the ray has passed then.

    A ray carries a level, uniform in 0 to 1; a voxel is solid when the level lies below its chance. From voxel to voxel
    the level stays with chance `alike`, else it is drawn anew. passed: what the level is known to lie above, for the
    ray came through a voxel of that chance. So every voxel alone is solid as likely as it was imagined, but a ray that
    has entered a piece of unknown space likely comes out of it.
    """
    if chance >= 1.0:
        return 1.0, 0.0
    again = (chance - passed) / (1.0 - passed) if chance > passed else 0.0
    return alike * again + (1.0 - alike) * chance, alike * max(passed, chance) + (1.0 - alike) * chance


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
def _stops(occupancy, unseen, start, direction, reach, cell_voxels, scale, cell, area, arrives, at):
    """Entries that one ray makes from slot `at` on, one per cell and face that it may stop at; returns how many.

    Nothing is written when the arrays have no room for it (`at` < 0): the entries are only counted. unseen: bits of the
    faces that are new. A face is there when its voxel is solid and the one before is not; it counts with its area, for
    seen aslant it is seen as well, and a ray stands for more of it the more aslant it comes.
    """
    voxel, walls, spans, steps = walk(start, direction)
    faces, shares = _facing(direction)
    sj_cells = (occupancy.shape[1] + cell_voxels - 1) // cell_voxels
    sk_cells = (occupancy.shape[2] + cell_voxels - 1) // cell_voxels
    t, through, passed, open_before, n, last = 0.0, 1.0, 0.0, 1.0, 0, -1
    for_face, entered = (-1, -1, -1), -1
    while t < reach and through > LEAST_ARRIVING:
        if inside(occupancy.shape, voxel):
            stops, passed = _stopping(occupancy[voxel], passed, ALIKE)
            if occupancy[voxel] > 0.0:
                new = unseen[voxel]
                if new > 0:
                    i, j, k = voxel
                    c = ((i // cell_voxels) * sj_cells + j // cell_voxels) * sk_cells + k // cell_voxels
                    if c != last:
                        last, for_face = c, (-1, -1, -1)
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
                            if at >= 0 and a == entered:
                                faces_there = occupancy[voxel] * open_before
                                area[at + slot] += through * faces_there * t * t / abs(direction[a]) * scale
                through *= 1.0 - stops
            open_before = 1.0 - occupancy[voxel]
        entered = next_axis(walls)
        voxel, t, walls = next_voxel(voxel, walls, spans, steps)
    return n


@nb.njit(cache=True)
def new_area(occupancy, unseen, cell_voxels):
    """(cells * FACES,) expected number of new faces in each cell, by direction."""
    si, sj, sk = occupancy.shape
    sj_cells, sk_cells = (sj + cell_voxels - 1) // cell_voxels, (sk + cell_voxels - 1) // cell_voxels
    total = np.zeros((si + cell_voxels - 1) // cell_voxels * sj_cells * sk_cells * FACES, np.float32)
    for i in range(si):
        for j in range(sj):
            for k in range(sk):
                if unseen[i, j, k] == 0:
                    continue
                c = ((i // cell_voxels) * sj_cells + j // cell_voxels) * sk_cells + k // cell_voxels
                for face in range(FACES):
                    if (unseen[i, j, k] >> face) & 1 == 1:
                        step = -1 if face % 2 == 0 else 1
                        beside = (i + step * (face // 2 == 0), j + step * (face // 2 == 1), k + step * (face // 2 == 2))
                        open_beside = 1.0 - occupancy[beside] if inside(occupancy.shape, beside) else 1.0
                        total[c * FACES + face] += occupancy[i, j, k] * open_beside
    return total


@nb.njit(cache=True, parallel=True)
def count_stops(occupancy, unseen, blocks, lower, upper, block_voxels, starts, directions, reach, cell_voxels):
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
            count[p, r] = _stops(occupancy, unseen, starts[p], directions[r], until[p, r], cell_voxels, 0.0,
                                 nothing[0], nothing[1], nothing[1], -1)
    return count, until


@nb.njit(cache=True, parallel=True)
def cast_stops(occupancy, unseen, starts, directions, until, cell_voxels, first, scale):
    """(cell's face, area, arrives) of every entry, in the slots that `count_stops` gave."""
    cell = np.zeros(first[-1], np.int32)
    area, arrives = np.zeros(first[-1], np.float32), np.zeros(first[-1], np.float32)
    for p in nb.prange(len(starts)):
        for r in range(len(directions)):
            at = first[p * len(directions) + r]
            if first[p * len(directions) + r + 1] > at:
                _stops(occupancy, unseen, starts[p], directions[r], until[p, r], cell_voxels, scale, cell, area,
                       arrives, at)
    return cell, area, arrives


@nb.njit(cache=True)
def _show_along(occupancy, shown, start, direction, reach, least, alike):
    """Set in `shown` the bits of the faces that a ray reaches with a probability of at least `least`; alike: as in
    `_stopping`."""
    voxel, walls, spans, steps = walk(start, direction)
    faces, shares = _facing(direction)
    bits = 0
    for a in range(3):
        if shares[a] > LEAST_SHARE:
            bits |= 1 << faces[a]
    t, through, passed = 0.0, 1.0, 0.0
    while t < reach and through >= least:
        if inside(occupancy.shape, voxel):
            stops, passed = _stopping(occupancy[voxel], passed, alike)
            if occupancy[voxel] > 0.0:
                shown[voxel] |= np.uint8(bits)
                through *= 1.0 - stops
        voxel, t, walls = next_voxel(voxel, walls, spans, steps)


@nb.njit(cache=True)
def show(occupancy, shown, start, directions, lower, upper, reach, least):
    """Set in `shown` the bits of the faces that rays reach with a probability of at least `least`, of all voxels that
    meet a box from lower to upper (3,)."""
    for r in range(len(directions)):
        enter, leave = box_span(start, directions[r], lower, upper)
        if enter < leave:
            _show_along(occupancy, shown, start, directions[r], min(reach, leave + 1.0), least, ALIKE)


@nb.njit(cache=True, parallel=True)
def show_from(occupancy, blocks, lower, upper, block_voxels, starts, directions, reach, least):
    """(SHARES, i, j, k) bits of the faces that rays from each share of the starts reach with a probability of at least
    `least`, were every voxel free or solid by itself: what lies behind much unknown space is not counted on. Of all
    voxels in marked blocks; blocks as in `count_stops`."""
    si, sj, sk = occupancy.shape
    shown_from = np.zeros((SHARES, si, sj, sk), np.uint8)
    for share in nb.prange(SHARES):
        for p in range(share, len(starts), SHARES):
            for r in range(len(directions)):
                last = _last_new(blocks, lower, upper, starts[p] / block_voxels, directions[r], reach / block_voxels)
                _show_along(occupancy, shown_from[share], starts[p], directions[r], min(reach, last * block_voxels),
                            least, 0.0)
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
def view_sums(first, cell, area, left, first_view, views, positions, orientations):
    """(p, o) `view_sum` of every view. views[first_view[r]:first_view[r + 1]] are the orientations that see ray r."""
    gains = np.zeros((positions, orientations))
    rays = len(first_view) - 1
    for p in nb.prange(positions):
        for r in range(rays):
            total = 0.0
            for e in range(first[p * rays + r], first[p * rays + r + 1]):
                total += area[e] * left[cell[e]]
            if total > 0.0:
                for at in range(first_view[r], first_view[r + 1]):
                    gains[p, views[at]] += total
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
