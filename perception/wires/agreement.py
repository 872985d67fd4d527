"""Where in space the lines of several pictures meet.

A line in one picture and one in another, each with its direction, are two planes through the cameras, which meet in a
line in space: a supposition. It is true where further pictures have a line in the place and direction in which they
would see it. Matching of lines by such support: Hofer et al., CVIU 2017 (Line3D++).
"""

from __future__ import annotations

import math

import numpy as np

from missions.frames import Array
from perception.depth.compiled import compiled
from perception.wires.lookup import CELL_PX, Seen, nearest

TURN_COS = math.cos(math.radians(10.0))
"""Lines run in the same direction in a picture."""
CROSSING_SIN = math.sin(math.radians(15.0))
"""A line is matched where its epipolar line crosses it by more than this."""
PLANES_SIN = math.sin(math.radians(4.0))
"""Angle between the planes of two pictures from which their line in space is told."""
FARTHER = 1.3
"""A picture that sees the place from no farther than this many times as the first one ought to show the line, too."""
END_ON = 0.3
"""A line that a picture sees shorter than this share of its length is not looked for there."""
BORDER_PX = 8.0
LEAST_DEPTH_M = 1.0
ROUNDS = 2
SUPPOSED = 256
"""Suppositions weighed for a sample, at most."""
LEAST_VOTES = 4
FIRST, FIRST_VOTES = 16, 3
"""A supposition is dropped that has fewer votes than this, its own included, when so many pictures were asked."""


@compiled
def agree(near_far_m: Array, planes: Array, rays: Array, centre: Array, focal_px: float, seen: Seen,
          finders: int, out: Array) -> None:
    """For each sample of a picture the line in space that most other pictures have.

    near_far_m: (n, 2) depths to search along rays (n, 3, per metre of depth); planes (n, 3): unit normals of
    the planes through camera and line; centre (3,) of the camera. seen: the other pictures, of which the first
    `finders` are those whose lines are tried.
    out (n, 9): place, direction, pictures that agree (0: none found), share of those that ought to, and standard
    deviation (m) of the place per pixel across the line where it is told worst.
    """
    supposed = np.empty((SUPPOSED, 6))
    told = np.empty((len(seen.starts), 5))
    guess = np.empty(7)
    for s in range(len(rays)):
        out[s, 6] = 0.0
        near, far = near_far_m[s, 0], near_far_m[s, 1]
        count = 0
        for j in range(finders):
            if near < far:
                count = _suppose(rays[s], planes[s], centre, near, far, seen, j, supposed, count)
        for c in range(count):
            guess[:6] = supposed[c]
            votes, share = 0, 0.0
            for _ in range(ROUNDS):
                votes, share = _support(guess, planes[s], centre, seen, told)
                if votes < LEAST_VOTES or votes <= out[s, 6]:
                    break
                _refine(guess, told, votes, focal_px)
            if votes >= LEAST_VOTES and votes > out[s, 6]:
                out[s, :6], out[s, 6], out[s, 7], out[s, 8] = guess[:6], votes, share, guess[6]


