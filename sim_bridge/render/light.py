"""Sun, sky and surface grain: what both renderers sample, made once in numpy."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from missions.simulation import RenderSpec

Floats = NDArray[np.float32]
Bytes = NDArray[np.uint8]

GRAIN_SIZE = 128
GRAIN_PERIODS_M = (0.43, 9.1)
"""Edge lengths of the two copies of the grain volume: octaves from 7 mm to 0.4 m and from 14 cm to 9 m."""
GRAIN_WEIGHTS = (0.75, 0.75)
GRAIN_TEXTURED, GRAIN_PROCEDURAL = 0.30, 0.48
"""Strength of the grain on surfaces that bring a picture of their own, and on those that do not."""
GRAIN_LUMA, GRAIN_HUE, GRAIN_FLOOR = 4.0, (1.3, 0.2, -1.5), 0.12
"""Gain of the first channel on brightness and of the second on colour; albedo keeps at least the floor's share."""

SKY_SIZE = 1024
SKY_LOWEST = -0.05
"""The sky map reaches down to this sine of elevation, so that it can be interpolated at the horizon."""
LAND_COLOR = (0.40, 0.43, 0.25)
LAND_PERIODS_M = (19.0, 230.0)
LAND_GRAIN = (1.2, 1.9)
LAND_HUE = (0.25, 0.0, -0.2)
"""The plain between the scene's own ground and the horizon: display colour, sizes and strengths of its pattern."""
HAZE_M = 900.0
"""Distance at which haze leaves 1/e of the plain's own colour; the scene itself is near and has none."""

WATER_COLOR = (0.22, 0.30, 0.27)
"""What comes out of the water, display colour; the rest is the sky, mirrored."""
WATER_MIRROR = 0.02
"""Share of light that water throws back when looked at straight on; Schlick (1994) gives it for other angles."""
WAVE_PERIODS_M = (2.3, 11.0)
WAVE_SLOPES = (0.34, 0.22)
"""Sizes of the two copies of the grain that tilt the water, and how much they do."""

EXPOSURE = 1.25
"""Display = sqrt(1 - exp(-EXPOSURE * radiance)): white in full sun keeps its texture instead of clipping."""
SUN_COLOR = (1.15, 1.08, 0.96)
SKY_AMBIENT = (0.34, 0.39, 0.48)
GROUND_AMBIENT = (0.17, 0.16, 0.135)
AMBIENT_TURN = 0.25
"""Ambient light varies by this share with the angle to the sun, so that shaded surfaces keep their relief."""


@dataclass(frozen=True)
class Light:
    """Everything that shades a picture besides the surfaces.

    to_sun_enu: unit (3,). sky: (SKY_SIZE, SKY_SIZE, 3) uint8 equal-area map centred on the zenith, East right, North up
    in array order. grain: (GRAIN_SIZE,) * 3 + (2,) uint8, tileable. grain_from_enu: (2, 3, 3) rotation per scale.
    """

    to_sun_enu: NDArray[np.float64]
    sky: Bytes
    grain: Bytes
    grain_from_enu: Floats


@functools.lru_cache(maxsize=2)
def make_light(spec: RenderSpec, seed: int) -> Light:
    """Sun, sky and grain of a mission; the same seed gives the same bytes."""
    rng = np.random.default_rng([seed, 0x11647])
    to_sun = sun_direction(spec)
    rotations = np.stack([np.linalg.qr(rng.standard_normal((3, 3)))[0] for _ in GRAIN_PERIODS_M])
    return Light(to_sun, _sky(to_sun, rng), _grain(rng), rotations.astype(np.float32))


def sun_direction(spec: RenderSpec) -> NDArray[np.float64]:
    """(3,) unit vector towards the sun, ENU."""
    azimuth, elevation = math.radians(spec.sun_azimuth_deg), math.radians(spec.sun_elevation_deg)
    horizontal = math.cos(elevation)
    return np.array([horizontal * math.sin(azimuth), horizontal * math.cos(azimuth), math.sin(elevation)])


def wave_drift(seed: int, noise_key: int) -> Floats:
    """(2, 3) where in the grain the waves of picture noise_key lie, in periods: waves of two pictures have nothing in
    common, as those of pictures taken seconds apart."""
    rng = np.random.default_rng([seed, 0x3A7E5, noise_key & (2**64 - 1)])
    return rng.random((len(WAVE_PERIODS_M), 3), np.float32)


