"""Objects as data and back: what is kept comes back bit for bit; what cannot be kept is said, not left out."""

from __future__ import annotations

import threading
from collections import deque
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from ground_station.checkpoint import ALIGNED_BYTES, Arrays
from ground_station.drone import Drone, Stage
from ground_station.fleet_link import VehicleLink, arm
from ground_station.frozen import SPARSE_BYTES, Freezer, Thawer
from missions.camera import Pose
from missions.frames import Site
from missions.mission import CameraSpec
from perception.depth.depth_map import DepthMap

ATOMS = st.none() | st.booleans() | st.integers() | st.floats() | st.text() | st.binary()
VALUES = st.recursive(ATOMS, lambda inner: st.lists(inner) | st.tuples(inner, inner)
                      | st.dictionaries(st.text() | st.integers() | st.tuples(st.integers(), st.text()), inner))


def again(o: object, given_: dict[str, object] | None = None, constant: tuple[type, ...] = (),
          store: Any = None) -> Any:
    """An object, written and read."""
    freezer = Freezer(given_ or {}, constant, store)
    data = msgspec.msgpack.encode([freezer.value(o), freezer.table])
    root, table = msgspec.msgpack.decode(data)
    return Thawer(table, given_ or {}, store).object(root)


@given(VALUES)
def test_plain_values_come_back(value: Any) -> None:
    assert repr(again(value)) == repr(value)


@given(st.sets(st.integers(0, 5)), st.frozensets(st.text()), st.lists(st.floats()), st.integers(-2**200, 2**200))
def test_sets_queues_and_long_numbers_come_back(numbers: set[int], texts: frozenset[str], floats: list[float],
                                                long: int) -> None:
    assert again([numbers, texts]) == [numbers, texts]
    value = [deque(floats), long, Stage.HOMING, np.float64(0.1), np.int32(7), slice(1, None)]
    assert repr(again(value)) == repr(value)


@given(hnp.arrays(st.sampled_from([np.float64, np.float32, np.int64, np.uint8, np.bool_]),
                  hnp.array_shapes(min_dims=0, min_side=0)), st.booleans())
def test_arrays_come_back_bit_for_bit_and_can_be_written(array: np.ndarray[Any, Any], fortran: bool) -> None:
    array = np.asfortranarray(array) if fortran else array
    back = again(array)
    assert (back.dtype, back.shape, back.tobytes()) == (array.dtype, array.shape, array.tobytes())
    assert (back.flags.c_contiguous, back.flags.f_contiguous, back.flags.writeable) == (
        array.flags.c_contiguous, array.flags.f_contiguous, True)


@pytest.mark.parametrize("order", ["C", "F"])
def test_of_a_sparse_array_little_is_written_and_minus_nothing_stays(order: Any) -> None:
    array = np.zeros((100, 40, 7), order=order)
    array[3, 2, 1], array[99, 39, 6], array[5, 5, 5] = -0.0, np.nan, 1e-300
    freezer = Freezer({}, (), None)  # type: ignore[arg-type]
    freezer.value(array)
    assert len(msgspec.msgpack.encode(freezer.table)) < 200 < SPARSE_BYTES < array.nbytes
    assert again(array).tobytes() == array.tobytes()


def test_what_is_shared_is_shared_again_and_circles_close() -> None:
    shared = [1, 2]
    drone = Drone(1, VehicleLink(1, Site(48.0, 11.0, 500.0)), np.zeros(3), stage=Stage.FLYING)
    drone.link.command(arm())
    world = {"a": shared, "b": shared, "drone": drone, "drones": {1: drone}}
    world["self"] = world
    back = again(world)
    assert back["a"] is back["b"]
    assert back["drone"] is back["drones"][1]
    assert back["self"] is back
    assert (back["drone"].stage, back["drone"].link.busy) == (Stage.FLYING, True)
    assert back["drone"].link.poll(0) == drone.link.poll(0)


def test_random_numbers_go_on() -> None:
    rng = np.random.default_rng(5)
    rng.random(3)
    assert again(rng).random(4).tolist() == rng.random(4).tolist()


def test_what_is_given_is_not_written() -> None:
    lock = threading.Lock()
    assert again([lock, lock], {"lock": lock}) == [lock, lock]


@pytest.mark.parametrize("stranger", [threading.Lock(), print, Path, lambda: None])
def test_what_cannot_be_kept_is_refused(stranger: object) -> None:
    with pytest.raises(TypeError, match="cannot be kept"):
        again([stranger])


@pytest.mark.parametrize("name", ["os:system", "subprocess:Popen", "missions.camera:math"])
def test_a_file_chooses_among_our_classes_alone(name: str) -> None:
    with pytest.raises((TypeError, AttributeError)):
        Thawer([["object", name, {}]], {}, None).object(msgspec.msgpack.Ext(0, bytes(4)))  # type: ignore[arg-type]


def test_arrays_that_never_change_are_written_once(tmp_path: Path) -> None:
    store = Arrays(tmp_path / "arrays.bin")
    camera, pose = CameraSpec().explore_camera(), Pose((0.0, 0.0, 0.0), 0.0, 0.0)
    yes, sure = np.ones((3, 4), dtype=np.bool_), np.ones((3, 4), dtype=np.float32)
    held = [DepthMap(camera, pose, depth * sure, yes, sure, yes, 0.1, yes, sure) for depth in (1.0, 2.0)]
    for _ in range(3):
        back = again(held, constant=(DepthMap,), store=store)
    assert (tmp_path / "arrays.bin").stat().st_size == 3 * ALIGNED_BYTES + 48
    assert [b.depth_m.tolist() for b in back] == [h.depth_m.tolist() for h in held]

