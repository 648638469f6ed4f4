"""Parameters of a compiled problem: the numbers that can change, by name, with sizes and present values."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from piaffe.errors import ProblemError, UnknownNameError

from ..language import Constraint, Cost, ParameterKey, check_value, parameter_names
from .compiled_phase import CompiledPhase
from .layout import Layout

Array = NDArray[np.float64]


class Parameters(Mapping[str, Array]):
    """The parameters of a compiled problem: name → present value (size,).

    The names are those of :meth:`Problem.with_parameters`. Numbers that follow from the motion at each node (contacts,
    footholds, targets along the path) and bounds that vary over a phase are not among them. If a parameter differs by
    phase, its value is that of the first phase where it applies. A bound may be infinite.

    Args:
        phases: the phases of the compiled problem.
        terms: its costs and constraints.
        changing: slots of models whose values follow from the motion, and bounds that vary over a phase.
    """

    def __init__(
        self,
        phases: Sequence[CompiledPhase],
        terms: Sequence[Cost | Constraint],
        changing: frozenset[ParameterKey] = frozenset(),
    ) -> None:
        self._phases, self._terms, self._changing = phases, terms, changing

    # ---- names

    @cached_property
    def _names(self) -> dict[str, ParameterKey]:
        """Every name: of the declaration, of each ``ocp.parameter``, and of slots that follow from the motion."""
        named = {key: name for name, key in parameter_names(self._terms, (p.mode.model for p in self._phases)).items()}
        found: dict[str, ParameterKey] = {}
        for key in self._sizes:
            name = key.name if key.kind == "parameter" and key.term is None else named.get(key, "")
            if name and not self._is_rotation(key):
                found[name] = key
        return found

    @cached_property
    def _sizes(self) -> dict[ParameterKey, list[int]]:
        """Sizes of every part of the parameter vectors; those of a term may differ between models."""
        sizes: dict[ParameterKey, list[int]] = {}
        for layout in dict.fromkeys(layout for phase in self._phases for layout in _layouts(phase)):
            for key, part in layout.slices.items():
                sizes.setdefault(key, []).append(part.stop - part.start)
        return {key: list(dict.fromkeys(found)) for key, found in sizes.items()}

    def _is_rotation(self, key: ParameterKey) -> bool:
        """Whether a target is a quaternion: it then has one entry more than the cost has weights."""
        return key.kind == "target" and self._sizes[key] != self._sizes[ParameterKey("weight", term=key.term)]

    def key(self, name: str, where: str) -> ParameterKey:
        """Return the key of a parameter.

        Args:
            name: the parameter's name.
            where: the declaration or the call, for messages.

        Raises:
            UnknownNameError: there is no such parameter; the message lists those that exist.
            ProblemError: its values follow from the motion.
        """
        if name not in self._names:
            raise UnknownNameError(where, "parameter", name, self)
        key = self._names[name]
        if key in self._changing:
            raise not_a_number(name, key, where)
        return key

    def size(self, name: str) -> int:
        """Return the number of entries of a parameter; in the first model, if models differ."""
        return self._sizes[self._names[name]][0]

    # ---- values

    def check(self, name: str, value: ArrayLike, where: str) -> Array:
        """Return a value for a parameter, (size,); see :meth:`CompiledProblem.with_parameters` for what it raises."""
        key = self.key(name, where)
        array = check_value(name, key, value, where, self.size(name))
        for size in self._sizes[key][1:]:
            check_value(name, key, value, where, size)
        return array

    def __getitem__(self, name: str) -> Array:
        if name not in self:
            raise UnknownNameError("compiled problem", "parameter", name, self)
        key = self._names[name]
        for phase in self._phases:
            for layout, table, applies in tables(phase):
                rows = np.flatnonzero(applies[:, key.term]) if key.kind in ("weight", "target") else np.arange(1)
                if key in layout.slices and rows.size:
                    value = table[rows[0], layout.slices[key]].copy()
                    if key.is_bound:
                        has = table[rows[0], layout.slices[key.has_bound]]
                        value = np.where(has > 0, value, -np.inf if key.kind == "lower" else np.inf)
                    return value
        return np.zeros(self._sizes[key][0])  # a cost that applies at none of these nodes

    def __contains__(self, name: object) -> bool:
        return name in self._names and self._names[str(name)] not in self._changing

    def __iter__(self) -> Iterator[str]:
        return (name for name, key in self._names.items() if key not in self._changing)

    def __len__(self) -> int:
        return sum(1 for _ in self)

    def __repr__(self) -> str:
        return f"Parameters({dict(self)})"


def not_a_number(name: str, key: ParameterKey, where: str) -> ProblemError:
    """Return the error of a slot that follows from the motion, or of a bound that varies over a phase."""
    if key.is_bound:
        return ProblemError(
            f"{where}, parameter '{name}': varies over a phase - got a number for it, expected none; declare the "
            "constraint with another function in ocp.over_phase, or with a number"
        )
    return ProblemError(
        f"{where}, parameter '{name}': follows from the motion - got a number for it, expected none; change the "
        "motion's phases or targets, the time step, or the options of the model"
    )


def tables(phase: CompiledPhase) -> Iterator[tuple[Layout, Array, NDArray[np.bool_]]]:
    """Yield layout, parameters (n, np) and effect of terms (n, terms) of the stages, the last node, the transition."""
    yield phase.mode.layout, phase.p, phase.applies[:-1]
    yield phase.mode.layout, phase.p_end[None], phase.applies[-1:]
    if phase.transition is not None:
        yield phase.transition.layout, phase.p_transition[None], phase.applies[-1:]


def _layouts(phase: CompiledPhase) -> Iterator[Layout]:
    yield phase.mode.layout
    if phase.transition is not None:
        yield phase.transition.layout
