"""The arguments that a function of Piaffe takes, for errors of a call that does not fit."""

from __future__ import annotations

import inspect
import re
import sys
from collections.abc import Callable
from typing import Any

_UNFIT = re.compile(r"^([\w.]+)\(\) (?:got an unexpected keyword argument|got multiple values|missing \d|takes )")
_NAMES = re.compile(r"'(\w+)'")


def arguments_of_call(error: Exception) -> str:
    """Return the arguments of the function that a call did not fit, in words; empty for any other error.

    An argument that is missing is described by its line in the docstring.

    Args:
        error: what the call raised.
    """
    found = _UNFIT.match(str(error)) if isinstance(error, TypeError) else None
    function = _function(found[1]) if found else None
    if found is None or function is None:
        return ""
    names = [name.lstrip("*") for name in inspect.signature(function).parameters if name != "self"]
    lines = _described(inspect.getdoc(function) or "")
    missing = [name for name in _NAMES.findall(str(error)) if "missing" in found[0] and name in lines]
    said = "".join(f" ({name}: {lines[name].rstrip('.')})" for name in missing)
    return f"the arguments {', '.join(names)}{said}"


def _function(name: str) -> Callable[..., Any] | None:
    """Return the public function, class or method of Piaffe with a qualified name; None if there is none."""
    owner = name.removesuffix(".__init__")
    for module in [each for key, each in sorted(sys.modules.items()) if key.startswith("piaffe.")]:
        found: Any = module
        for part in owner.split("."):
            found = getattr(found, part, None) if not part.startswith("_") else None
        if callable(found) and str(getattr(found, "__module__", "")).startswith("piaffe."):
            return found  # type: ignore[no-any-return]
    return None


def _described(doc: str) -> dict[str, str]:
    """Return the lines of the section Args of a docstring by the names of the arguments."""
    section = doc.partition("Args:\n")[2]
    return dict(re.findall(r"^    (\w+): (.+)$", section, flags=re.MULTILINE))
