"""Pictures arrive whole or are asked for again; what is on disk is what was sent, with EXIF around it."""

from __future__ import annotations

import csv
import hashlib
import io
import math
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from ground_station.ingest import ASK_AGAIN_S, Ingest, Reassembly, decode_rgb
from missions.camera import Camera, Pose
from missions.clock import SECOND_NS
from missions.errors import ProtocolError
from missions.frames import Site
from missions.messages import PictureAck, PictureChunk, PictureMeta
from missions.run_folder import VIEW_COLUMNS, RunFolder
from perception.lens import redrawn

CAMERA = Camera.from_diagonal_fov(48, 32, 84.0)
SITE = Site(52.2205, -6.8861, 40.0)
SOI = b"\xff\xd8"
HOMES = [(0.0, 0.0, 0.1), (2.0, 0.0, 0.15)]


def meta_of(jpeg: bytes, view_id: int = 5, phase: str = "explore") -> PictureMeta:
    return PictureMeta(vehicle_id=2, view_id=view_id, phase=phase, t_capture_ns=12_345_000_000,
                       pose=Pose((10.0, -20.0, 15.5), 0.7, -0.2), position_sigma_m=0.02, speed_m_s=1.5, camera=CAMERA,
                       sha256=hashlib.sha256(jpeg).hexdigest(), size_bytes=len(jpeg))


def chunks_of(jpeg: bytes, size: int, **kw: int) -> list[PictureChunk]:
    pieces = [jpeg[i:i + size] for i in range(0, len(jpeg), size)]
    return [PictureChunk(meta=meta_of(jpeg, **kw), index=i, count=len(pieces), data=p) for i, p in enumerate(pieces)]


def a_jpeg() -> bytes:
    pixels = np.random.default_rng(3).integers(0, 255, (32, 48, 3), dtype=np.uint8)
    return bytes(cv2.imencode(".jpg", pixels)[1])


