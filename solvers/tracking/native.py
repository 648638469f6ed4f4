"""The compiled tick of :class:`Vwbc`: generated functions of the plan's modes, and a template."""

from __future__ import annotations

import ctypes as ct
from collections.abc import Mapping, Sequence
from functools import lru_cache
from importlib.resources import files

import casadi as cs

from piaffe.codegen import SOLVER_FLAGS, LoadedLibrary, NoCompilerError, build, generate, load
from piaffe.ocp import LoweredMode, moved_symbols

from ..ilqr import constants_header
from .components import driven, rates
from .rows import ControlRows

_TABLE = "static const int __attribute__((unused))"
_HEADERS = ("plan.h", "contacts.h", "tick.h", "mode.inc")


def tick_library(modes: Sequence[LoweredMode], rows: Mapping[LoweredMode, ControlRows]) -> LoadedLibrary | None:
    """Return the compiled tick of some modes; None if no compiler works.

    It is also None if ∂r/∂u depends on z in one.
    """
    if any(cs.depends_on(rows[mode].system[2], rows[mode].symbols[2]) for mode in modes if mode.nz):
        return None
    try:
        return _library(tuple(modes))
    except NoCompilerError:
        return None


@lru_cache(maxsize=16)
def _library(modes: tuple[LoweredMode, ...]) -> LoadedLibrary:
    functions: dict[str, cs.Function] = {}
    every = [ControlRows(mode) for mode in modes]
    for i, rows in enumerate(every):
        functions |= {f"tick{i}_{name}": f for name, f in _functions(rows).items()}
    made = generate(functions)
    template = files(__package__).joinpath("template")
    texts = {name: template.joinpath(name).read_text(encoding="utf-8") for name in (*_HEADERS, "tick.c")}
    qp = files("piaffe.solvers.qp").joinpath("template")
    programs = {name: qp.joinpath(name).read_text(encoding="utf-8") for name in ("dual.c", "elastic.inc")}
    names = [f"tick{i}_tick" for i in range(len(modes))]
    parts = [_kernel(i, rows, made.work) for i, rows in enumerate(every)]
    unit = texts["tick.c"].replace("TICK_PROTOTYPES", "\n".join(parts)).replace("TICK_FUNCTIONS", ", ".join(names))
    headers = {**made.headers, **{name: texts[name] for name in _HEADERS}, **programs}
    headers["constants.h"] = constants_header()
    units = [*((each.name, each.text) for each in made.units), ("tick", unit)]
    loaded = load(build(units, headers=headers, flags_per_unit={"tick": SOLVER_FLAGS}, width=1, label="low level"))
    loaded.piaffe_tick.restype = loaded.piaffe_scheduled.restype = None
    loaded.piaffe_tick.argtypes = (ct.c_void_p, ct.c_void_p, ct.c_double, ct.c_void_p, ct.c_void_p)
    loaded.piaffe_scheduled.argtypes = (ct.c_void_p, ct.c_double, ct.c_void_p)
    return loaded


