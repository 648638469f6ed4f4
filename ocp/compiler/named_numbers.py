"""Numbers by name: what of a compiled problem may vary from instance to instance, and instances with other values.

=====================  ==========================================================================
name                   number
=====================  ==========================================================================
``"NAME"``             an ``ocp.parameter``
``"MODEL.SLOT"``       a model's: ``"mini_cheetah.link_mass"``, ``"mini_cheetah.terrain"``
``"TERM.PARAMETER"``   a term's own: ``"friction cone.mu"``
``"TERM.weight"``      a cost's weights, where they are not all zero: where it applies
``"TERM.target"``      a cost's own target (``to=``), if it is no rotation
``"TERM.lower"``, ...  a constraint's bounds, if it has that side
=====================  ==========================================================================

Terms that share a name are told apart by their order, ``"TERM[0].weight"``.
"""

from __future__ import annotations

import threading
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache

import casadi as cs
import numpy as np
from numpy.typing import ArrayLike, NDArray

from piaffe.errors import ProblemError, ShapeError, UnknownNameError

from ..language import Cost, numbers_of
from .compiled import CompiledPhase, CompiledProblem
from .layout import Layout
from .vectorised import Vectorised

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class NamedNumber:
    """A number of a problem that may vary.

    Args:
        name: its name.
        value: what it is now, (size,); of a number that differs from phase to phase the first.
        slots: its parts of the parameter vectors, as (model name, slot); the name is empty for those of every model.
    """

    name: str
    value: Array
    slots: tuple[tuple[str, str], ...]

    @property
    def size(self) -> int:
        """Number of entries."""
        return self.value.size

    @property
    def is_bound(self) -> bool:
        """Whether it is a constraint's bound, which may be infinite."""
        return self.slots[0][1].rpartition(".")[2] in ("lower", "upper")


def named_numbers(compiled: CompiledProblem) -> dict[str, NamedNumber]:
    """Return every number that may vary, by name."""
    found: dict[str, NamedNumber] = {}
    names = _term_names(compiled)
    for phase in compiled.phases:
        model = phase.mode.model.name
        tables = [(phase.mode.layout, phase.p), (phase.mode.layout, phase.p_end[None])]
        if phase.transition is not None:
            tables.append((phase.transition.layout, phase.p_transition[None]))
        for layout, table in tables:
            for slot, part in layout.slices.items():
                name = _name(compiled, names, model, slot)
                if not name:
                    continue
                where = (model if slot.startswith("model.") else "", slot)
                values = table[:, part]
                shown = values[int(np.argmax(np.any(values != 0, axis=1)))].copy()
                side = slot.rpartition(".")[2]
                if side in ("lower", "upper"):
                    has = table[0, layout.slices[slot.replace(side, f"has_{side}")]]
                    shown = np.where(has > 0, shown, -np.inf if side == "lower" else np.inf)
                known = found.get(name)
                if known is None:
                    found[name] = NamedNumber(name, shown, (where,))
                elif not np.any(known.value) and np.any(shown):
                    found[name] = replace(known, value=shown)
    return found


def check_value(compiled: CompiledProblem, number: NamedNumber, value: ArrayLike, where: str) -> Array:
    """Return a value for a number, (size,); raise if it has another size or is not finite.

    Raises:
        ShapeError: it has another size.
        ProblemError: it is not finite, or a negative weight.
    """
    array = numbers_of(value, where, f"number '{number.name}'")
    if array.shape != (number.size,):
        raise ShapeError(
            f"{where}, number '{number.name}': wrong size - got shape {array.shape}, expected ({number.size},); give "
            "as many entries as it has now"
        )
    bad = np.isnan(array) if number.is_bound else ~np.isfinite(array)
    if np.any(bad):
        entry = int(np.argmax(bad))
        raise ProblemError(
            f"{where}, number '{number.name}': is not finite - got {array[entry]} at entry {entry}, expected finite "
            "numbers; fix it"
        )
    if number.slots[0][1].endswith(".weight") and np.any(array < 0):
        raise ProblemError(
            f"{where}, number '{number.name}': weight is unusable - got {array.tolist()}, expected numbers ≥ 0; fix it"
        )
    return array


def find_number(numbers: Mapping[str, NamedNumber], name: str, where: str) -> NamedNumber:
    """Return a number by its name.

    Raises:
        UnknownNameError: there is none; the message lists those that exist.
    """
    if name not in numbers:
        raise UnknownNameError(where, "number", name, numbers)
    return numbers[name]


def with_numbers(
    compiled: CompiledProblem, values: Mapping[str, ArrayLike], initial: ArrayLike | None = None
) -> CompiledProblem:
    """Return the problem with other numbers and another initial state; see :meth:`CompiledProblem.with_numbers`."""
    known = named_numbers(compiled) if values else {}
    slots: dict[tuple[str, str], Array] = {}
    for name, value in values.items():
        number = find_number(known, name, "with_numbers")
        array = check_value(compiled, number, value, "with_numbers")
        slots |= dict.fromkeys(number.slots, array)
    start = compiled.initial if initial is None else initial_state(compiled, initial, "with_numbers")
    return instance(compiled, slots, start)


