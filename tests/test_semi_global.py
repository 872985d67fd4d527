"""Semi-global matching: torch's is OpenCV's, and what a GPU would be asked is what the processor answers."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from perception import accelerator
from perception.reconstruct import torch_semi_global
from perception.reconstruct.semi_global import RectifiedPair, disparities


def rectified_pair(height_px: int, width_px: int, count: int, seed: int) -> RectifiedPair:
    """Noise seen twice: a wavy surface with a step in the middle, another sensor's noise on the right picture, a part
    that is flat and a part that repeats."""
    rng = np.random.default_rng(seed)
    wide = cv2.GaussianBlur(rng.integers(0, 256, (height_px, width_px + 60)).astype(np.float32), (0, 0), 1.5)
    wide = (wide - wide.min()) / np.ptp(wide) * 255.0
    wide[: height_px // 6] = 128.0
    wide[height_px // 6 : height_px // 3] = 128.0 + 90.0 * np.sin(np.arange(width_px + 60) * 0.9)
    step = np.where(np.arange(width_px) > width_px // 2, 8.0, 0.0)
    shift = 6.0 + 5.0 * np.sin(np.arange(height_px) / 7.0)[:, None] + step
    columns = (np.arange(width_px) + shift).astype(np.float32)
    rows = np.repeat(np.arange(height_px, dtype=np.float32)[:, None], width_px, axis=1)
    right = cv2.remap(wide, columns, rows, cv2.INTER_LINEAR) + rng.normal(0.0, 3.0, (height_px, width_px))
    return RectifiedPair(wide[:, :width_px].astype(np.uint8), np.clip(right, 0, 255).astype(np.uint8), count, 30)


PAIRS = [rectified_pair(70, 190, 48, 1), rectified_pair(41, 120, 32, 2), rectified_pair(131, 90, 16, 3)]


def test_torch_matches_as_opencv_does_to_the_bit_also_pairs_of_different_sizes_at_once() -> None:
    by_opencv, by_torch = disparities(PAIRS, ""), disparities(PAIRS, "cpu")
    for expected, found in zip(by_opencv, by_torch, strict=True):
        assert (expected >= 0).mean() > 0.4
        assert (expected < 0).mean() > 0.1
        np.testing.assert_array_equal(found, expected)


def test_pairs_that_do_not_fit_at_once_are_matched_one_after_the_other(monkeypatch: pytest.MonkeyPatch) -> None:
    together = disparities(PAIRS, "cpu")
    monkeypatch.setattr(torch_semi_global, "BATCH_CELLS", 1)
    for one, other in zip(together, disparities(PAIRS, "cpu"), strict=True):
        np.testing.assert_array_equal(one, other)


def test_without_a_driver_no_gpu_is_asked_for_and_torch_is_not_imported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(accelerator, "DRIVERS", ())
    monkeypatch.setattr("builtins.__import__", lambda name, *_: pytest.fail(f"imports {name}"))
    assert accelerator.torch_device.__wrapped__() == ""
