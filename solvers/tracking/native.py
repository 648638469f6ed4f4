"""A tick of :class:`Vwbc` in C: generated functions of the plan's modes, a template, and the plan in C memory."""

from __future__ import annotations

import ctypes as ct
from collections.abc import Mapping, Sequence
from functools import lru_cache
from importlib.resources import files
from typing import Any

import casadi as cs
import numpy as np
from numpy.typing import NDArray

from piaffe.codegen import SOLVER_FLAGS, NoCompilerError, build, generate, load
from piaffe.ocp import LoweredMode

from .plan import PlanPhase, StagedPlan
from .rows import ControlRows

Array = NDArray[np.float64]

_TABLE = "static const int __attribute__((unused))"
_ARRAYS = ("times", "x", "u", "K", "Q_u", "Q_ux", "Q_uu", "p", "g_mask", "h_mask", "kept")


class _Phase(ct.Structure):
    _fields_ = [("mode", ct.c_int), ("stages", ct.c_int), *((name, ct.c_void_p) for name in (*_ARRAYS, "measured_at"))]


class _LowLevel(ct.Structure):
    _fields_ = [
        ("num_phases", ct.c_int), ("gains", ct.c_int), ("num_measured", ct.c_int), ("phases", ct.c_void_p),
        ("kp", ct.c_void_p), ("kd", ct.c_void_p), ("measured", ct.c_void_p), ("damping", ct.c_double),
        ("gradient", ct.c_double),
    ]  # fmt: skip


class Outcome(ct.Structure):
    """What a tick did; see ``tick.h``."""

    _fields_ = [
        ("status", ct.c_int), ("iterations", ct.c_int), ("damped", ct.c_int), ("mode", ct.c_int),
        ("num_active", ct.c_int), ("active", ct.c_void_p),
    ]  # fmt: skip


def tick_library(modes: Sequence[LoweredMode], rows: Mapping[LoweredMode, ControlRows]) -> ct.CDLL | None:
    """Return the compiled tick of some modes; None if no compiler works.

    It is also None if the modes are of several models, or if ∂r/∂u depends on z in one.
    """
    if len({mode.model for mode in modes}) > 1:
        return None
    if any(cs.depends_on(rows[mode].system[2], rows[mode].symbols[2]) for mode in modes if mode.nz):
        return None
    try:
        return _library(tuple(modes))
    except NoCompilerError:
        return None


@lru_cache(maxsize=16)
def _library(modes: tuple[LoweredMode, ...]) -> ct.CDLL:
    functions: dict[str, cs.Function] = {}
    every = [ControlRows(mode) for mode in modes]
    for i, rows in enumerate(every):
        functions |= {f"tick{i}_{name}": f for name, f in _functions(rows).items()}
    made = generate(functions)
    template = files(__package__).joinpath("template")
    texts = {name: template.joinpath(name).read_text(encoding="utf-8") for name in ("tick.h", "tick.c", "mode.inc")}
    dual = files("piaffe.solvers.qp").joinpath("template", "dual.c").read_text(encoding="utf-8")
    names = [f"tick{i}_tick" for i in range(len(modes))]
    parts = [_kernel(i, rows, made.work) for i, rows in enumerate(every)]
    unit = texts["tick.c"].replace("TICK_PROTOTYPES", "\n".join(parts)).replace("TICK_FUNCTIONS", ", ".join(names))
    headers = {**made.headers, "tick.h": texts["tick.h"], "mode.inc": texts["mode.inc"], "dual.c": dual}
    units = [*((each.name, each.text) for each in made.units), ("tick", unit)]
    loaded = load(build(units, headers=headers, flags_per_unit={"tick": SOLVER_FLAGS}, width=1, label="low level"))
    loaded.piaffe_tick.restype = None
    loaded.piaffe_tick.argtypes = (ct.c_void_p, ct.c_void_p, ct.c_double, ct.c_void_p, ct.c_void_p)
    return loaded


def _functions(rows: ControlRows) -> dict[str, cs.Function]:
    """Return the functions of a mode; matrices are dense and row by row, ∂rows/∂z are its nonzeros."""
    (x, u, z, p), space, nu = rows.symbols, rows.mode.state, rows.mode.nu
    begin, end, measured = (cs.SX.sym(name, space.nx) for name in ("begin", "end", "measured"))
    share = cs.SX.sym("share")
    nominal = space.plus(begin, share * space.minus(end, begin))
    deviation = space.minus(measured, nominal)
    found = {
        "deviation": cs.Function(
            "deviation", [begin, end, share, measured], [cs.densify(nominal), cs.densify(deviation)]
        )
    }
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


