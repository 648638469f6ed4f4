"""C texts of a library, and what they are made from."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

from piaffe.errors import SolverError

_NAME = re.compile(r"[A-Za-z_]\w*")
_HEADER = re.compile(r"\w[\w.-]*")


@dataclass(frozen=True)
class Sources:
    """C texts of a library.

    Args:
        units: name (an identifier) and text of each translation unit.
        headers: file name and text of what they include.
        flags_per_unit: flags by unit, instead of those for all.
    """

    units: Sequence[tuple[str, str]]
    headers: Mapping[str, str] = field(default_factory=dict)
    flags_per_unit: Mapping[str, Sequence[str]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        names = [name for name, _ in self.units]
        odd = [name for name in names if not _NAME.fullmatch(name)] + [
            n for n in self.headers if not _HEADER.fullmatch(n)
        ]
        if not names or odd or len(set(names)) < len(names):
            raise SolverError(
                f"build: names of units and headers - got {odd or names}, expected at least one unit, each with a "
                "plain name of its own; name them so"
            )
        if unknown := sorted(set(self.flags_per_unit) - set(names)):
            raise SolverError(
                f"build: flags_per_unit - got {unknown}, expected names of units {names}; correct the names"
            )

    @property
    def parts(self) -> list[str]:
        """All of them, as one list."""
        parts = []
        for name, text in self.units:
            parts += ["unit", name, text, *self.flags_per_unit.get(name, ("as all",))]
        for name in sorted(self.headers):
            parts += ["header", name, self.headers[name]]
        return parts


@dataclass(frozen=True)
class Origin:
    """Sources that are made only if no library of them is kept, and what they are made from.

    Args:
        parts: what the texts follow from, whatever it is: equal parts make equal texts.
        texts: makes them.
    """

    parts: Sequence[str]
    texts: Callable[[], Sources]
