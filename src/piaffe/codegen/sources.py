"""C sources of a library, complete or made on demand."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

from piaffe.errors import SolverError

_NAME = re.compile(r"[A-Za-z_]\w*")
_HEADER = re.compile(r"\w[\w.-]*")


@dataclass(frozen=True)
class Sources:
    """C sources of a library.

    Args:
        units: name (an identifier) and text of each translation unit.
        headers: file name and text of the headers that the units include.
        flags_per_unit: flags by unit, in place of the common flags.
    """

    units: Sequence[tuple[str, str]]
    headers: Mapping[str, str] = field(default_factory=dict)
    flags_per_unit: Mapping[str, Sequence[str]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        names = [name for name, _ in self.units]
        invalid = [name for name in names if not _NAME.fullmatch(name)] + [
            n for n in self.headers if not _HEADER.fullmatch(n)
        ]
        if not names or invalid or len(set(names)) < len(names):
            raise SolverError(
                f"build: names of units or headers are invalid - got {invalid or names}, expected at least one unit, "
                "each with a different name that is an identifier; change the names"
            )
        if unknown := sorted(set(self.flags_per_unit) - set(names)):
            raise SolverError(
                f"build: flags_per_unit names unknown units - got {unknown}, expected names of units {names}; correct "
                "the names"
            )

    @property
    def parts(self) -> list[str]:
        """Names, texts and flags as one list."""
        parts = []
        for name, text in self.units:
            parts += ["unit", name, text, *self.flags_per_unit.get(name, ("as all",))]
        for name in sorted(self.headers):
            parts += ["header", name, self.headers[name]]
        return parts


@dataclass(frozen=True)
class LazySources:
    """Sources that are made only if their library is not in the cache.

    Args:
        parts: texts that determine the sources: equal parts make equal sources.
        make: function that makes the sources.
    """

    parts: Sequence[str]
    make: Callable[[], Sources]
