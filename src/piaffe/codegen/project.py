"""A folder with C sources that can be built without Python: libraries of the cache, and files beside them."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

from piaffe.errors import FileWriteError, SolverError
from piaffe.files import whole_file

from .build import LoadedLibrary
from .symbols import defined_symbols

_NAME = re.compile(r"[a-z][a-z0-9_]*")
NAMES = "names.h"
"""The header that every unit includes first: prefixes of the names, and the width of a vector."""


def check_name(name: str) -> None:
    """Raise SolverError if a name is no prefix for names in C."""
    if not _NAME.fullmatch(name):
        raise SolverError(
            f"export: the name is unusable - got '{name}', expected small letters, digits and underscores, as "
            "trot_mpc; give another name"
        )


@dataclass(frozen=True)
class Part:
    """A library of which the sources become part of a project.

    Args:
        folder: its folder in the sources.
        library: the library, which is loaded.
        wide: whether its vectors are as wide as the processor's; else a vector is one number.
    """

    folder: str
    library: LoadedLibrary
    wide: bool = True


@dataclass(frozen=True)
class Project:
    """The files of a project.

    Args:
        name: prefix of all names that the linker sees; an identifier in small letters.
        parts: libraries.
        units: further C units, by path in the sources.
        headers: further headers, by path in the sources.
        flags: of the further units.
        own_symbols: names that the further units define for each other.
    """

    name: str
    parts: Sequence[Part]
    units: Mapping[str, str]
    headers: Mapping[str, str]
    flags: Sequence[str]
    own_symbols: Sequence[str] = ()

    def __post_init__(self) -> None:
        check_name(self.name)

    def sources(self) -> dict[str, str]:
        """Return the text of each file of the sources, by its path."""
        made = [(part, part.library.built.sources.make()) for part in self.parts]
        texts: dict[str, list[str]] = {}
        for _, sources in made:
            for name, text in sources.headers.items():
                texts.setdefault(name, []).append(text)
        shared = {name: own[0] for name, own in texts.items() if len(own) > 1 and len(set(own)) == 1}
        found = dict(shared)
        for part, sources in made:
            first = (
                f'#include "{NAMES}"\n' if part.wide else f'#undef PIAFFE_W\n#define PIAFFE_W 1\n#include "{NAMES}"\n'
            )
            found |= {f"{part.folder}/{n}": t for n, t in sources.headers.items() if n not in shared}
            found |= {f"{part.folder}/{n}.c": first + t for n, t in sources.units}
        found |= self.headers
        found |= {path: f'#include "{NAMES}"\n{text}' for path, text in self.units.items()}
        return found | {NAMES: self._names(), "own_math.h": _OWN_MATH}

    def flags_of_units(self) -> dict[str, tuple[str, ...]]:
        """Return the flags of each unit, by its path.

        ``{native}`` stands for the flags of the processor, ``{narrow}`` for those without wide vectors.
        """
        found: dict[str, tuple[str, ...]] = {}
        for part in self.parts:
            sources = part.library.built.sources.make()
            for name, _ in sources.units:
                flags = sources.flags_per_unit.get(name, part.library.built.flags)
                found[f"{part.folder}/{name}.c"] = tuple(
                    "{narrow}" if flag == "{native}" and not part.wide else flag for flag in flags
                )
        return found | {path: tuple(self.flags) for path in self.units}

    def _names(self) -> str:
        names = {name for part in self.parts for name in defined_symbols(part.library.built.path)}
        lines = [f"#define {name} {self.name}_{name}" for name in sorted(names | set(self.own_symbols))]
        return _NAMES.replace("@NAMES@", "\n".join(lines))


_NAMES = """/* First of all in every unit: names for the linker, and the width of a vector. */
#ifndef PIAFFE_NAMES_H
#define PIAFFE_NAMES_H

#ifndef PIAFFE_W /* doubles per vector: as many as fit into a register */
#if defined(__AVX512F__)
#define PIAFFE_W 8
#elif defined(__AVX2__)
#define PIAFFE_W 4
#else
#define PIAFFE_W 2
#endif
#endif

#ifdef PIAFFE_REPRODUCIBLE
#include "own_math.h"
#endif

@NAMES@
#endif
"""
_OWN_MATH = files(__package__).joinpath("own_math.h").read_text(encoding="utf-8")


def write_files(folder: Path, contents: Mapping[str, str | bytes]) -> None:
    """Write files into a folder, by their paths in it; equal ones stay as they are, so that make need not build anew.

    Raises:
        SolverError: the folder cannot be written.
    """
    try:
        for path, content in contents.items():
            target = folder / path
            data = content.encode() if isinstance(content, str) else content
            if target.is_file() and target.read_bytes() == data:
                continue
            with whole_file(target) as temporary:
                temporary.write_bytes(data)
    except (OSError, FileWriteError) as error:
        cause = error.__cause__ if isinstance(error, FileWriteError) else error
        raise SolverError(
            f"export: '{folder}' cannot be written - got {getattr(cause, 'strerror', None) or cause}, expected a "
            "folder with space for C sources; choose another one"
        ) from error


def flag_groups(units: Mapping[str, Sequence[str]]) -> list[tuple[tuple[str, ...], list[str]]]:
    """Return the sets of flags, and the units that have each."""
    groups: dict[tuple[str, ...], list[str]] = {}
    for path, flags in units.items():
        groups.setdefault(tuple(flags), []).append(path)
    return list(groups.items())
