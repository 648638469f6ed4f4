"""Arrays and structures in memory that Python has filled for C: which ones an object has, and what they refer to."""

from __future__ import annotations

import ctypes as ct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from piaffe.errors import SolverError

C_NUMBERS = {"float64": "double", "int32": "int", "int64": "long", "uint8": "unsigned char"}
"""NumPy's types, and those of C."""


@dataclass(eq=False)
class Region:
    """An array or a structure in memory.

    Args:
        name: in C.
        thing: the array or structure.
        constant: whether it never changes.
        vectors: number of vectors, if its size depends on the width of a vector; else None.
    """

    name: str
    thing: Any
    constant: bool
    vectors: int | None = None
    refers: set[str] = field(default_factory=set)

    @property
    def address(self) -> int:
        """Where it is."""
        return address_of(self.thing)

    @property
    def size(self) -> int:
        """Number of bytes."""
        return int(self.thing.nbytes) if isinstance(self.thing, np.ndarray) else ct.sizeof(self.thing)


@dataclass(frozen=True)
class Address:
    """A pointer of an array of pointers.

    Args:
        value: the address.
    """

    value: int


def address_of(thing: Any) -> int:
    """Return where an array or a structure is."""
    return int(thing.ctypes.data) if isinstance(thing, np.ndarray) else ct.addressof(thing)


def things(owner: object) -> Iterator[Any]:
    """Yield the arrays and structures of an object's attributes."""
    waiting: list[Any] = list(vars(owner).values())
    seen: set[int] = set()
    while waiting:
        each = waiting.pop()
        if id(each) in seen:
            continue
        seen.add(id(each))
        if isinstance(each, np.ndarray):
            if each.dtype.name in C_NUMBERS and each.flags.c_contiguous:
                yield each
        elif isinstance(each, ct.Structure | ct.Array):
            yield each
        elif isinstance(each, list | tuple):
            waiting += each
        elif isinstance(each, dict):
            waiting += each.values()


def elements(thing: Any) -> Sequence[Any]:
    """Return the elements of an array, of pointers as addresses; a structure itself."""
    if isinstance(thing, ct.Structure):
        return [thing]
    if is_pointer(thing._type_):
        return [Address(each) if (each := target(raw)) else None for raw in thing]
    return list(thing)


def addresses(thing: Any) -> Iterator[int]:
    """Yield the addresses in a structure or an array of structures or pointers."""
    for each in elements(thing):
        if isinstance(each, Address):
            yield each.value
        if not isinstance(each, ct.Structure):
            continue
        for name, kind, *_ in each._fields_:
            value = getattr(each, name)
            if is_pointer(kind):
                if address := target(value):
                    yield address
            elif isinstance(value, ct.Structure | ct.Array):
                yield from addresses(value)


def is_pointer(kind: Any) -> bool:
    """Return whether a type of ctypes is that of a pointer."""
    return kind is ct.c_void_p or (isinstance(kind, type) and issubclass(kind, ct._Pointer))


def target(value: Any) -> int:
    """Return the address that a pointer has; 0 for none."""
    if value is None or isinstance(value, int):
        return value or 0
    return ct.cast(value, ct.c_void_p).value or 0


def field_at(thing: ct.Structure, offset: int) -> str:
    """Return how C selects the field at an offset; empty for the beginning.

    Raises:
        SolverError: no field begins there.
    """
    if offset == 0:
        return ""
    for name, *_ in thing._fields_:
        if getattr(type(thing), name).offset == offset:
            return f".{name}"
    raise SolverError(
        f"image of memory: an address is within a field - got offset {offset} in '{type(thing).__name__}', expected "
        "the beginning of one; refer to a field"
    )
