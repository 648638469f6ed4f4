"""The display of learning: one line on standard error, where it is a terminal."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TextIO

Progress = Callable[[str, int, int], None]
"""Called with the name of a stage, the number of its completed parts, and the number of all its parts."""

_ERASE = "\r\033[K"


@contextmanager
def shown_line(stream: TextIO | None = None) -> Iterator[Progress]:
    """Yield a function that rewrites one line with a stage and its parts; the line is erased at the end.

    Args:
        stream: where to write; standard error by default. Nothing is written unless it is a terminal.
    """
    target = sys.stderr if stream is None else stream
    if target is None or not target.isatty():
        yield silent
        return

    def show(stage: str, done: int, total: int) -> None:
        target.write(f"{_ERASE}{stage}: {done} of {total}")
        target.flush()

    try:
        yield show
    finally:
        target.write(_ERASE)
        target.flush()


def silent(stage: str, done: int, total: int) -> None:
    """Show nothing."""
