"""Warnings about a problem as Python's warnings, at the place in the user's file that they are about."""

from __future__ import annotations

import warnings
from collections.abc import Iterable

from piaffe.errors import PiaffeWarning
from piaffe.ocp import ProblemWarning

_REGISTRY: dict[str | tuple[str, type[Warning], int], int] = {}
"""What Python has shown: by default it shows a warning with the same text, file and line once."""


def issue(found: Iterable[ProblemWarning]) -> list[ProblemWarning]:
    """Issue each warning once as ``PiaffeWarning``; return them."""
    each = list(dict.fromkeys(found))
    for warning in each:
        file, line = ("piaffe", 0) if warning.source is None else (warning.source.file, warning.source.line)
        warnings.warn_explicit(str(warning), PiaffeWarning, file, line, registry=_REGISTRY)
    return each
