"""An image of memory as C: the arrays and structures that Python has filled for C, with what they refer to.

Python finds them by their addresses. Constant ones become constants of C. The others, and those that refer to them,
become members of ``struct memory``, of which a program may have several, and a function that writes their first values.
"""

from __future__ import annotations

import ctypes as ct
import math
import re
from bisect import bisect_right
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any

import numpy as np

from piaffe.errors import SolverError

from .regions import C_NUMBERS, Address, Region, address_of, addresses, elements, field_at, is_pointer, target, things

_C_SCALARS = {ct.c_double: "double", ct.c_int: "int", ct.c_long: "long"}
_LINE = 110


class MemoryImage:
    """What structures refer to, as C.

    Args:
        headers: texts of the headers that declare the structures.
        symbols: C expression of each function and constant, by address.
        kinds: C type of constants, by expression.
        outside: addresses that are not part of the image; the program sets these pointers.
    """

    def __init__(
        self, headers: Iterable[str], symbols: Mapping[int, str], kinds: Mapping[str, str], outside: Iterable[int] = ()
    ) -> None:
        self._headers = "\n".join(headers)
        self._symbols, self._kinds, self._outside = symbols, kinds, frozenset(outside)
        self._regions: dict[int, Region] = {}
        self._used: dict[str, Region] = {}
        self._starts: list[int] = []

    def know(self, owner: object, *, constant: bool = False, vectors: Mapping[int, int] | None = None) -> None:
        """Learn of the arrays and structures that an object of Python has.

        Args:
            owner: the object; its attributes, and what lists and dicts in them contain, are read.
            constant: whether they never change.
            vectors: number of vectors at an address, if the size depends on the width of a vector.
        """
        for thing in things(owner):
            region = Region(f"r{len(self._regions)}", thing, constant, None)
            if region.size and region.address not in self._regions:
                region.vectors = (vectors or {}).get(region.address)
                self._regions[region.address] = region
        end = 0
        for start in sorted(self._regions):  # part of an array is no region of its own
            if start < end:
                del self._regions[start]
            else:
                end = start + self._regions[start].size
        self._starts = sorted(self._regions)

    def use(self, **roots: Any) -> None:
        """Let structures and arrays, each with its name in C, and all that they refer to be the image."""
        regions = [self._regions[address_of(thing)] for thing in roots.values()]
        for region, name in zip(regions, roots, strict=True):
            region.name, region.constant = name, False
        for region in regions:
            self._visit(region)
        changed = True
        while changed:  # what refers to memory that changes is a member, too
            changed = False
            for each in self._used.values():
                if each.constant and any(not self._used[other].constant for other in each.refers):
                    each.constant, changed = False, True

    @property
    def size(self) -> int:
        """Bytes of the members of ``struct memory``."""
        return sum(region.size for region in self._used.values() if not region.constant)

    # ---- C

    def constants(self) -> str:
        """Return the definitions of all constants."""
        parts = []
        for region in self._in_order():
            values = self._values(region.thing, self._constant_address)
            parts.append(f"static {self._declared(region, region.name, 'const ')} = {_wrapped(values)};")
        return "\n".join(parts) + "\n"

    def members(self) -> str:
        """Return the declarations of the members of ``struct memory``."""
        own = [region for region in self._used.values() if not region.constant]
        return "".join(f"    _Alignas(64) {self._declared(region, region.name)};\n" for region in own)

    def filling(self, target: str) -> str:
        """Return statements that write the first values of the members.

        Args:
            target: C expression of a pointer to the memory, whose bytes are zero.
        """
        lines = []
        for region in self._used.values():
            if region.constant:
                continue
            if isinstance(region.thing, np.ndarray):
                if np.any(region.thing) and not region.vectors:
                    values = self._values(region.thing, self._constant_address)
                    lines.append(
                        f"{{\n        static {self._declared(region, 'first', 'const ')} = {_wrapped(values)};\n"
                        f"        memcpy({target}->{region.name}, first, sizeof first);\n    }}"
                    )
                continue
            for i, each in enumerate(elements(region.thing)):
                place = f"{target}->{region.name}" + (f"[{i}]" if isinstance(region.thing, ct.Array) else "")
                values = self._values(each, lambda address: self._address(address, f"{target}->"))
                if isinstance(each, ct.Structure):
                    values = f"({self._type(type(each))}){values}"
                lines.append(f"{place} = {values};")
        return "".join(f"    {line}\n" for line in lines)

    def literal(self, thing: ct.Structure) -> str:
        """Return the initialiser of a structure without addresses of memory that changes: these are 0."""
        return self._values(thing, lambda address: self._address(address, None))

    # ---- addresses

    def _find(self, address: int) -> Region | None:
        at = bisect_right(self._starts, address) - 1
        region = self._regions[self._starts[at]] if at >= 0 else None
        return region if region is not None and address < region.address + region.size else None

    def _address(self, address: int, target: str | None) -> str:
        if address in self._outside:
            return "0"
        if address in self._symbols:
            return self._symbols[address]
        region = self._find(address)
        if region is None:
            raise SolverError(
                f"image of memory: an address is unknown - got {address:#x}, expected memory of an object that the "
                "image knows; make it known"
            )
        offset = address - region.address
        if not region.constant and target is None:
            return "0"
        name = region.name if region.constant else f"{target}{region.name}"
        if isinstance(region.thing, ct.Structure):
            field_ = field_at(region.thing, offset)
            return f"(void *)&{name}{field_}"
        step = region.thing.itemsize if isinstance(region.thing, np.ndarray) else ct.sizeof(region.thing._type_)
        return f"(void *){name}" if offset == 0 else f"(void *)({name} + {offset // step})"

    def _constant_address(self, address: int) -> str:
        return self._address(address, None)

    # ---- the graph

    def _visit(self, region: Region) -> None:
        if region.name in self._used:
            return
        self._used[region.name] = region
        if isinstance(region.thing, np.ndarray):
            return
        for address in addresses(region.thing):
            if address in self._outside or address in self._symbols:
                continue
            other = self._find(address)
            if other is None:
                self._address(address, None)  # raises
                continue
            region.refers.add(other.name)
            self._visit(other)

    def _in_order(self) -> Iterator[Region]:
        """Yield the constants, each after those that it refers to."""
        done: set[str] = set()

        def visit(region: Region) -> Iterator[Region]:
            if region.name in done or not region.constant:
                return
            done.add(region.name)
            for other in sorted(region.refers):
                yield from visit(self._used[other])
            yield region

        for region in self._used.values():
            yield from visit(region)

    # ---- types and values

    def _type(self, kind: Any) -> str:
        """Return the C type of a structure, by the name that the headers have for it."""
        plain = re.sub(r"(Struct|Tables)$", "", kind.__name__.lstrip("_"))
        if re.search(rf"\}} {plain};", self._headers):
            return plain
        tag = re.sub(r"(?<!^)(?=[A-Z])", "_", plain).lower()
        if re.search(rf"struct {tag} \{{", self._headers):
            return f"struct {tag}"
        raise SolverError(
            f"image of memory: a structure is unknown - got '{kind.__name__}', expected '{plain}' or 'struct {tag}' in "
            "a header; give them the same name"
        )

    def _declared(self, region: Region, name: str, constant: str = "") -> str:
        thing = region.thing
        if isinstance(thing, np.ndarray):
            size = f"{region.vectors} * PIAFFE_W" if region.vectors else str(thing.size)
            return f"{constant}{C_NUMBERS[thing.dtype.name]} {name}[{size}]"
        if isinstance(thing, ct.Structure):
            return f"{constant}{self._type(type(thing))} {name}"
        kind = thing._type_
        if issubclass(kind, ct.Structure):
            return f"{constant}{self._type(kind)} {name}[{len(thing)}]"
        if not is_pointer(kind):
            return f"{constant}{_C_SCALARS[kind]} {name}[{len(thing)}]"
        kinds = {self._kinds.get(self._symbols.get(each, ""), "void") for each in addresses(thing)}
        return f"{kinds.pop() if len(kinds) == 1 else 'void'} *const {name}[{len(thing)}]"

    def _values(self, value: Any, address: Callable[[int], str]) -> str:
        if isinstance(value, np.ndarray):
            return "{" + ", ".join(_number(each) for each in value.ravel().tolist()) + "}"
        if isinstance(value, ct.Array):
            return "{" + ", ".join(self._values(each, address) for each in elements(value)) + "}"
        if isinstance(value, ct.Structure):
            parts = []
            for name, kind, *_ in value._fields_:
                each = getattr(value, name)
                if is_pointer(kind):
                    each = target(each)
                    if each:
                        parts.append(f".{name} = {address(each)}")
                elif isinstance(each, ct.Structure | ct.Array):
                    if any(bytes(each)):
                        parts.append(f".{name} = {self._values(each, address)}")
                elif each or (isinstance(each, float) and math.copysign(1.0, each) < 0):
                    parts.append(f".{name} = {_number(each)}")
            return "{" + (", ".join(parts) or "0") + "}"
        if value is None:
            return "0"
        return _number(value) if not isinstance(value, Address) else address(value.value)


def _number(value: float) -> str:
    if isinstance(value, int) or math.isfinite(value):
        return repr(value)
    return "NAN" if math.isnan(value) else "INFINITY" if value > 0 else "-INFINITY"


def _wrapped(text: str) -> str:
    """Return a text with line breaks after commas."""
    lines, line = [], ""
    for word in text.split(" "):
        if line and len(line) + len(word) > _LINE:
            lines.append(line)
            line = word
        else:
            line = f"{line} {word}" if line else word
    return "\n    ".join([*lines, line])
