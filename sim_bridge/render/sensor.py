"""From an ideal picture to a file: sensor noise and JPEG."""

from __future__ import annotations

import cv2
import numpy as np

from sim_bridge.render.light import Bytes

_TAPE_BYTES = 1 << 22
_CHUNK_BYTES = 1 << 19


class SensorNoise:
    """Gaussian noise cut from a tape made once; every picture reads the tape at offsets of its own."""

    def __init__(self, sigma_dn: float, seed: int) -> None:
        """sigma_dn: standard deviation in 8-bit steps."""
        self._seed, self._sigma_dn = seed, sigma_dn
        if sigma_dn > 0:
            rng = np.random.default_rng([seed, 0x5E1150])
            tape = np.rint(sigma_dn * rng.standard_normal(_TAPE_BYTES, dtype=np.float32))
            self._more = np.clip(tape, 0, 255).astype(np.uint8)
            self._less = np.clip(-tape, 0, 255).astype(np.uint8)

    def add_to(self, rgb: Bytes, noise_key: int) -> None:
        """Add the noise of picture noise_key to a contiguous (h, w, 3) picture, in place, saturating."""
        if self._sigma_dn <= 0:
            return
        flat = rgb.reshape(-1)
        rng = np.random.default_rng([self._seed, noise_key & (2**64 - 1)])
        offsets = rng.integers(0, _TAPE_BYTES - _CHUNK_BYTES, -(-len(flat) // _CHUNK_BYTES))
        for start, offset in zip(range(0, len(flat), _CHUNK_BYTES), offsets, strict=True):
            chunk = flat[start:start + _CHUNK_BYTES]
            noise = slice(offset, offset + len(chunk))
            cv2.add(chunk, self._more[noise], dst=chunk)
            cv2.subtract(chunk, self._less[noise], dst=chunk)


def encode_jpeg(rgb: Bytes, quality: int) -> bytes:
    """JPEG bytes of a (h, w, 3) RGB picture."""
    ok, data = cv2.imencode(".jpg", cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, quality])
    if not ok:
        raise ValueError(f"a picture of shape {rgb.shape} cannot be encoded as JPEG")
    return bytes(data)
