"""manifest.json of an exported controller: what it was made from, and a hash of each file."""

from __future__ import annotations

import hashlib
import json
import platform
from collections.abc import Mapping
from importlib.resources import files
from typing import Any

import casadi as cs
import numpy as np

from piaffe import __version__
from piaffe.ocp import Problem

from .layout import Layout

LICENSE = files(__package__).joinpath("template", "LICENSE").read_text(encoding="utf-8")


def manifest(
    problem: Problem | Mapping[str, Problem],
    layout: Layout,
    values: Mapping[str, Any],
    name: str,
    options: Mapping[str, Any],
    written: Mapping[str, str | bytes],
) -> str:
    """Return the text.

    Args:
        problem: the declaration, or several by name.
        layout: of the controller.
        values: what the templates name.
        name: of the controller.
        options: of the receding horizon.
        written: the files of the project, by their paths.
    """
    told = {
        "name": name, "piaffe": __version__, "casadi": cs.CasadiMeta.version(), "python": platform.python_version(),
        "declaration": _hash(str(problem)), "motions": list(layout.motions),
        "options": {key: str(value) for key, value in options.items()},
        "period_s": float(values["PERIOD"]), "latency_s": float(values["LATENCY"]),
        "iterations": int(values["ITERATIONS"]), "time_limit_s": float(values["TIME_LIMIT"]),
        "plan_numbers": int(values["NUM_NUMBERS"]), "stack_bytes": 65536,
        "memory_bytes_about": values["MEMORY_BYTES"], "vector_width": values["WIDTH"],
        "max_age_s": _number(float(values["MAX_AGE"].replace("INFINITY", "inf"))), "damping": float(values["DAMPING"]),
        "torque_limits": [[_number(each) for each in side] for side in (layout.lower, layout.upper)],
        "source_bytes": sum(len(text) for text in written.values()),
        "files": {path: _hash(text) for path, text in sorted(written.items())},
    }  # fmt: skip
    return json.dumps(told, indent=2) + "\n"


def _number(value: float) -> float | None:
    """Return a number as JSON has it: null for infinity."""
    return float(value) if np.isfinite(value) else None


def _hash(content: str | bytes) -> str:
    return hashlib.sha256(content.encode() if isinstance(content, str) else content).hexdigest()