@compiled
def _suppose(ray: Array, plane: Array, centre: Array, near: float, far: float, seen: Seen, j: int, supposed: Array,
             count: int) -> int:
    """Walks along the epipolar line of a ray in picture j; each line that crosses it there is a supposition."""
    rotation, other, m = seen.rotations[j], seen.centres[j], seen.matrices[j]
    a, b = rotation @ (centre + near * ray - other), rotation @ (centre + far * ray - other)
    if a[2] < LEAST_DEPTH_M and b[2] < LEAST_DEPTH_M:
        return count
    if a[2] < LEAST_DEPTH_M:
        a = b + (a - b) * ((b[2] - LEAST_DEPTH_M) / (b[2] - a[2]))
    elif b[2] < LEAST_DEPTH_M:
        b = a + (b - a) * ((a[2] - LEAST_DEPTH_M) / (a[2] - b[2]))
    ax, ay = a[0] / a[2] * m[0] + m[2], a[1] / a[2] * m[1] + m[3]
    bx, by = b[0] / b[2] * m[0] + m[2], b[1] / b[2] * m[1] + m[3]
    length = np.hypot(bx - ax, by - ay)
    if length < CELL_PX:
        return count
    ex, ey = (bx - ax) / length, (by - ay) / length
    t, end = _inside(ax, ay, ex, ey, length, m[4], m[5])
    columns, base, cell_base, last = seen.columns[j], seen.starts[j], seen.cells[j], -1
    while t <= end:
        cell = cell_base + int((ay + t * ey) // CELL_PX) * columns + int((ax + t * ex) // CELL_PX)
        for k in range(base + seen.first[cell], base + seen.first[cell + 1]):
            crossing = abs(seen.direction[k, 0] * ey - seen.direction[k, 1] * ex)
            if seen.chain[k] == last or crossing < CROSSING_SIN or count >= len(supposed):
                continue
            last = seen.chain[k]
            count += _meet(ray, plane, centre, near, far, seen.normal[k], other, supposed[count])
        t += 0.5 * CELL_PX
    return count


@compiled
def _inside(ax: float, ay: float, ex: float, ey: float, length: float, width: float,
            height: float) -> tuple[float, float]:
    """The part of a way in the picture's plane that lies within the picture."""
    begin, end = 0.0, length
    for p, d, limit in ((ax, ex, width), (ay, ey, height)):
        if abs(d) < 1e-9:
            if p < 0.0 or p >= limit:
                return 1.0, 0.0
        else:
            low, high = (1e-3 - p) / d, (limit - 1e-3 - p) / d
            begin, end = max(begin, min(low, high)), min(end, max(low, high))
    return begin, end


@compiled
def _meet(ray: Array, plane: Array, centre: Array, near: float, far: float, normal: Array, other: Array,
          supposed: Array) -> int:
    """Writes the line in which two planes meet, and the place where a ray of the first one meets the second; 1 if it
    lies between near and far."""
    lx = plane[1] * normal[2] - plane[2] * normal[1]
    ly = plane[2] * normal[0] - plane[0] * normal[2]
    lz = plane[0] * normal[1] - plane[1] * normal[0]
    sine = np.sqrt(lx * lx + ly * ly + lz * lz)
    slant, height = 0.0, 0.0
    for a in range(3):
        slant += normal[a] * ray[a]
        height += normal[a] * (other[a] - centre[a])
    if sine < PLANES_SIN or abs(slant) < 1e-6 or not near <= height / slant <= far:
        return 0
    for a in range(3):
        supposed[a] = centre[a] + height / slant * ray[a]
    supposed[3], supposed[4], supposed[5] = lx / sine, ly / sine, lz / sine
    return 1


@compiled
def _support(guess: Array, plane: Array, centre: Array, seen: Seen, told: Array) -> tuple[int, float]:
    """Pictures that have a line where a supposed one would be, and their share among those that ought to.

    Writes into told, for each: the plane (3), its distance from the origin and the camera's from the place.
    """
    x, y, z, lx, ly, lz = guess[0], guess[1], guess[2], guess[3], guess[4], guess[5]
    own_m = np.sqrt((x - centre[0]) ** 2 + (y - centre[1]) ** 2 + (z - centre[2]) ** 2)
    told[0, :3], told[0, 3], told[0, 4] = plane, plane @ centre, own_m
    votes, close_votes, ought, asked = 1, 1, 1, 0
    for j in range(len(seen.centres)):
        r, c, m = seen.rotations[j], seen.centres[j], seen.matrices[j]
        ox, oy, oz = x - c[0], y - c[1], z - c[2]
        depth = r[2, 0] * ox + r[2, 1] * oy + r[2, 2] * oz
        if depth < LEAST_DEPTH_M:
            continue
        u = (r[0, 0] * ox + r[0, 1] * oy + r[0, 2] * oz) / depth
        v = (r[1, 0] * ox + r[1, 1] * oy + r[1, 2] * oz) / depth
        px, py = u * m[0] + m[2], v * m[1] + m[3]
        if px < BORDER_PX or py < BORDER_PX or px > m[4] - BORDER_PX or py > m[5] - BORDER_PX:
            continue
        ahead = r[2, 0] * lx + r[2, 1] * ly + r[2, 2] * lz
        dx = (r[0, 0] * lx + r[0, 1] * ly + r[0, 2] * lz - u * ahead) * m[0]
        dy = (r[1, 0] * lx + r[1, 1] * ly + r[1, 2] * lz - v * ahead) * m[1]
        size = np.sqrt(dx * dx + dy * dy)
        if size < END_ON * m[0]:
            continue
        close = depth * np.sqrt(1.0 + u * u + v * v) <= FARTHER * own_m
        ought += 1 if close else 0
        asked += 1
        if asked == FIRST and votes < FIRST_VOTES:
            break
        k = nearest(seen, j, px, py, dx / size, dy / size, TURN_COS)
        if k < 0:
            continue
        close_votes += 1 if close else 0
        for a in range(3):
            told[votes, a] = seen.normal[k, a]
        told[votes, 3] = seen.normal[k, 0] * c[0] + seen.normal[k, 1] * c[1] + seen.normal[k, 2] * c[2]
        told[votes, 4] = depth
        votes += 1
    return votes, close_votes / ought


@compiled
def _refine(guess: Array, told: Array, count: int, focal_px: float) -> None:
    """Changes a line to the one nearest to all planes, weighted by distance: direction first, then the place across it.

    guess[6] becomes the standard deviation (m) of the place in its worse direction per pixel of error.
    """
    moment = np.zeros((3, 3))
    for k in range(count):
        for a in range(3):
            for b in range(3):
                moment[a, b] += told[k, a] * told[k, b]
    line = np.linalg.eigh(moment)[1][:, 0].copy()
    first = np.cross(line, np.array([1.0, 0.0, 0.0]) if abs(line[0]) < 0.7 else np.array([0.0, 1.0, 0.0]))
    first /= np.sqrt(first @ first)
    second = np.cross(line, first)
    aa, ab, bb, ar, br = 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(count):
        p, q, rest = 0.0, 0.0, told[k, 3]
        for a in range(3):
            p, q, rest = p + told[k, a] * first[a], q + told[k, a] * second[a], rest - told[k, a] * guess[a]
        pixels = focal_px / told[k, 4]
        # what is far off may be another line: least absolute deviations beyond a pixel
        weight = pixels * pixels / max(1.0, abs(rest) * pixels)
        aa, ab, bb = aa + weight * p * p, ab + weight * p * q, bb + weight * q * q
        ar, br = ar + weight * p * rest, br + weight * q * rest
    determinant = aa * bb - ab * ab
    least = 0.5 * (aa + bb) - np.sqrt(0.25 * (aa - bb) ** 2 + ab * ab)
    guess[6] = np.inf
    if least <= 0.0 or determinant <= 0.0:
        return
    x, y = (bb * ar - ab * br) / determinant, (aa * br - ab * ar) / determinant
    for a in range(3):
        guess[a] += x * first[a] + y * second[a]
        guess[3 + a] = line[a]
    guess[6] = 1.0 / np.sqrt(least)