def initial_state(compiled: CompiledProblem, initial: ArrayLike, where: str) -> Array:
    """Return an initial state, (nx,), its quaternions of unit length.

    Raises:
        ShapeError: it has another size.
        ProblemError: it is not finite, or a quaternion is zero.
    """
    state = compiled.phases[0].mode.state
    x = numbers_of(initial, where, "initial state")
    if x.shape != (state.nx,):
        raise ShapeError(
            f"{where}: initial state has the wrong size - got shape {x.shape}, expected ({state.nx},): "
            f"{', '.join(f'{b.quantity.path} {b.nx}' for b in state.blocks)}; build it with the model's state()"
        )
    bad = np.flatnonzero(~np.isfinite(x))
    if bad.size:
        raise ProblemError(
            f"{where}, initial state, '{state.stored_labels[bad[0]]}': is not finite - got {x[bad[0]]} at entry "
            f"{bad[0]}, expected finite numbers; fix it"
        )
    for quantity, part in state.slices.items():
        if quantity.kind == "rotation" and not np.any(x[part]):
            raise ProblemError(
                f"{where}: initial state has no '{quantity}' - got a quaternion of zeros, expected one of unit length; "
                "give (1, 0, 0, 0) for none"
            )
    return state.np_normalise(x)


def instance(compiled: CompiledProblem, slots: Mapping[tuple[str, str], Array], initial: Array) -> CompiledProblem:
    """Return the problem with other values in parts of its parameter vectors, already checked, and another start."""
    phases = []
    for i, phase in enumerate(compiled.phases):
        own = {slot: value for (model, slot), value in slots.items() if model in ("", phase.mode.model.name)}
        changed = _renumbered(compiled, phase, own) if own else phase
        if i == 0 and initial is not compiled.initial:
            guess = changed.guess_states.copy()
            guess[0] = initial
            changed = replace(changed, guess_states=guess)
        phases.append(changed)
    return replace(compiled, phases=tuple(phases), initial=initial)


def _renumbered(compiled: CompiledProblem, phase: CompiledPhase, slots: Mapping[str, Array]) -> CompiledPhase:
    p, p_end = phase.p.copy(), phase.p_end[None].copy()
    p_transition = phase.p_transition
    for table in (p, p_end):
        for slot, value in slots.items():
            _put(compiled, table, phase.mode.layout, slot, value)
    if phase.transition is not None:
        table = phase.p_transition[None].copy()
        for slot, value in slots.items():
            _put(compiled, table, phase.transition.layout, slot, value)
        p_transition = table[0]
    if any(slot.endswith((".lower", ".upper")) for slot in slots):
        _check_order(compiled, phase, p)
    weight, g_mask, h_mask = _evaluate(phase.mode.functions["stage_w"], p)
    end = _evaluate(phase.mode.functions["terminal_w"], p_end)
    return replace(
        phase, p=p, p_end=p_end[0], p_transition=p_transition, weight=weight, g_mask=g_mask, h_mask=h_mask,
        end_weight=end[0][0], end_g_mask=end[1][0], end_h_mask=end[2][0],
    )  # fmt: skip


def _put(compiled: CompiledProblem, table: Array, layout: Layout, slot: str, value: Array) -> None:
    part = layout.slices.get(slot)
    if part is None:
        return
    kind, _, what = slot.partition(".")
    if kind.startswith("term") and what in ("weight", "target"):
        table[np.any(table[:, layout.slices[f"{kind}.weight"]] != 0, axis=1), part] = value
    elif kind.startswith("term") and what in ("lower", "upper"):
        table[:, part] = np.where(np.isfinite(value), value, 0.0)
        table[:, layout.slices[f"{kind}.has_{what}"]] = np.isfinite(value)
    else:
        table[:, part] = value


def _check_order(compiled: CompiledProblem, phase: CompiledPhase, p: Array) -> None:
    slices = phase.mode.layout.slices
    for k in phase.mode.bound:
        if not {f"term{k}.lower", f"term{k}.upper"} <= slices.keys():
            continue
        lower, upper = (p[:, slices[f"term{k}.{side}"]] for side in ("lower", "upper"))
        both = p[:, slices[f"term{k}.has_lower"]] * p[:, slices[f"term{k}.has_upper"]]
        wrong = np.argwhere((both > 0) & (lower > upper))
        if wrong.size:
            at = tuple(wrong[0])
            raise ProblemError(
                f"{compiled.terms[k].where}, row {wrong[0][1]}: bounds exclude each other - got lower {lower[at]:g} "
                f"above upper {upper[at]:g}, expected lower ≤ upper; swap them"
            )


# ---- names


def _term_names(compiled: CompiledProblem) -> list[str]:
    """Return a name per term that no other term has."""
    names = [term.name for term in compiled.terms]
    return [
        name if names.count(name) == 1 else f"{name}[{names[:k].count(name)}]" for k, name in enumerate(names)
    ]  # fmt: skip


def _name(compiled: CompiledProblem, names: list[str], model: str, slot: str) -> str:
    """Return the public name of a part of a parameter vector; empty if it may not vary."""
    kind, _, what = slot.partition(".")
    if kind == "parameter":
        return what
    if kind == "model":
        return "" if f"{model}.{what}" in compiled.changing else f"{model}.{what}"
    if not kind.startswith("term"):
        return ""  # the time step
    k = int(kind.removeprefix("term"))
    term = compiled.terms[k]
    if isinstance(term, Cost):
        own = term.target is not None and term.target.size and term.quantity and term.quantity.kind != "rotation"
        vary = what == "weight" or what in term.parameters or (what == "target" and own)
    else:
        vary = what in ("lower", "upper") or what in term.parameters
    return f"{names[k]}.{what}" if vary else ""


def _evaluate(function: cs.Function, p: Array) -> list[Array]:
    """Return weights and masks; instances are made in several threads, and buffers are not shared between them."""
    if not hasattr(_OWN, "batches"):
        _OWN.batches = lru_cache(maxsize=64)(Vectorised)
    results: list[Array] = _OWN.batches(function)(p)
    return results


_OWN = threading.local()
