"""Export a controller: the sources of its libraries, its tables, and what makes a library of them without Python."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from piaffe.codegen import SOLVER_FLAGS, Part, Project, write_files
from piaffe.errors import SolverError
from piaffe.ocp import Problem

from ..ilqr import constants_header
from ..receding import HEADER, PART, Plan, RecedingHorizon
from ..tracking import LowLevel
from .build_files import build_files
from .layout import Layout, layout_of
from .memory import HANDOVER, ControllerMemory

_TEMPLATES = ("controller.h", "private.h", "controller.c", "check.c", "controller.py.in")
_OWN = ("piaffe_fill", "piaffe_arena_bytes")


@dataclass(frozen=True)
class Exported:
    """An exported controller.

    Args:
        folder: where it is.
        name: its name in C.
        layout: sizes and orders.
        mpc: the planner that was exported; it has made no plan since.
        low: the low level.
    """

    folder: Path
    name: str
    layout: Layout
    mpc: RecedingHorizon
    low: LowLevel


def export_controller(
    problem: Problem,
    folder: Path | str,
    *,
    name: str,
    options: Mapping[str, Any] | None = None,
    low: Callable[[Plan], LowLevel],
    max_age: float | None = None,
) -> Exported:
    """Write a controller into a folder, as C.

    Args:
        problem: the declaration.
        folder: where to.
        name: of the controller in C: prefix of all names.
        options: arguments of :class:`RecedingHorizon`.
        low: makes the low level from a plan.
        max_age: age of a state until which its plan acts [s]; by default the duration of the first model's part.

    Raises:
        SolverError: planner or low level are not compiled, or the folder cannot be written.
    """
    folder, given = Path(folder), dict(options or {})
    mpc, untouched = RecedingHorizon(problem, **given), RecedingHorizon(problem, **given)
    plan = mpc.plan(problem.initial, 0.0)
    made = low(plan)
    tick = getattr(made, "compiled", None)
    if untouched.compiled is None or tick is None:
        raise SolverError(
            f"export: {'the planner' if untouched.compiled is None else type(made).__name__} is not compiled - got "
            "NumPy, expected C; use backend='native' and qp='own', and install a C compiler"
        )
    layout = layout_of(mpc, made, plan)
    memory = ControllerMemory(untouched.compiled, tick)
    window = untouched.horizon.layout.windows[0]
    reach = np.inf if window is None else window * untouched.horizon.calendar.tick
    values = {
        "CONSTANTS": _constants(layout), "COMMAND": _commands(layout), "COMMAND_CODE": _command_code(layout),
        "NUM_ENTRIES": memory.planner.plan_entries, "NUM_NUMBERS": memory.planner.plan_numbers,
        "NUM_PHASES": (memory.planner.plan_entries - HEADER) // PART,
        "NUM_COMMANDS": len(memory.planner.tables.commands),
        "PERIOD": repr(mpc.period), "LATENCY": repr(mpc.latency),
        "LOWER": _numbers(layout.lower), "UPPER": _numbers(layout.upper),
        "DECLARED": _numbers(memory.planner.tables.commanded({})) or "0", "DAMPING": repr(float(made.damping)),
        "NX": len(layout.state), "NU": len(layout.control),
        "COMMANDS": ", ".join(f'"{each}": {1 << i}' for i, each in enumerate(layout.commands)),
        "MAX_AGE": _numbers([min(reach, 0.25) if max_age is None else max_age]),
    }  # fmt: skip
    own = {path: _filled(path, values, name) for path in _TEMPLATES}
    parts = [Part("solver", memory.solver), Part("horizon", memory.horizon), Part("tick", memory.tick, wide=False)]
    made_files = memory.files()
    project = Project(
        name, parts,
        units={"controller.c": own["controller.c"], "memory.c": made_files["memory.c"]},
        headers={
            "private.h": own["private.h"], "memory.h": made_files["memory.h"], "handover.h": HANDOVER,
            "constants.h": constants_header(),
        },
        flags=SOLVER_FLAGS, own_symbols=_OWN,
    )  # fmt: skip
    written: dict[str, str | bytes] = {f"src/{path}": text for path, text in project.sources().items()}
    written |= {f"include/{name}.h": own["controller.h"], "examples/main.c": own["check.c"]}
    written[f"python/{name}.py"] = own["controller.py.in"]
    written |= build_files(name, project.flags_of_units())
    write_files(folder, written)
    return Exported(folder, name, layout, untouched, made)


def _filled(path: str, values: Mapping[str, object], name: str) -> str:
    """Return a template with values, and with the controller's name in place of NAME."""
    text = files(__package__).joinpath("template", path).read_text(encoding="utf-8")
    for key, value in values.items():
        text = text.replace(f"@{key}@", str(value))
    text = re.sub(r"\bNAME_(?=[A-Z])", f"{name.upper()}_", text)
    text = re.sub(r"\bNAME_H\b", f"{name.upper()}_H", text)
    return re.sub(r"(?<![A-Z_])NAME(?![A-Z])", name, text)


def _numbers(values: Any) -> str:
    """Return numbers as C."""
    texts = {np.inf: "INFINITY", -np.inf: "-INFINITY"}
    return ", ".join(texts.get(float(each), repr(float(each))) for each in values)


def _constants(layout: Layout) -> str:
    lines = [
        f"NAME_NX = {len(layout.state)}, /* state */", f"NAME_NU = {len(layout.control)}, /* torques */",
        f"NAME_JOINT_VELOCITY = {layout.speeds} /* place of the joints' speeds in the state */",
    ]  # fmt: skip
    return "enum {\n" + "".join(f"    {line}\n" for line in lines) + "};"


def _commands(layout: Layout) -> str:
    names = list(layout.commands)
    bits = ", ".join(f"NAME_{name.upper()} = {1 << i}" for i, name in enumerate(names))
    fields = "".join(f"    double {name};\n" for name in names)
    enum = f"enum {{ {bits} }};\n" if names else ""
    told = f"typedef struct {{\n    unsigned set;\n{fields}}} NAME_commands;"
    return f"/* Commands. Those whose bit is in `set` change. */\n{enum}{told}"


def _command_code(layout: Layout) -> str:
    lines = []
    for name in layout.commands:
        places = "".join(f" wanted[{at}] = commands->{name};" for at in layout.places[name])
        lines.append(
            f"    if (commands->set & NAME_{name.upper()}) {{\n"
            f"        if (!isfinite(commands->{name})) return NAME_BAD_COMMAND;\n       {places}\n    }}\n"
        )
    return (
        "int NAME_command(NAME *c, const NAME_commands *commands)\n{\n"
        "    if (!c || !commands) return NAME_BAD_ARGUMENT;\n"
        f"    if (commands->set & ~{(1 << len(layout.commands)) - 1}u) return NAME_BAD_COMMAND;\n"
        "    double wanted[NUM_COMMANDS + 1];\n    memcpy(wanted, c->wanted, sizeof wanted);\n"
        f"{''.join(lines)}"
        "    memcpy(c->wanted, wanted, sizeof wanted);\n"
        "    memcpy(c->told[c->commands.back], wanted, sizeof wanted);\n    hand_over(&c->commands);\n"
        "    return NAME_OK;\n}"
    )
