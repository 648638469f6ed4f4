"""Where a declaration was written: the file and line that messages name."""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass


@dataclass(frozen=True)
class Source:
    """A place in a user's file."""

    file: str
    line: int

    def __str__(self) -> str:
        return f"{self.file.rpartition(os.sep)[2]}:{self.line}"


def caller() -> Source:
    """Return the innermost place on the call stack outside Piaffe, ``dataclasses`` and ``functools``."""
    frame = sys._getframe(1)
    while frame.f_back is not None:
        module = frame.f_globals.get("__name__", "")
        if not module.startswith("piaffe.") and module not in ("dataclasses", "functools"):
            break
        frame = frame.f_back
    return Source(frame.f_code.co_filename, frame.f_lineno)
