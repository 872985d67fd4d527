"""Material tiles: seeded, seamless pictures of a stated size in metres.

A tile gives a material its character at 2-5 mm per texel. The renderer multiplies stains of its own over it, so that no
two square metres look alike.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.fft
from numpy.typing import NDArray

Field = NDArray[np.float32]
Rgb = tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class Tile:
    """rgb: (n, n, 3) uint8, seamless; size_m: width and height of the tile on the surface."""

    rgb: NDArray[np.uint8]
    size_m: float


def noise(rng: np.random.Generator, n: int, exponent: float, first_cycle: int = 2, last_cycle: int = 0) -> Field:
    """(n, n) periodic noise of zero mean and unit variance with amplitude ~ 1 / frequency ** exponent.

    first_cycle, last_cycle: the range of frequencies in cycles per tile; lower ones would show the repetition. Without
    last_cycle it reaches to the texels.
    """
    last = min(last_cycle or n // 2, n // 2 - 1)
    fy = np.arange(-last, last + 1, dtype=np.float32)[:, None]
    fx = np.arange(last + 1, dtype=np.float32)
    frequency2 = np.maximum(fy * fy + fx * fx, np.float32(1.0))
    amplitude = np.exp(np.log(frequency2) * np.float32(-0.5 * exponent))
    amplitude[frequency2 < first_cycle * first_cycle] = 0.0
    white = rng.standard_normal((*amplitude.shape, 2), dtype=np.float32).view(np.complex64)[..., 0]
    white *= amplitude
    spectrum = np.zeros((n, n // 2 + 1), np.complex64)
    spectrum[: last + 1, : last + 1] = white[last:]
    spectrum[-last:, : last + 1] = white[:last]
    field = scipy.fft.irfft2(spectrum, s=(n, n), overwrite_x=True)
    field *= np.float32(1.0) / field[::2, ::2].std()
    return np.asarray(field, dtype=np.float32)


def concrete(rng: np.random.Generator, rgb: Rgb = (168, 164, 156)) -> Tile:
    """Board-marked concrete with pores and stains; 4.6 m at 3 mm."""
    n = 1536
    cloud, grain = noise(rng, n, 1.4, 2, 160), noise(rng, n, 0.35, 64)
    boards = (np.arange(n) // (n // 16)) % 16
    shade = rng.normal(0.0, 0.035, 16).astype(np.float32)[boards][:, None]
    seam = (np.arange(n) % (n // 16) < 3).astype(np.float32)[:, None]
    pores = (grain > 2.4).astype(np.float32)
    light = 1.0 + 0.08 * cloud + 0.06 * grain + shade - 0.22 * seam - 0.35 * pores
    return Tile(_tinted(light, rgb, 0.03 * cloud), n * 0.003)


def stone(rng: np.random.Generator, rgb: Rgb = (150, 138, 120)) -> Tile:
    """Coursed ashlar, blocks of differing length and shade; 3.8 m at 2.5 mm."""
    n, courses = 1536, 12
    block, edge = _masonry(rng, n, courses, (5, 8))
    light = 1.0 + 0.2 * rng.standard_normal(4096).astype(np.float32)[block % 4096]
    rough, grain = noise(rng, n, 1.0, 6, 200), noise(rng, n, 0.4, 80)
    light += 0.1 * rough + 0.06 * grain
    light = np.where(edge < 7, 0.62 + 0.05 * grain, light)
    warm = 0.045 * rng.standard_normal(4096).astype(np.float32)[(block * 7 + 3) % 4096]
    return Tile(_tinted(light, rgb, warm), n * 0.0025)


def brick(rng: np.random.Generator, rgb: Rgb = (158, 92, 70)) -> Tile:
    """Stretcher bond with mortar, each brick of its own shade; 3.1 m at 2 mm."""
    n, courses = 1536, 48
    block, edge = _masonry(rng, n, courses, (14, 14))
    light = 1.0 + 0.16 * rng.standard_normal(8192).astype(np.float32)[block % 8192]
    grain, cloud = noise(rng, n, 0.5, 50), noise(rng, n, 1.4, 2, 160)
    light += 0.07 * grain + 0.06 * cloud
    tile = _tinted(light, rgb, 0.08 * rng.standard_normal(8192).astype(np.float32)[(block * 5 + 1) % 8192])
    mortar = _tinted(1.0 + 0.08 * grain, (176, 168, 154), 0.0 * grain)
    return Tile(np.where((edge < 4)[..., None], mortar, tile), n * 0.002)


def plaster(rng: np.random.Generator, rgb: Rgb = (205, 186, 150)) -> Tile:
    """Lime plaster with blotches and fine cracks; 4.6 m at 3 mm."""
    n = 1536
    cloud, grain = noise(rng, n, 1.5, 2, 160), noise(rng, n, 0.5, 40)
    cracks = np.abs(noise(rng, n, 1.7, 3, 200)) < 0.012
    light = 1.0 + 0.1 * cloud + 0.06 * grain - 0.25 * cracks
    return Tile(_tinted(light, rgb, 0.05 * cloud), n * 0.003)


def painted_steel(rng: np.random.Generator, rgb: Rgb = (92, 120, 106)) -> Tile:
    """Old paint with dirt runs and rust spots; 3.1 m at 3 mm."""
    n = 1024
    cloud, grain = noise(rng, n, 1.3, 3), noise(rng, n, 0.5, 30)
    light = 1.0 + 0.13 * cloud + 0.05 * grain
    paint = _tinted(light, rgb, 0.0 * cloud)
    rust = _tinted(1.0 + 0.25 * grain, (122, 70, 40), 0.1 * cloud)
    spots = noise(rng, n, 1.1, 6) > 1.75
    return Tile(np.where(spots[..., None], rust, paint), n * 0.003)


def galvanised(rng: np.random.Generator, rgb: Rgb = (158, 162, 166)) -> Tile:
    """Zinc with spangle and white-rust streaks; 2 m at 2 mm."""
    n = 1024
    spangle = np.round(2.0 * noise(rng, n, 0.9, 24)) / 2.0
    streak = noise(rng, n, 1.3, 3)
    return Tile(_tinted(1.0 + 0.09 * spangle + 0.12 * streak, rgb, 0.03 * streak), n * 0.002)


def patina(rng: np.random.Generator, rgb: Rgb = (104, 146, 128)) -> Tile:
    """Weathered copper: verdigris over brown; 4.6 m at 3 mm."""
    n = 1536
    cloud, grain = noise(rng, n, 1.2, 3, 200), noise(rng, n, 0.5, 40)
    green = _tinted(1.0 + 0.12 * cloud + 0.1 * grain, rgb, 0.05 * cloud)
    brown = _tinted(1.0 + 0.2 * grain, (108, 88, 66), 0.1 * grain)
    worn = np.clip(1.6 * (noise(rng, n, 1.1, 4, 300) - 0.6), 0.0, 1.0)[..., None]
    return Tile((green * (1 - worn) + brown * worn).astype(np.uint8), n * 0.003)


def roof_tiles(rng: np.random.Generator, rgb: Rgb = (150, 84, 60)) -> Tile:
    """Rows of clay tiles; 4.1 m at 4 mm."""
    n, courses = 1024, 16
    block, edge = _masonry(rng, n, courses, (20, 20))
    light = 1.0 + 0.18 * rng.standard_normal(4096).astype(np.float32)[block % 4096] + 0.1 * noise(rng, n, 0.7, 10)
    fall = ((np.arange(n) % (n // courses)) / (n // courses)).astype(np.float32)[:, None]
    light = light * (1.1 - 0.3 * fall)
    return Tile(_tinted(np.where(edge < 3, 0.45 * light, light), rgb, 0.04 * noise(rng, n, 1.2, 3)), n * 0.004)


def window(rng: np.random.Generator, rgb: Rgb = (62, 72, 82)) -> Tile:
    """Dusty panes with a faint curtain behind; 2 m at 2 mm."""
    n = 1024
    folds = np.sin(2.0 * np.pi * np.arange(n) / n * 22 + 2.0 * noise(rng, n, 2.0, 2)).astype(np.float32)
    dust = noise(rng, n, 0.8, 8)
    return Tile(_tinted(1.0 + 0.2 * folds + 0.16 * dust, rgb, 0.05 * dust), n * 0.002)


def asphalt(rng: np.random.Generator, rgb: Rgb = (92, 92, 94)) -> Tile:
    """Worn asphalt with chippings and sealed cracks; 4.6 m at 3 mm."""
    n = 1536
    chips, cloud = noise(rng, n, 0.3, 90), noise(rng, n, 1.3, 2, 160)
    seal = np.abs(noise(rng, n, 1.8, 2, 200)) < 0.02
    return Tile(_tinted(1.0 + 0.2 * chips + 0.1 * cloud - 0.35 * seal, rgb, 0.02 * cloud), n * 0.003)


def grass(rng: np.random.Generator, rgb: Rgb = (98, 112, 62)) -> Tile:
    """Rough grass with bare patches; 10.2 m at 5 mm."""
    n = 2048
    blades, tufts, bare = noise(rng, n, 0.5, 60), noise(rng, n, 1.1, 4, 200), noise(rng, n, 1.2, 3, 160)
    green = _tinted(1.0 + 0.2 * blades + 0.16 * tufts, rgb, 0.1 * tufts)
    earth = _tinted(1.0 + 0.16 * blades + 0.1 * tufts, (136, 118, 88), 0.05 * tufts)
    return Tile(np.where((bare + 0.35 * blades > 1.1)[..., None], earth, green), n * 0.005)


def gravel(rng: np.random.Generator, rgb: Rgb = (150, 142, 130)) -> Tile:
    """Loose stones of 2-10 cm; 6.1 m at 4 mm."""
    n = 1536
    stones, grit, cloud = noise(rng, n, 1.0, 40, 400), noise(rng, n, 0.2, 200), noise(rng, n, 1.3, 2, 160)
    light = 1.0 + 0.2 * stones + 0.1 * grit + 0.08 * cloud - 0.25 * (stones < -1.2)
    return Tile(_tinted(light, rgb, 0.07 * np.roll(stones, n // 3, axis=0)), n * 0.004)


def bark(rng: np.random.Generator, rgb: Rgb = (94, 78, 62)) -> Tile:
    """Bark; 2 m at 4 mm."""
    n = 512
    ridges = noise(rng, n, 0.8, 12)
    return Tile(_tinted(1.0 + 0.25 * ridges, rgb, 0.04 * ridges), n * 0.004)


def foliage(rng: np.random.Generator, rgb: Rgb = (70, 96, 46)) -> Tile:
    """Leaves in light and shade; 4.1 m at 4 mm."""
    n = 1024
    leaves, clumps = noise(rng, n, 0.7, 24), noise(rng, n, 1.2, 4)
    return Tile(_tinted(1.0 + 0.32 * leaves + 0.15 * clumps, rgb, 0.12 * leaves), n * 0.004)


def rock(rng: np.random.Generator, rgb: Rgb = (132, 128, 122)) -> Tile:
    """Bare rock with lichen; 4.1 m at 4 mm."""
    n = 1024
    face, grain = noise(rng, n, 1.1, 3), noise(rng, n, 0.4, 40)
    return Tile(_tinted(1.0 + 0.18 * face + 0.1 * grain, rgb, 0.1 * noise(rng, n, 1.1, 5)), n * 0.004)


def _tinted(light: Field, rgb: Rgb, warm: Field) -> NDArray[np.uint8]:
    """A colour under varying light; warm shifts from blue to red."""
    red, green, blue = (np.float32(c) for c in rgb)
    channels = (light * (1.0 + warm) * red, light * green, light * (1.0 - warm) * blue)
    tile = np.zeros((*light.shape, 3), np.uint8)
    for i, channel in enumerate(channels):
        tile[..., i] = np.clip(channel, 0.0, 255.0)
    return tile


def _masonry(rng: np.random.Generator, n: int, courses: int,
             blocks: tuple[int, int]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Per texel of an (n, n) tile: the number of its block, and the distance to the block's edge in texels.

    blocks: least and greatest number of blocks in a course. Equal numbers give a regular half-offset bond.
    """
    height = n // courses
    row, x = np.arange(n) // height, np.arange(n)
    number, across = np.zeros((courses, n), np.int64), np.zeros((courses, n), np.int64)
    for course in range(courses):
        count = int(rng.integers(blocks[0], blocks[1] + 1))
        jitter = 0.0 if blocks[0] == blocks[1] else 0.25
        joints = (np.arange(count) + jitter * rng.uniform(-1, 1, count) + 0.5 * (course % 2)) * n / count
        wrapped = np.sort(joints % n).astype(np.int64)
        index = np.searchsorted(wrapped, x, side="right") % count
        number[course] = course * 131 + index
        gap = np.abs(x[:, None] - wrapped)
        across[course] = np.minimum(gap, n - gap).min(axis=1)
    along = np.arange(n) % height
    return number[row], np.minimum(across[row], np.minimum(along, height - 1 - along)[:, None])
