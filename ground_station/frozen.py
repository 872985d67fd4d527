"""Live objects as data, and back: for checkpoints.

Only what is known is written: plain values, containers, arrays, enums, and objects of our own rooms by class and
fields. Whatever else an object holds must be `given` by name on both sides, such as a mission, or have a keeper below.
Reading makes objects and sets their fields; it runs nothing that a file could choose.
"""

from __future__ import annotations

import enum
import itertools
from collections import deque
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from datetime import datetime
from importlib import import_module
from pathlib import Path, PosixPath
from typing import Any, Protocol

import msgspec
import numpy as np
from msgspec.msgpack import Ext
from numpy.typing import NDArray
from pymavlink.dialects.v20 import common as mav

ROOMS = ("missions", "planning", "perception", "ground_station")
ATOMS = frozenset({type(None), bool, int, float, str, bytes})
NO_INTS = ATOMS - {int}
LONGEST_INT = 2**63
SPARSE_BYTES = 65536
"""Of arrays larger than this that are mostly zeros only the rest is kept."""
SEQUENCES: dict[str, Callable[[list[Any]], Any]] = {"list": list, "set": set, "frozenset": frozenset, "deque": deque}


class ArrayStore(Protocol):
    """Where arrays go that never change, once."""

    def put(self, array: NDArray[Any]) -> list[int]:
        """Where it is."""

    def get(self, at: list[int]) -> NDArray[np.uint8]:
        """What is there."""

    def note(self, array: NDArray[Any], at: list[int]) -> None:
        """This array has been made of what is there."""


class Freezer:
    """Objects into a table of records. A value is an atom, a list of values for a tuple, or the number of a record."""

    def __init__(self, given: Mapping[str, object], constant: tuple[type, ...], store: ArrayStore) -> None:
        """constant: classes whose arrays never change once they are made; those go to the store."""
        self._given = {id(o): name for name, o in given.items()}
        self._constant, self._store = constant, store
        self._numbers: dict[int, int] = {}
        self._alive: list[object] = []
        self.table: list[list[Any]] = []

    def value(self, o: object, constant: bool = False) -> Any:
        """What stands for an object in the table. Raises TypeError for what cannot be kept."""
        if type(o) in ATOMS and not (type(o) is int and abs(o) >= LONGEST_INT):
            return o
        if type(o) is tuple:
            return list(o) if NO_INTS.issuperset(map(type, o)) else [self.value(x, constant) for x in o]
        number = self._numbers.get(id(o))
        if number is None:
            number = self._numbers[id(o)] = len(self.table)
            self._alive.append(o)
            self.table.append([])
            self.table[number] = self._record(o, constant)
        return Ext(0, number.to_bytes(4, "big"))

    def _record(self, o: Any, constant: bool) -> list[Any]:
        kind = type(o)
        if id(o) in self._given:
            return ["given", self._given[id(o)]]
        if kind.__name__ in SEQUENCES and kind is SEQUENCES[kind.__name__]:
            return self._sequence(kind.__name__, o)
        if kind is dict:
            return ["dict", [self.value(k) for k in o], [self.value(v) for v in o.values()]]
        if kind is np.ndarray and o.dtype.kind in "biufSU":
            return self._array(o, constant)
        if isinstance(o, np.generic):
            return ["scalar", o.dtype.str, o.tobytes()]
        if kind is int:
            return ["int", str(o)]
        keeper = KEEPERS.get(kind.__name__)
        if keeper is not None and kind is keeper[0]:
            return ["kept", kind.__name__, self.value(keeper[1](o))]
        return self._object(o, constant or kind in self._constant)

    def _sequence(self, name: str, o: Any) -> list[Any]:
        kinds = set(map(type, o))
        if kinds <= NO_INTS or (kinds <= ATOMS and all(type(x) is not int or abs(x) < LONGEST_INT for x in o)):
            return ["atoms", name, list(o)]
        if kinds == {tuple} and set(map(type, itertools.chain.from_iterable(o))) <= NO_INTS:
            return ["tuples", name, list(o)]
        return [name, [self.value(x) for x in o]]

    def _array(self, o: NDArray[Any], constant: bool) -> list[Any]:
        order: Any = "F" if o.flags.f_contiguous and not o.flags.c_contiguous else "C"
        head = [o.dtype.str, list(o.shape), order]
        if constant:
            return ["array", *head, self._store.put(o)]
        if o.nbytes > SPARSE_BYTES and o.dtype.itemsize in (1, 2, 4, 8):
            flat = o.ravel(order).view(f"u{o.dtype.itemsize}")  # as whole numbers, for which -0.0 is not nothing
            if np.count_nonzero(flat) < len(flat) // 4:
                at = np.flatnonzero(flat != 0).astype(np.uint32 if len(flat) < 2**32 else np.uint64)
                return ["sparse", *head, at.dtype.str, at.tobytes(), flat[at].tobytes()]
        return ["array", *head, o.tobytes(order)]

    def _object(self, o: Any, constant: bool) -> list[Any]:
        kind = type(o)
        if kind.__module__.partition(".")[0] not in ROOMS or isinstance(o, type):
            raise TypeError(f"{kind.__module__}.{kind.__qualname__} cannot be kept: {o!r:.100}")
        name = f"{kind.__module__}:{kind.__qualname__}"
        if isinstance(o, enum.Enum):
            return ["enum", name, o.name]
        fields = {f: getattr(o, f) for f in o.__struct_fields__} if isinstance(o, msgspec.Struct) else _fields(o)
        return ["object", name, {f: self.value(v, constant) for f, v in fields.items()}]


