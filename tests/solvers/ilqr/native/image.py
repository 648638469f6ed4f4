"""A solver's memory in a file, for a program without Python: arrays, structures, and what points where."""

import ctypes as ct
import struct
from bisect import bisect_right
from pathlib import Path
from typing import Any

import numpy as np

from piaffe.ocp import CompiledProblem
from piaffe.solvers import Options
from piaffe.solvers.ilqr.native.library import Library
from piaffe.solvers.ilqr.native.memory import SolverMemory

UNTOUCHED = np.uint64(0x7FF8_DEAD_BEEF_0001)  # a NaN that no computation makes


class ImageMemory(SolverMemory):
    """A memory that knows which of its arrays have been given content."""

    def __init__(self, problem: CompiledProblem, library: Library, options: Options) -> None:
        self.numbers: list[np.ndarray] = []
        super().__init__(problem, library, options)

    def _array(self, size: int, values: Any = None) -> np.ndarray:
        array = super()._array(size + 8)[:size]  # no two begin at one address, empty ones neither
        if values is None:
            array.view(np.uint64)[:] = UNTOUCHED
        else:
            array[:] = np.ravel(values) if isinstance(values, np.ndarray) else values
        self.numbers.append(array)
        return array

    def shorten(self, array: np.ndarray) -> None:
        """Leave out the last entry of an array, so that the solver runs past its end."""
        (k,) = (k for k, other in enumerate(self.numbers) if other is array)
        self.numbers[k] = array[:-1]

    def save(self, path: Path, resumed: int) -> None:
        """Write everything that the solver reads, as it stands now."""
        structures = [self.c, *(kept for kept in self._kept if isinstance(kept, ct.Array))]
        blocks: list[tuple[int, bytes, bool]] = []
        for array in self.numbers:
            given = array.size == 0 or not np.any(array.view(np.uint64) == UNTOUCHED)
            blocks.append((array.ctypes.data, array.tobytes(), given))
        first = len(blocks)
        for thing in structures:
            is_history = thing is self.history
            blocks.append((ct.addressof(thing), ct.string_at(ct.addressof(thing), ct.sizeof(thing)), not is_history))
        begins = {address: i for i, (address, _, _) in enumerate(blocks)}
        arrays = sorted((blocks[i][0], i) for i in range(first))
        addresses = [address for address, _ in arrays]
        (phases,) = (i for i, thing in enumerate(structures) if thing is self.phases)
        start, step = ct.addressof(self.phases), ct.sizeof(self.phases) // len(self.phases)
        inside = {start + k * step: (first + phases, k * step) for k in range(len(self.phases))}  # Phase.next
        names = table_names(self.compiled_library)
        tables = {ct.addressof(ct.c_char.in_dll(self.library, name)): k for k, name in enumerate(names)}
        pointers, symbols = [], []
        for i in range(first, len(blocks)):
            content = blocks[i][1]
            if not blocks[i][2]:
                continue
            for at in range(0, len(content) - 7, 8):
                (word,) = struct.unpack_from("<Q", content, at)
                if word in inside:
                    pointers.append((i, at, *inside[word]))
                elif word in begins:
                    pointers.append((i, at, begins[word], 0))
                elif word in tables:
                    symbols.append((i, at, tables[word]))
                elif (k := bisect_right(addresses, word) - 1) >= 0:  # a part of an array, as V_last of V_xx
                    address, array = arrays[k]
                    if word < address + len(blocks[array][1]):
                        pointers.append((i, at, array, word - address))
        with path.open("wb") as file:
            file.write(struct.pack("<q", len(blocks)))
            for _, content, given in blocks:
                file.write(struct.pack("<qq", len(content), given) + (content if given else b""))
            for rows in (pointers, symbols):
                file.write(struct.pack("<q", len(rows)) + b"".join(struct.pack(f"<{len(r)}q", *r) for r in rows))
            file.write(struct.pack("<qq", first, resumed))


def table_names(library: Library) -> list[str]:
    """Return the symbols of a library's modes and transitions, in the order of ``tables``."""
    modes, transitions = range(len(library.modes)), range(len(library.transitions))
    return [f"mode{k}_table" for k in modes] + [f"transition{k}_table" for k in transitions]