def _kernel(i: int, rows: ControlRows, work: Mapping[str, int]) -> str:
    """Return sizes and tables of a mode, then the template."""
    mode, nu = rows.mode, rows.mode.nu
    pattern = cs.sparsify(cs.vertcat(rows.by_g, rows.by_h)[:, nu:]).sparsity()
    speeds, position, velocity = -1, 0, 0
    labels = tuple(label for block in mode.model.control.blocks for label in block.labels)
    for block in mode.state.blocks:
        if block.rate_of is not None and block.labels == labels:
            speeds, slices = mode.state.slices[block.quantity].start, mode.state.tangent_slices
            position, velocity = slices[block.rate_of].start, slices[block.quantity].start
    sizes = {
        "NX": mode.state.nx, "NDX": mode.state.ndx, "NU": nu, "NZ": mode.nz, "NP": mode.layout.size,
        "NG": len(mode.rows["stage_g"]), "NH": len(mode.rows["stage_h"]), "KEPT_G": len(rows.g), "KEPT_H": len(rows.h),
        "NUM_Z": pattern.nnz(), "NUM_BOUNDS": len(rows.bounds), "SPEED": speeds, "POSITION": position,
        "VELOCITY": velocity, "NUM_WORK": max(size for name, size in work.items() if name.startswith(f"tick{i}_")),
    }  # fmt: skip
    tables = {
        "kept_g": rows.g, "kept_h": rows.h, "z_row": pattern.row(), "z_col": pattern.get_col(),
        "bound_row": [rows.g.index(row) for row, _ in rows.bounds], "bound_control": [c for _, c in rows.bounds],
    }  # fmt: skip
    lines = [f"#define {name} {value}" for name, value in sizes.items()]
    lines += [f"#define {name} tick{i}_{name}" for name in tables]
    lines += [f"#define NAMED(name) tick{i}_##name", f"#define GENERATED(name) tick{i}_##name"]
    lines += [f"{_TABLE} {name}[] = {{{', '.join(map(str, values)) or '0'}}};" for name, values in tables.items()]
    lines.append('#include "mode.inc"')
    lines += [f"#undef {name}" for name in (*sizes, *tables, "NAMED", "GENERATED", "NC", "ROWS")]
    return "\n".join(lines)


class NativeTick:
    """A plan in C memory, and the memory of a tick; nothing is allocated in :meth:`__call__` but the result.

    Args:
        library: the compiled tick of the plan's modes.
        modes: the modes of the library.
        plan: the plan.
        numbers: parameters of each phase in the low level (N, np), and masks of its inequality and equality rows.
        kept: per mode, 0 for components of the tangent that do not count (ndx,).
        gains: kp and kd (nu,); None for none.
        damping: of the last resort.
        gradient: factor of Q_u.
    """

    def __init__(
        self,
        library: ct.CDLL,
        modes: Sequence[LoweredMode],
        plan: StagedPlan,
        numbers: Sequence[tuple[Array, Array, Array]],
        kept: Mapping[LoweredMode, Array],
        gains: tuple[Array, Array] | None,
        damping: float,
        gradient: float,
    ) -> None:
        self._phases_of_plan = plan.phases
        self._kept_alive: list[Any] = []
        phases = (_Phase * len(plan.phases))()
        for target, phase, own in zip(phases, plan.phases, numbers, strict=True):
            arrays = self._arrays(phase, own, kept[phase.mode])
            target.mode, target.stages = modes.index(phase.mode), len(phase.controls)
            for name, array in zip(_ARRAYS, arrays, strict=True):
                setattr(target, name, array.ctypes.data)
        nu = modes[0].nu
        kp, kd = (self._keep(part) for part in (gains or (np.zeros(nu), np.zeros(nu))))
        self._low = _LowLevel(
            len(phases),
            int(gains is not None),
            0,
            ct.addressof(phases),
            kp.ctypes.data,
            kd.ctypes.data,
            None,
            damping,
            gradient,
        )
        self._phases = phases
        most = max(len(mode.rows["stage_g"]) for mode in modes)
        self.active = np.zeros(max(most, 1), dtype=np.int32)
        self.outcome = Outcome(active=self.active.ctypes.data)
        self._x, self._u = np.zeros(modes[0].state.nx), np.zeros(nu)
        self._call = library.piaffe_tick
        self._arguments = (
            ct.addressof(self._low), self._x.ctypes.data, self._u.ctypes.data, ct.addressof(self.outcome)
        )  # fmt: skip

    def __call__(self, x: Array, t: float) -> Array:
        """Return the control of a state (nx,) at a time [s], (nu,); ``outcome`` and ``active`` tell of it."""
        low, state, control, outcome = self._arguments
        self._x[:] = x
        self._call(low, state, t, control, outcome)
        return self._u.copy()

    def measure(self, slots: Mapping[LoweredMode, Sequence[tuple[slice, Array]]]) -> None:
        """Set parameters of each mode in the following ticks, as places and values."""
        places, values = {}, np.zeros(0)
        for mode, changes in slots.items():
            at = [np.arange(where.start, where.stop) for where, _ in changes]
            own = [np.broadcast_to(value, each.shape) for (_, value), each in zip(changes, at, strict=True)]
            places[mode] = np.concatenate([np.zeros(0), *at]).astype(np.int32)
            values = np.concatenate([np.zeros(0), *own])
        self._measured = places, values
        for target, phase in zip(self._phases, self._phases_of_plan, strict=True):
            target.measured_at = places[phase.mode].ctypes.data
        self._low.measured, self._low.num_measured = values.ctypes.data, len(values)

    def _keep(self, values: Array) -> Array:
        array = np.ascontiguousarray(values, dtype=float)
        self._kept_alive.append(array)
        return array

    def _arrays(self, phase: PlanPhase, numbers: tuple[Array, Array, Array], kept: Array) -> list[Array]:
        tables = (
            phase.times, phase.states, phase.controls, phase.feedback, phase.Q_u, phase.Q_ux, phase.Q_uu,
            *numbers, kept,
        )  # fmt: skip
        return [self._keep(table) for table in tables]