def fractal_noise(shape: tuple[int, ...], rng: np.random.Generator, slope: float) -> Floats:
    """Tileable noise of zero mean and unit variance whose amplitude falls with frequency to the power -slope."""
    axes = [np.fft.fftfreq(n) for n in shape[:-1]] + [np.fft.rfftfreq(shape[-1])]
    squares = np.meshgrid(*[a**2 for a in axes], indexing="ij", sparse=True)
    radius = np.sqrt(np.asarray(sum(squares)))
    radius.flat[0] = np.inf
    spectrum = np.fft.rfftn(rng.standard_normal(shape)) * radius**-slope
    noise = np.fft.irfftn(spectrum, s=shape, axes=range(len(shape)))
    return np.asarray(noise / noise.std(), np.float32)


def _grain(rng: np.random.Generator) -> Bytes:
    """Two channels with equal energy per octave, sharpened so that stains have edges for features to hold on to."""
    channels = []
    for _ in range(2):
        smooth = fractal_noise((GRAIN_SIZE,) * 3, rng, 1.4)
        edged = 0.55 * smooth + 0.6 * np.tanh(5.0 * fractal_noise((GRAIN_SIZE,) * 3, rng, 1.5))
        channels.append(np.clip(128 + 46 * edged, 0, 255).astype(np.uint8))
    return np.stack(channels, axis=-1)


def _sky(to_sun: NDArray[np.float64], rng: np.random.Generator) -> Bytes:
    """Blue gradient, glow around the sun, fair-weather clouds on a plane overhead."""
    direction = _sky_directions()
    up = direction[..., 2]
    zenith, horizon = np.array([0.24, 0.45, 0.78]), np.array([0.72, 0.82, 0.92])
    color = horizon + (zenith - horizon) * (1 - np.exp(-4 * np.clip(up, 0, 1)))[..., None]
    cosine = np.clip(direction @ to_sun, 0, 1)
    color = color + np.array([0.30, 0.27, 0.20]) * (cosine**12 + 0.8 * cosine**200)[..., None]
    cloud = _clouds(direction, rng)[..., None]
    color = color * (1 - cloud) + np.array([0.96, 0.96, 0.97]) * cloud
    return np.asarray(np.clip(color * 255 + 0.5, 0, 255), dtype=np.uint8)


def _sky_directions() -> NDArray[np.float64]:
    """(SKY_SIZE, SKY_SIZE, 3) unit directions of the map's texels (inverse Lambert equal-area projection)."""
    s = (np.arange(SKY_SIZE) + 0.5) / SKY_SIZE * 2 - 1
    x, y = np.meshgrid(s, s)
    radius2 = (x**2 + y**2) * (1 - SKY_LOWEST)
    up = np.clip(1 - radius2, -1, 1)
    scale = np.sqrt((1 - SKY_LOWEST) * np.clip(2 - radius2, 0, None))
    return np.stack([x * scale, y * scale, up], axis=-1)


def _clouds(direction: NDArray[np.float64], rng: np.random.Generator) -> Floats:
    noise = fractal_noise((1024, 1024), rng, 1.55)
    plane = direction[..., :2] / (np.clip(direction[..., 2:], 0, 1) + 0.12) * 150.0
    u, v = plane[..., 0].astype(np.float32) % 1024, plane[..., 1].astype(np.float32) % 1024
    sampled = cv2.remap(noise, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
    fade = np.clip(direction[..., 2] / 0.12, 0, 1)
    return np.asarray(np.clip((sampled - 0.25) * 0.9, 0, 0.9) * fade, dtype=np.float32)


def developed(radiance: NDArray[np.floating]) -> Floats:
    """Display values 0-1 of a radiance, by the film curve that the shaders use too."""
    return np.asarray(np.sqrt(1 - np.exp(-EXPOSURE * radiance)), np.float32)


def land_irradiance(to_sun: NDArray[np.float64]) -> NDArray[np.float64]:
    """(3,) light on unshaded level ground."""
    up = float(to_sun[2])
    return np.array(SUN_COLOR) * up + np.array(SKY_AMBIENT) * (1 - AMBIENT_TURN * up)


def sky_map_scale() -> float:
    """Map coordinate in [-1, 1] = direction.xy * this / sqrt(1 + direction.z)."""
    return 1.0 / math.sqrt(1.0 - SKY_LOWEST)