@settings(max_examples=200)
@given(st.binary(min_size=1, max_size=300), st.integers(1, 50), st.randoms(), st.floats(0.0, 0.7), st.floats(0.0, 0.5))
def test_any_order_loss_and_duplication_gives_the_picture_or_a_request(
        body: bytes, size: int, rng: np.random.Generator, loss: float, twice: float) -> None:
    jpeg = SOI + body
    chunks = chunks_of(jpeg, size)
    sent = [c for c in chunks for _ in range(2 if rng.random() < twice else 1) if rng.random() >= loss]
    rng.shuffle(sent)
    reassembly, t_ns, whole = Reassembly(), 0, []
    for _ in range(len(chunks) + 1):
        for chunk in sent:
            result = reassembly.add(2, chunk, t_ns)
            if isinstance(result, tuple):
                whole.append(result)
        t_ns += round(ASK_AGAIN_S * SECOND_NS)
        asked = reassembly.overdue(t_ns)
        if not asked:
            break
        assert len(asked) == 1
        assert set(asked[0][1].missing) == set(range(len(chunks))) - {c.index for c in sent} or whole == []
        sent = [chunks[i] for i in asked[0][1].missing[: max(1, len(asked[0][1].missing) // 2)]]
    heard_of_it = bool(sent) or bool(whole)
    assert [data for _, data in whole] == ([jpeg] if heard_of_it else [])
    assert reassembly.unfinished == 0


@given(st.binary(min_size=4, max_size=200), st.integers(0, 10**6), st.integers(1, 255))
def test_a_flipped_byte_never_becomes_a_picture(body: bytes, where: int, flip: int) -> None:
    jpeg = SOI + body
    bad = [*chunks_of(jpeg, 16)]
    k = where % len(bad)
    data = bytearray(bad[k].data)
    data[where % len(data)] ^= flip
    bad[k] = PictureChunk(meta=bad[k].meta, index=k, count=bad[k].count, data=bytes(data))
    reassembly = Reassembly()
    assert [reassembly.add(2, c, 0) for c in bad] == [None] * len(bad)
    [(vehicle, request)] = reassembly.overdue(0)
    assert (vehicle, request.missing) == (2, list(range(len(bad))))
    results = [reassembly.add(2, c, 0) for c in chunks_of(jpeg, 16)]
    assert isinstance(results[-1], tuple)
    assert results[-1][1] == jpeg


def test_chunks_that_contradict_are_refused() -> None:
    jpeg = a_jpeg()
    good = chunks_of(jpeg, 400)
    reassembly = Reassembly()
    with pytest.raises(ProtocolError, match="vehicle 1 sent a picture of vehicle 2"):
        reassembly.add(1, good[0], 0)
    with pytest.raises(ProtocolError, match="chunk 9 of"):
        reassembly.add(2, PictureChunk(meta=good[0].meta, index=9, count=3, data=b"x"), 0)
    with pytest.raises(ProtocolError, match="phase"):
        reassembly.add(2, PictureChunk(meta=meta_of(jpeg, phase="../../x"), index=0, count=1, data=jpeg), 0)
    reassembly.add(2, good[0], 0)
    with pytest.raises(ProtocolError, match="disagree"):
        reassembly.add(2, PictureChunk(meta=good[0].meta, index=0, count=len(good) + 1, data=b"x"), 0)


def test_on_disk_before_acknowledged_pixels_untouched_with_exif_and_row(tmp_path: Path) -> None:
    jpeg, run = a_jpeg(), RunFolder(tmp_path)
    ingest = Ingest(run, SITE, "2026-06-01T10:00:00Z", HOMES)
    *first, last = chunks_of(jpeg, 500)
    assert [ingest.receive(2, c, 0) for c in first] == [(None, None)] * len(first)
    ack, picture = ingest.receive(2, last, 0)
    assert ack == PictureAck(view_id=5, sha256=meta_of(jpeg).sha256)
    stored = run.picture(2, 5).read_bytes()
    assert stored.startswith(SOI)
    assert stored.endswith(jpeg[2:])
    assert picture is not None
    assert np.array_equal(np.array(Image.open(io.BytesIO(stored))), np.array(Image.open(io.BytesIO(jpeg))))
    assert picture.rgb is not None
    assert np.abs(picture.rgb.astype(int) - np.array(Image.open(io.BytesIO(jpeg))).astype(int)).max() <= 2
    with run.views_csv.open() as f:
        rows = list(csv.DictReader(f))
    assert [(r["view_id"], r["vehicle_id"], r["path"]) for r in rows] == [("5", "2", "pictures/UAV_2_5.jpg")]
    assert ingest.receive(2, last, 1)[0] == ack
    ingest.close()
    assert ingest.pictures == 1
    assert run.views_csv.read_text().splitlines()[0] == ",".join(VIEW_COLUMNS)


def test_what_is_mapped_is_without_the_lens_and_what_is_stored_is_as_it_came(tmp_path: Path) -> None:
    jpeg, run, lens = a_jpeg(), RunFolder(tmp_path), (-0.1, 0.02, 0.001, 0.0)
    ingest = Ingest(run, SITE, "2026-06-01T10:00:00Z", HOMES, lens=lens)
    (whole,) = chunks_of(jpeg, len(jpeg))
    _, picture = ingest.receive(2, whole, 0)
    assert picture is not None
    plain = decode_rgb(jpeg)
    assert plain is not None
    assert np.array_equal(picture.rgb, redrawn(plain, meta_of(jpeg).camera, lens, meta_of(jpeg).camera))
    assert run.picture(2, 5).read_bytes().endswith(jpeg[2:])
    ingest.close()


def test_exif_position_time_and_focal_length(tmp_path: Path) -> None:
    jpeg, run = a_jpeg(), RunFolder(tmp_path)
    ingest = Ingest(run, SITE, "2026-06-01T10:00:00Z", HOMES)
    for chunk in chunks_of(jpeg, 10_000):
        ingest.receive(2, chunk, 0)
    ingest.close()
    exif = Image.open(io.BytesIO(run.picture(2, 5).read_bytes())).getexif()
    gps, details = exif.get_ifd(0x8825), exif.get_ifd(0x8769)
    lat, lon = (float(d) + float(m) / 60 + float(s) / 3600 for d, m, s in (gps[2], gps[4]))
    back = SITE.enu_from_geodetic(lat, -lon, float(gps[6]))
    assert (gps[1], gps[3]) == ("N", "W")
    assert np.allclose(back, (10.0, -20.0, 15.5), atol=1e-3)
    assert float(gps[31]) == 0.02
    assert exif[0x110] == "swarmscan simulated camera"
    assert details[0x9003] == "2026:06:01 10:00:12"
    assert math.isclose(float(details[0x920A]), 9.6 * CAMERA.fx_px / 48, abs_tol=1e-3)
