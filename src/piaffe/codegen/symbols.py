"""The names that a compiled library defines, read from the file itself."""

from __future__ import annotations

import struct
from pathlib import Path

from piaffe.errors import SolverError

_DYNSYM = 11  # type of the section with the names that other files can use
_SECTION, _SYMBOL = struct.Struct("<IIQQQQIIQQ"), struct.Struct("<IBBHQQ")
_LOCAL, _UNDEFINED = 0, 0


def defined_symbols(library: Path) -> tuple[str, ...]:
    """Return the names of functions and data that a shared library (ELF, 64 bits, little-endian) defines for others.

    Raises:
        SolverError: the file is no such library.
    """
    data = library.read_bytes()
    if data[:6] != b"\x7fELF\x02\x01":
        raise SolverError(
            f"library '{library}': its names cannot be read - got a file that begins with {data[:6]!r}, expected an "
            "ELF file of 64 bits; export on Linux"
        )
    at, size, count = struct.unpack_from("<Q", data, 40)[0], *struct.unpack_from("<HH", data, 58)
    sections = [_SECTION.unpack_from(data, at + i * size) for i in range(count)]
    found: set[str] = set()
    for section in sections:
        if section[1] != _DYNSYM:
            continue
        names, first, last = sections[section[6]][4], section[4], section[4] + section[5]
        for place in range(first, last, _SYMBOL.size):
            name, info, _, where, _, _ = _SYMBOL.unpack_from(data, place)
            if info >> 4 != _LOCAL and where != _UNDEFINED:
                begin = names + name
                found.add(data[begin : data.index(b"\0", begin)].decode())
    return tuple(sorted(found))