class Thawer:
    """The way back."""

    def __init__(self, table: list[list[Any]], given: Mapping[str, object], store: ArrayStore) -> None:
        self._table, self._given, self._store = table, given, store
        self._made: dict[int, Any] = {}

    def object(self, value: Any) -> Any:
        """What a value stands for. Raises LookupError, TypeError, AttributeError or ImportError for what is not there
        any more."""
        if isinstance(value, list):
            return tuple(self.object(v) for v in value)
        if not isinstance(value, Ext):
            return value
        number = int.from_bytes(value.data, "big")
        if number not in self._made:
            record = self._table[number]
            fill = _FILLED.get(record[0])
            if fill is None:
                self._made[number] = self._plain(record)
            else:  # exists before what it holds is made, which may hold it in turn
                fill(self, number, *record[1:])
        return self._made[number]

    def _plain(self, record: list[Any]) -> Any:
        kind, *rest = record
        if kind in SEQUENCES:
            return SEQUENCES[kind]([self.object(v) for v in rest[0]])
        return _PLAIN[kind](self, *rest)

    def _fill_list(self, number: int, values: list[Any]) -> None:
        made: list[Any] = []
        self._made[number] = made
        made.extend(self.object(v) for v in values)

    def _fill_dict(self, number: int, keys: list[Any], values: list[Any]) -> None:
        made: dict[Any, Any] = {}
        self._made[number] = made
        made.update((self.object(k), self.object(v)) for k, v in zip(keys, values, strict=True))

    def _fill_object(self, number: int, name: str, fields: dict[str, Any]) -> None:
        kind = _class(name)
        if issubclass(kind, msgspec.Struct):
            self._made[number] = kind(**{f: self.object(v) for f, v in fields.items()})
            return
        made = self._made[number] = object.__new__(kind)
        for f, v in fields.items():
            object.__setattr__(made, f, self.object(v))

    def _array(self, dtype: str, shape: list[int], order: Any, data: bytes | list[int]) -> NDArray[Any]:
        if isinstance(data, bytes):
            return np.ndarray(shape, np.dtype(dtype), bytearray(data), order=order)
        made: NDArray[Any] = np.ndarray(shape, np.dtype(dtype), self._store.get(data), order=order)
        self._store.note(made, data)
        return made

    def _sparse(self, dtype: str, shape: list[int], order: Any, at_dtype: str, at: bytes,
                values: bytes) -> NDArray[Any]:
        made = np.zeros(shape, np.dtype(dtype), order)
        flat = made.reshape(-1, order=order).view(f"u{made.itemsize}")
        flat[np.frombuffer(at, at_dtype)] = np.frombuffer(values, flat.dtype)
        return made


_FILLED: dict[str, Callable[..., None]] = {"list": Thawer._fill_list, "dict": Thawer._fill_dict,
                                           "object": Thawer._fill_object}
_PLAIN: dict[str, Callable[..., Any]] = {
    "given": lambda thawer, name: thawer._given[name], "array": Thawer._array,
    "sparse": Thawer._sparse,
    "atoms": lambda thawer, name, values: SEQUENCES[name](values),
    "tuples": lambda thawer, name, values: SEQUENCES[name]([tuple(v) for v in values]),
    "scalar": lambda thawer, dtype, data: np.frombuffer(data, dtype)[0], "int": lambda thawer, digits: int(digits),
    "enum": lambda thawer, name, member: _class(name)[member],  # type: ignore[index]
    "kept": lambda thawer, name, state: KEEPERS[name][2](thawer.object(state)),
}


def _fields(o: Any) -> dict[str, Any]:
    slots = {s: getattr(o, s) for kind in type(o).__mro__ for s in getattr(kind, "__slots__", ()) if hasattr(o, s)}
    return slots | getattr(o, "__dict__", {})


def _class(name: str) -> type:
    module, _, qualified = name.partition(":")
    if module.partition(".")[0] not in ROOMS:
        raise TypeError(f"{name} is none of ours")
    found: Any = import_module(module)
    for part in qualified.split("."):
        found = getattr(found, part)
    if not isinstance(found, type):
        raise TypeError(f"{name} is no class")
    return found


def _mavlink(state: tuple[int, int, int]) -> Any:
    made = mav.MAVLink(None, srcSystem=state[0], srcComponent=state[1])
    made.robust_parsing, made.seq = True, state[2]
    return made


def _generator(state: dict[str, Any]) -> np.random.Generator:
    made = np.random.default_rng()
    made.bit_generator.state = state
    return made


KEEPERS: dict[str, tuple[type, Callable[[Any], Any], Callable[[Any], Any]]] = {
    "ThreadPoolExecutor": (ThreadPoolExecutor, lambda o: o._max_workers, ThreadPoolExecutor),
    "MAVLink": (mav.MAVLink, lambda o: (o.srcSystem, o.srcComponent, o.seq), _mavlink),
    "PosixPath": (PosixPath, str, Path), "datetime": (datetime, datetime.isoformat, datetime.fromisoformat),
    "slice": (slice, lambda o: (o.start, o.stop, o.step), lambda state: slice(*state)),
    "Generator": (np.random.Generator, lambda o: o.bit_generator.state, _generator),
}
"""Of classes that are not ours: what is kept of an object, and how it is made again."""