def _functions(rows: ControlRows) -> dict[str, cs.Function]:
    """Return the functions of a mode; matrices are dense and row by row, ∂rows/∂z are its nonzeros."""
    (x, u, z, p), space, nu = rows.symbols, rows.mode.state, rows.mode.nu
    begin, end, measured = (cs.SX.sym(name, space.nx) for name in ("begin", "end", "measured"))
    share, anchor = cs.SX.sym("share"), cs.SX.sym("anchor", 3)
    nominal = space.plus(begin, share * space.minus(end, begin))
    x0, y0, yaw = cs.vertsplit(anchor)
    c, s = cs.cos(yaw), cs.sin(yaw)
    into = cs.vertcat(-(c * x0 + s * y0), s * x0 - c * y0, -yaw)  # undoes the motion from the origin to the anchor
    local = cs.vertcat(*moved_symbols([(q, measured[part]) for q, part in space.slices.items()], into))
    results = [cs.densify(each) for each in (nominal, space.minus(local, nominal), local)]
    found = {"deviation": cs.Function("deviation", [begin, end, share, measured, anchor], results, {"cse": True})}
    if turns(rows.mode):
        parts = [(q, u[part]) for q, part in rows.mode.model.control.slices.items()]
        found["world"] = cs.Function("world", [u, anchor], [cs.densify(cs.vertcat(*moved_symbols(parts, anchor)))])
    if outputs := rows.mode.outputs:
        values = rows.mode.functions["outputs"].call({"x": x, "u": u, "z": z, "p": p})["outputs"]
        parts, first = [], 0
        for quantity, size in outputs:
            parts.append((quantity, values[first : first + size]))
            first += size
        world = cs.densify(cs.vertcat(*moved_symbols(parts, anchor)))
        found["recorded"] = cs.Function("recorded", [x, u, z, p, anchor], [world], {"cse": True})
    if rows.mode.nz:
        system = cs.densify(cs.horzcat(*rows.system)).T
        found["implicit"] = cs.Function("implicit", [x, u, p], [system], {"cse": True})
    if rows.g or rows.h:
        weights = rows.mode.functions["stage_w"].call({"p": p})
        found["masks"] = cs.Function("masks", [p], [weights["g_mask"], weights["h_mask"]])
        by = cs.vertcat(rows.by_g, rows.by_h)
        value, by_u, by_z = cs.vertcat(*rows.values), cs.densify(by[:, :nu]).T, cs.sparsify(by[:, nu:])
        entries = by_z.nz[:] if by_z.nnz() else cs.SX(1, 1)
        found["rows"] = cs.Function("rows", [x, u, z, p], [cs.densify(value), by_u, cs.densify(entries)], {"cse": True})
    return found


def turns(mode: LoweredMode) -> bool:
    """Return whether controls of a mode turn with the frame, as forces do and torques do not."""
    return any(block.quantity.kind != "vector" for block in mode.model.control.blocks)


def _kernel(i: int, rows: ControlRows, work: Mapping[str, int]) -> str:
    """Return sizes and tables of a mode, then the template."""
    mode, nu = rows.mode, rows.mode.nu
    pattern = cs.sparsify(cs.vertcat(rows.by_g, rows.by_h)[:, nu:]).sparsity()
    speeds, position, velocity = -1, 0, 0
    block = rates(mode)
    if block is not None:
        speeds, (at, by) = mode.state.slices[block.quantity].start, driven(mode)
        position, velocity = at.start, by.start
    sizes = {
        "NX": mode.state.nx, "NDX": mode.state.ndx, "NU": nu, "NZ": mode.nz, "NP": mode.layout.size,
        "NG": len(mode.rows["stage_g"]), "NH": len(mode.rows["stage_h"]), "KEPT_G": len(rows.g), "KEPT_H": len(rows.h),
        "NUM_Z": pattern.nnz(), "NUM_BOUNDS": len(rows.bounds), "SPEED": speeds, "POSITION": position,
        "VELOCITY": velocity, "TURNS": int(turns(mode)), "NUM_RECORDED": sum(size for _, size in mode.outputs),
        "NUM_WORK": max(size for name, size in work.items() if name.startswith(f"tick{i}_")),
    }  # fmt: skip
    tables = {
        "kept_g": rows.g, "kept_h": rows.h, "soft_g": rows.soft.astype(int),
        "z_row": pattern.row(), "z_col": pattern.get_col(),
        "bound_row": [rows.g.index(row) for row, _ in rows.bounds], "bound_control": [c for _, c in rows.bounds],
    }  # fmt: skip
    lines = [f"#define {name} {value}" for name, value in sizes.items()]
    lines += [f"#define {name} tick{i}_{name}" for name in tables]
    lines += [f"#define NAMED(name) tick{i}_##name", f"#define GENERATED(name) tick{i}_##name"]
    lines += [f"{_TABLE} {name}[] = {{{', '.join(map(str, values)) or '0'}}};" for name, values in tables.items()]
    lines.append('#include "mode.inc"')
    lines += [f"#undef {name}" for name in (*sizes, *tables, "NAMED", "GENERATED", "NC", "ROWS")]
    return "\n".join(lines)
