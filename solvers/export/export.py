"""Export a controller: the sources of its libraries, its tables, and what makes a library of them without Python."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

from piaffe import __version__
from piaffe.codegen import SOLVER_FLAGS, Part, Project, check_name, write_files
from piaffe.errors import SolverError
from piaffe.ocp import Horizon, Problem

from ..ilqr import constants_header
from ..qp import QpStatus
from ..receding import HEADER, PART, Motions, Plan, RecedingHorizon
from ..tracking import LowLevel
from . import interface
from .build_files import build_values
from .header import header_values
from .layout import Layout, layout_of
from .manifest import LICENSE, manifest
from .measure import Measured, measure
from .memory import HANDOVER, ControllerMemory
from .planners import planner_values
from .readme import readme
from .record import Recorder

_TEMPLATES = {
    "controller.h": "include/NAME.h", "check.c": "examples/main.c", "loop.c": "examples/loop.c",
    "fuzz.c": "examples/fuzz.c",
    "controller.py.in": "python/NAME.py", "Makefile": "Makefile", "CMakeLists.txt": "CMakeLists.txt",
}  # fmt: skip
"""Template → its path in the project."""
_OWN = ("piaffe_fill", "piaffe_arena_bytes")


@dataclass(frozen=True)
class Exported:
    """An exported controller.

    Args:
        folder: where it is.
        name: its name in C.
        layout: sizes and orders.
        mpc: a planner in Python that makes the same plans.
        low: the low level in Python.
        plan_numbers: numbers of a plan in C.
    """

    folder: Path
    name: str
    layout: Layout
    mpc: RecedingHorizon | Motions
    low: LowLevel
    plan_numbers: int

    def check(self, seconds: float = 10.0) -> Measured:
        """Build the library with this machine's compiler, run its checks, and write what they find into the folder.

        ``manifest.json`` and ``README.md`` get the sizes, the result of ``make check`` and the times of ``make loop``.

        Args:
            seconds: duration of the run against the clock [s].

        Raises:
            SolverError: ``make`` or the compiler fails, there is no record, or numbers differ from it.
        """
        return measure(self.folder, self.name, seconds)

    def recorder(self) -> Recorder:
        """Return planner and low level in Python, which record what they do for ``examples/main.c``."""
        return Recorder(self.mpc, self.low, self.plan_numbers)


def export_controller(
    problem: Problem | Mapping[str, Problem],
    folder: Path | str,
    *,
    name: str,
    options: Mapping[str, Any] | None = None,
    low: Callable[[Plan], LowLevel],
    max_age: float | None = None,
) -> Exported:
    """Write a controller into a folder, as C.

    Args:
        problem: the declaration, or several by name, between which a command changes, see :class:`Motions`.
        folder: where to.
        name: of the controller in C: prefix of all names.
        options: arguments of :class:`RecedingHorizon`, or of :class:`Motions`.
        low: makes the low level from a plan.
        max_age: age of a state until which its plan acts [s], more than a period and the latency, or than two periods
            and the latency with several motions; by default the duration of the first model's part, at most 0.25 s or
            a period more than that.

    Raises:
        SolverError: the name or an age is unusable, planner or low level are not compiled, or the folder cannot be
            written.
    """
    folder, given = Path(folder), dict(options or {})
    check_name(name)
    several = not isinstance(problem, Problem)
    make: Callable[..., RecedingHorizon | Motions] = Motions if several else RecedingHorizon
    mpc = make(problem, **given)
    due = mpc.period * (1 + several) + mpc.latency
    reason = f"{'two periods' if several else 'a period'} and the latency, after which the next plan acts"
    if max_age is not None and not max_age > due:
        raise SolverError(
            f"export: max_age is out of range - got {max_age:g} s, expected more than {due:g} s, {reason}; change it"
        )
    untouched = make(problem, **given)
    plan = mpc.plan(mpc.initial, 0.0)
    made = low(plan)
    tick = getattr(made, "compiled", None)
    if untouched.compiled is None or tick is None:
        raise SolverError(
            f"export: {'the planner' if untouched.compiled is None else type(made).__name__} is not compiled - got "
            "NumPy, expected C; use backend='native' and qp='own', and install a C compiler"
        )
    layout = layout_of(mpc, made, plan)
    memory = ControllerMemory(untouched.compiled, tick)
    reach = min(_reach(each.horizon) for each in memory.planners)
    oldest = min(reach, max(0.25, due + mpc.period)) if max_age is None else float(max_age)
    if not oldest > due:
        raise SolverError(
            f"export: the horizon is too short - got {reach:g} s of the first model, expected more than {due:g} s, "
            f"{reason}; lengthen it"
        )
    values = {
        "CONSTANTS": interface.constants(layout, max(mpc.iterations, mpc.first_iterations)),
        "COMMAND": interface.commands(layout), "COMMAND_CODE": interface.command_code(layout),
        "NUM_ENTRIES": memory.plan_entries, "NUM_NUMBERS": memory.plan_numbers,
        "NUM_PHASES": (memory.plan_entries - HEADER) // PART,
        "NUM_COMMANDS": len(memory.code.commands),
        "PERIOD": repr(mpc.period), "LATENCY": repr(mpc.latency),
        "LOWER": interface.numbers(layout.lower), "UPPER": interface.numbers(layout.upper),
        "DECLARED": interface.numbers(memory.code.commands) or "0", "DAMPING": repr(float(made.damping)),
        "INITIAL": interface.numbers(mpc.initial), "PIAFFE": __version__, "NX": len(layout.state),
        "NU": len(layout.control),
        "COMMANDS": ", ".join(f'"{each}": {bit}' for each, bit in interface.command_bits(layout).items()),
        "MEMORY_BYTES": memory.bytes, "WIDTH": memory.code.width,
        "RELAXED": list(QpStatus).index(QpStatus.RELAXED), "FUZZ_COMMANDS": interface.fuzz_commands(layout),
        **interface.outputs(layout), **interface.contacts(memory.measured), "ITERATIONS": mpc.iterations,
        "TIME_LIMIT": repr(float(mpc.options.time_limit_s or 0.0)),
        "MAX_AGE": interface.numbers([oldest]), **header_values(layout, plan.phases[0].mode.model),
        **planner_values(layout.motions, layout.motions.index(mpc.start) if isinstance(mpc, Motions) else 0),
    }  # fmt: skip
    made_files = memory.files()
    parts = [Part("solver", memory.solver), Part("horizon", memory.horizon), Part("tick", memory.tick, wide=False)]
    project = Project(
        name, parts,
        units={"controller.c": _filled("controller.c", values, name), "memory.c": made_files["memory.c"]},
        headers={
            "private.h": _filled("private.h", values, name), "memory.h": made_files["memory.h"], "handover.h": HANDOVER,
            "constants.h": constants_header(),
        },
        flags=SOLVER_FLAGS, own_symbols=_OWN,
    )  # fmt: skip
    values |= build_values(project.flags_of_units())
    written: dict[str, str | bytes] = {f"src/{path}": text for path, text in project.sources().items()}
    written |= {target.replace("NAME", name): _filled(path, values, name) for path, target in _TEMPLATES.items()}
    written["README.md"] = _named(readme(layout, values), name)
    written["LICENSE"] = LICENSE
    written["manifest.json"] = manifest(problem, layout, values, name, given, written)
    write_files(folder, written)
    return Exported(folder, name, layout, mpc, made, memory.plan_numbers)


def _reach(horizon: Horizon) -> float:
    """Return the duration of the first model's part of a horizon [s]."""
    window = horizon.layout.windows[0]
    return float("inf") if window is None else window * horizon.calendar.tick


def _filled(path: str, values: Mapping[str, object], name: str) -> str:
    """Return a template with values, and with the controller's name in place of NAME."""
    text = files(__package__).joinpath("template", path).read_text(encoding="utf-8")
    for key, value in values.items():
        text = text.replace(f"@{key}@", str(value))
    return _named(text, name)


def _named(text: str, name: str) -> str:
    """Return a text with a controller's name in place of NAME."""
    text = re.sub(r"\bNAME_(?=[A-Z])", f"{name.upper()}_", text)
    text = re.sub(r"\bNAME_H\b", f"{name.upper()}_H", text)
    return re.sub(r"(?<![A-Z_])NAME(?![A-Z])", name, text)
