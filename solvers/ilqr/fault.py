"""Describe where a value or derivative is not finite: the function, its declaration, phase, node and time."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from piaffe.ocp import CompiledPhase, owner_of

from .iterate import Iterate, PhaseValues, ProblemFunctions, solve_nodes

Array = NDArray[np.float64]

_Table = tuple[str, str, int, Array]
"""Group of functions, name of the output, first node, values (nodes, rows, ...)."""


def fault(functions: ProblemFunctions, iterate: Iterate, outside: Iterate | None) -> str:
    """Return a sentence about the first number that is not finite at an iterate; empty if all are finite.

    If all numbers are finite at the iterate, the sentence is about a trial step from it.

    Args:
        functions: the problem's functions.
        iterate: the solver's iterate.
        outside: the last trial step whose merit was not finite, if there was one.
    """
    with np.errstate(all="ignore"):
        found = _values(functions, iterate) or _derivatives(functions, iterate)
        if found or outside is None:
            return found
        found = _values(functions, outside)
    return f"At a trial step from there, {found}" if found else ""


def _values(functions: ProblemFunctions, iterate: Iterate) -> str:
    values = functions.all_values(iterate)
    for i, (phase, x, u, v) in enumerate(
        zip(functions.problem.phases, iterate.states, iterate.controls, values, strict=True)
    ):
        for what, table, labels in (
            ("state", x, phase.mode.state.stored_labels),
            ("control", u, phase.mode.model.control.labels),
        ):
            if not np.all(np.isfinite(table)):
                node, row = (int(k) for k in np.argwhere(~np.isfinite(table))[0])
                return _sentence(phase, f"{what} '{labels[row].strip()}'", "", node, table[node, row])
        found = _first(functions, i, _value_tables(phase, v), "")
        if found:
            return found
    return ""


def _value_tables(phase: CompiledPhase, v: PhaseValues) -> Iterator[_Table]:
    n = phase.num_stages
    yield "stage", "K", 0, v.K
    yield "stage", "z", 0, v.z
    yield "stage", "x_next", 0, v.x_next
    yield "stage", "residual", 0, v.residual
    yield "stage", "g", 0, np.where(phase.g_mask > 0, v.g, 0.0)
    yield "stage", "h", 0, np.where(phase.h_mask > 0, v.h, 0.0)
    yield "terminal", "residual", n, v.end_residual[None]
    yield "terminal", "g", n, np.where(phase.end_g_mask > 0, v.end_g, 0.0)[None]
    yield "terminal", "h", n, np.where(phase.end_h_mask > 0, v.end_h, 0.0)[None]
    yield "reset", "x_next", n, np.concatenate([v.K_reset.ravel(), v.z_reset, v.x_reset])[None]


def _derivatives(functions: ProblemFunctions, iterate: Iterate) -> str:
    values = functions.all_values(iterate)
    for i, phase in enumerate(functions.problem.phases):
        x, u, f, n = iterate.states[i], iterate.controls[i], phase.mode.functions, phase.num_stages
        by_stage = dict(zip(
            f["stage_d"].name_out(), functions.call(f["stage_d"], x[:-1], u, values[i].z, phase.p, x[1:]), strict=True
        ))  # fmt: skip
        at_end = dict(zip(f["terminal_d"].name_out(), functions.end_jacobians(i, iterate, values[i]), strict=True))
        tables: list[_Table] = [("stage", name, 0, table) for name, table in by_stage.items()]
        if phase.mode.nz:
            tables.append(("stage", "z", 0, solve_nodes(values[i].K, by_stage["r_w"])))
        tables += [("terminal", name, n, table[None]) for name, table in at_end.items()]
        jacobian = functions.reset_jacobian(i, iterate, values[i])
        if jacobian is not None:
            tables.append(("reset", "x_next", n, jacobian.reshape(1, -1)))
        found = _first(functions, i, iter(tables), "derivative of ")
        if found:
            return found
    return ""


def _first(functions: ProblemFunctions, i: int, tables: Iterator[_Table], of: str) -> str:
    """Return a sentence about the first entry that is not finite, by node and then in the order of the tables."""
    phase, earliest, found = functions.problem.phases[i], np.inf, ""
    for group, name, first, table in tables:
        flat = table.reshape(len(table), -1)
        bad = [at for at in np.argwhere(~np.isfinite(flat)) if _counts(phase, group, name, first, at, table.shape[2:])]
        if len(bad) == 0 or first + bad[0][0] >= earliest:
            continue
        node, entry = (int(k) for k in bad[0])
        earliest = first + node
        row = entry // max(int(np.prod(table.shape[2:])), 1)
        found = _sentence(phase, _owner(functions, phase, group, name, row), of, first + node, flat[node, entry])
    return found


def _counts(
    phase: CompiledPhase, group: str, name: str, first: int, at: NDArray[np.intp], columns: tuple[int, ...]
) -> bool:
    """Return whether an entry of a table has an effect: rows of terms have none at nodes where the term does not apply.

    Args:
        phase: the phase.
        group: group of functions.
        name: name of the output.
        first: first node of the table.
        at: node in the table and entry.
        columns: shape of a row.
    """
    kind = name.split("_")[0]
    if kind not in ("residual", "g", "h"):
        return True
    rows = phase.end_rows(kind) if group == "terminal" else phase.mode.rows[f"{group}_{kind}"]
    term = rows[int(at[1]) // max(int(np.prod(columns)), 1)].term
    return term < 0 or bool(phase.applies[first + int(at[0]), term])


def _owner(functions: ProblemFunctions, phase: CompiledPhase, group: str, name: str, row: int) -> str:
    if group == "stage" and name in ("K", "r0", "z", "r_w"):
        model = phase.mode.model
        return f"implicit dynamics of model '{model.name}' ({phase.interval.phase.source}), accelerations and forces"
    if group == "stage" and name in ("d_w", "d_z"):
        label = phase.mode.state.labels[row].strip()
        return f"dynamics of model '{phase.mode.model.name}' ({phase.interval.phase.source}), next '{label}'"
    return owner_of(functions.problem, phase, group, name, row)


def _sentence(phase: CompiledPhase, owner: str, of: str, node: int, got: float) -> str:
    what = "NaN" if np.isnan(got) else "infinite"
    return (
        f"{of}{owner} is {what} in phase '{phase.name}' ({phase.label}), node {node}, at {phase.times[node]:.4g} s; "
        "keep it in its domain with a bound, another start or another expression."
    )
