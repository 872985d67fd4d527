"""Every sort of file that lies in a folder of photographs is read, or left out with a reason."""

from __future__ import annotations

import os
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile
from PIL import Image

from perception.photographs.metadata import _focal_px
from perception.photographs.photograph import photographs_in, read_pixels
from tests.reconstruct_scene import looking_at, photograph, wall_and_box
from tests.test_photographs import with_exif


@pytest.fixture(scope="module")
def picture() -> np.ndarray:
    """RGB"""
    return np.ascontiguousarray(photograph(wall_and_box(), looking_at((0.0, -5.0, 3.0), (0.0, 0.0, 3.0)))[..., ::-1])


@pytest.mark.parametrize(("film_mm", "focal_px"), [(None, 500.0), (24, 24 / 43.27 * np.hypot(640, 360))])
def test_exif_of_a_picture_that_was_made_smaller(film_mm: int | None, focal_px: float) -> None:
    """Pixels that EXIF tells are those of the picture that was taken."""
    exif = {0xA002: 2560, 0xA003: 1440, 0x920A: 10.0, 0xA20E: 200.0, 0xA210: 4}
    full = _focal_px({**exif, 0xA405: film_mm or 0}, {"CalibratedFocalLength": "7000"}, 2560, 1440)
    small = _focal_px({**exif, 0xA405: film_mm or 0}, {}, 640, 360)
    assert full == (7000.0 if film_mm is None else pytest.approx(4 * focal_px, rel=1e-3))
    assert small == pytest.approx(focal_px, rel=1e-3)


def as_file(kind: str, path: Path, rgb: np.ndarray) -> None:
    """The picture in another format, or what remains of it."""
    picture = Image.fromarray(rgb)
    if kind in ("grey", "CMYK", "palette"):
        picture.convert({"grey": "L", "CMYK": "CMYK", "palette": "P"}[kind], palette=Image.Palette.ADAPTIVE).save(path)
    elif kind == "MPO":
        picture.save(path, format="MPO", save_all=True, append_images=[picture.resize((160, 90))])
    elif kind in ("16 bit", "12 of 16 bit", "float"):
        deep = {"16 bit": rgb.astype(np.uint16) * 257, "12 of 16 bit": rgb[..., 1].astype(np.uint16) * 16,
                "float": rgb.astype(np.float32) / 255.0}[kind]
        tifffile.imwrite(path, deep, photometric="rgb" if deep.ndim == 3 else "minisblack")
    elif kind == "PNG by another name":
        picture.save(path, format="PNG")
    else:
        picture.save(path, format="JPEG")
        jpeg = path.read_bytes()
        exif = bytearray(with_exif(jpeg, np.zeros(3), 24))
        exif[20:60] = bytes(40)
        path.write_bytes({"cut off": jpeg[:-400], "garbage": b"x" * 2000, "bad EXIF": bytes(exif),
                          "bad XMP": with_exif(jpeg, None, xmp="<x:xmpmeta><")}[kind])


@pytest.mark.parametrize(("kind", "name", "why"), [
    ("grey", "a.jpg", ""), ("CMYK", "a.jpg", ""), ("palette", "a.png", ""), ("MPO", "a.JPG", ""),
    ("16 bit", "a.tif", ""), ("12 of 16 bit", "a.tif", ""), ("float", "a.tiff", ""), ("bad XMP", "a.jpg", ""),
    ("PNG by another name", "a.jpg", ""), ("bad EXIF", "a.jpg", ""),
    ("cut off", "a.jpg", "cannot be read: image file is truncated"),
    ("garbage", "a.jpg", "cannot be read: not a picture"),
])
def test_every_sort_of_file_is_read_or_refused(kind: str, name: str, why: str, picture: np.ndarray,
                                               tmp_path: Path) -> None:
    as_file(kind, tmp_path / name, picture)
    (found,) = photographs_in(tmp_path, 1)
    assert found.fault.startswith(why)
    assert bool(found.fault) == bool(why)
    if not why:
        grey = cv2.cvtColor(read_pixels(found), cv2.COLOR_BGR2GRAY).astype(float)
        assert np.corrcoef(grey.ravel(), cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY).ravel())[0, 1] > 0.85
        assert found.look is not None
        assert found.look.brightness == pytest.approx(grey.mean(), abs=3.0)


def test_names_that_are_not_unicode_are_told_all_the_same(picture: np.ndarray, tmp_path: Path) -> None:
    Image.fromarray(picture).save(tmp_path / "a.jpg")
    os.rename(tmp_path / "a.jpg", os.fsencode(tmp_path) + b"/\xff.jpg")
    (found,) = photographs_in(tmp_path, 1)
    assert (found.name, found.fault) == ("\ufffd.jpg", "")
