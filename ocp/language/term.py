"""Terms: costs and constraints of a motion, as frozen values.

A term is written with a quantity or as a function of a node's quantities. The compiler binds it to each model that
supplies these quantities.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, Self, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from piaffe.errors import ProblemError, ShapeError

from .quantity import Quantity, match_labels
from .sending import sendable
from .source import Source, caller
from .user_input import copied, numbers_of

At = Literal["running", "phase_end", "end"]
When = str | tuple[str, ...] | Callable[[str], bool] | None
Function = Callable[..., Any]
Array = NDArray[np.float64]


@dataclass(frozen=True)
class ByPhase:
    """A weight that differs between phases: ``ocp.by_phase(1.0, flight=0.1)``."""

    default: Any
    phases: Mapping[str, Any]


def by_phase(default: Any, **phases: Any) -> ByPhase:
    """Return a weight with a default and values for named phases."""
    return ByPhase(default, phases)


@dataclass(frozen=True, eq=False, kw_only=True)
class Term:
    """The common part of costs and constraints.

    Args:
        name: its name in reports.
        at: ``"running"``: at every stage; ``"phase_end"``: at the last node of each phase of the motion;
            ``"end"``: at the last node of the horizon.
        when: phases it applies to: a name, names, a predicate of the name, or None for all.
        mask: function of the node's quantities that returns 0 or 1 per row; a row with 0 has no effect.
        parameters: keyword arguments of the functions; their values can change without a new compilation.
        positive: names of those that must be above zero.
        unit: unit of the rows.
        source: where it was declared.
    """

    name: str
    at: At = "running"
    when: When = None
    mask: Function | None = None
    parameters: Mapping[str, Array] = field(default_factory=dict)
    positive: frozenset[str] = frozenset()
    unit: str = ""
    source: Source = field(default_factory=caller)

    def __post_init__(self) -> None:
        if self.at not in ("running", "phase_end", "end"):
            raise ProblemError(
                f"term '{self.name}' ({self.source}): at= is unknown - got {self.at!r}, expected 'running', "
                "'phase_end' or 'end'; choose one"
            )
        object.__setattr__(self, "parameters", copied(self.parameters))
        for name, value in self.parameters.items():
            if name in self.positive and not np.all(np.asarray(value) > 0):
                raise ProblemError(
                    f"{self.where}: parameter '{name}' is out of range - got {np.ravel(value).tolist()}, expected "
                    "numbers > 0; change it"
                )

    @property
    def where(self) -> str:
        """Name, file and line, for messages."""
        return f"term '{self.name}' ({self.source})"

    def __getstate__(self) -> dict[str, Any]:
        return sendable(self.__dict__, self.where)

    def __deepcopy__(self, memo: dict[int, object]) -> Self:
        return self  # a value that does not change; its functions need no copy

    def applies(self, phase: str) -> bool:
        """Return whether the term applies to a phase of this name."""
        if self.when is None:
            return True
        if callable(self.when):
            return bool(self.when(phase))
        return phase in ((self.when,) if isinstance(self.when, str) else self.when)


@dataclass(frozen=True, eq=False, kw_only=True)
class Cost(Term):
    """A weighted least-squares residual, ½ Σ wᵢ rᵢ², a rate if running.

    Args:
        quantity: tracked quantity, or None if ``function`` is given.
        function: residual rows of a node's quantities.
        weight: scalar, one per row, a mapping of component names, or :class:`ByPhase` of these.
        target: fixed target; None to follow the motion's path.
    """

    quantity: Quantity | None = None
    function: Function | None = None
    weight: Any = 1.0
    target: Array | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "weight", _copied_weight(self.weight))
        if self.target is not None:
            object.__setattr__(self, "target", _flat(copied(self.target), self.where, "target", self.unit))

    def structure(self) -> Hashable:
        """Return the part of the term that the generated functions depend on; equal structures share functions."""
        sizes = tuple((k, np.size(v)) for k, v in self.parameters.items())
        to_zero = self.target is not None and self.target.size == 0
        return ("cost", self.quantity, self.function, self.at, self.mask, to_zero, self.unit, sizes)

    def counts_in(self, phase: str) -> bool:
        """Return whether a new weight replaces the declared one in a phase of this name.

        It does where the term applies; if weights differ by phase, only where the declared ones are not all zero.
        """
        if not self.applies(phase) or not isinstance(self.weight, ByPhase):
            return self.applies(phase)
        weight = self.weight.phases.get(phase, self.weight.default)
        return any(np.any(np.asarray(w) != 0) for w in (weight.values() if isinstance(weight, Mapping) else (weight,)))

    def weights(self, phase: str, labels: tuple[str, ...]) -> Array:
        """Return one weight per row for a phase, zero where the term does not apply."""
        if not self.applies(phase):
            return np.zeros(len(labels))
        weight = self.weight
        if isinstance(weight, ByPhase):
            weight = weight.phases.get(phase, weight.default)
        if isinstance(weight, Mapping):
            values = np.zeros(len(labels))
            for key, value in weight.items():
                named = match_labels(labels, key, self.where)
                numbers = _flat(
                    numbers_of(value, self.where, f"weight of '{key}'"), self.where, f"weight of '{key}'", self.unit
                )
                if numbers.size not in (1, len(named)):
                    raise ShapeError(
                        f"{self.where}: weight of '{key}' has the wrong size - got {numbers.size} entries, expected 1 "
                        f"or {len(named)} ({', '.join(labels[i] for i in named)}); give one per component or a scalar"
                    )
                values[named] = numbers
        else:
            values = _flat(numbers_of(weight, self.where, "weight"), self.where, "weight", self.unit)
            if values.size not in (1, len(labels)):
                raise ShapeError(
                    f"{self.where}: weight has the wrong size - got {values.size} entries, expected 1 or {len(labels)} "
                    f"({', '.join(labels)}) [{self.unit or '-'}]; give one per component, a scalar, or a mapping by "
                    "name"
                )
            values = np.broadcast_to(values, (len(labels),)).astype(float)
        if not np.all(np.isfinite(values)) or np.any(values < 0):
            raise ProblemError(
                f"{self.where}: weight is unusable - got {values.tolist()}, expected finite numbers ≥ 0; fix it"
            )
        return values


@dataclass(frozen=True, kw_only=True)
class ResetRows:
    """Further rows of a constraint, at the reset after a phase: a friction cone limits impulses as it limits forces.

    The rows must be ≥ 0 (inequality) or zero (equality), as the constraint's own. They hold at the end of each phase
    to which the constraint applies, if the model's own reset changes the state there (a foot lands).

    Args:
        function: rows of the quantities at the reset, with the constraint's parameters as keyword arguments.
        mask: function of these quantities that returns 0 or 1 per row; None for all rows.
        unit: unit of the rows.
        scale: divisor of the rows and of their violations in reports, or a function of the model that returns it; None:
            the natural size of the unit, which is 1 for most models.
        labels: names of the rows, or a function of the model that returns them.
    """

    function: Function
    mask: Function | None = None
    unit: str = ""
    scale: float | Callable[[Any], float] | None = None
    labels: Any = None


@dataclass(frozen=True, eq=False, kw_only=True)
class Constraint(Term):
    """Rows that must be between bounds (inequality) or zero (equality).

    Args:
        kind: ``"inequality"`` or ``"equality"``.
        function: rows of a node's quantities.
        lower: lower bounds, numbers or a function of the model; None if there are none.
        upper: the same for upper bounds.
        scale: divisor of the rows and of their violations in reports, in the rows' unit, or a function of the model
            that returns it; None: the natural size of the unit, see :class:`Sizes`, which is 1 for most models.
        labels: names of the rows, or a function of the model that returns them.
        at_reset: further rows at the resets after phases; None for none.
    """

    kind: Literal["inequality", "equality"]
    function: Function
    lower: Any = None
    upper: Any = None
    scale: float | Callable[[Any], float] | None = None
    labels: Any = None
    at_reset: ResetRows | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("lower", "upper", "labels"):
            object.__setattr__(self, name, copied(getattr(self, name)))
        if self.scale is not None and not callable(self.scale):
            self._check_scale(self.scale)

    @property
    def where(self) -> str:
        """Name, file and line, for messages."""
        return f"constraint '{self.name}' ({self.source})"

    def structure(self) -> Hashable:
        """Return the part of the term that the generated functions depend on; equal structures share functions."""
        sizes = tuple((k, np.size(v)) for k, v in self.parameters.items())
        sides = (self.lower is not None, self.upper is not None)
        labels = self.labels if callable(self.labels) or self.labels is None else tuple(self.labels)
        return ("constraint", self.kind, self.function, self.at, self.mask, sides, self.scale, self.unit, labels, sizes,
                self.at_reset)  # fmt: skip

    def scale_of(self, model: Any) -> float:
        """Return the divisor of the rows for a model.

        Raises:
            ProblemError: it is not a positive number.
        """
        if self.scale is None:
            return float(model.sizes.of(self.unit))
        scale = self.scale(model) if callable(self.scale) else self.scale
        self._check_scale(scale)
        return scale

    def _check_scale(self, scale: Any) -> None:
        if not (isinstance(scale, int | float) and 0 < scale < float("inf")):
            raise ProblemError(
                f"{self.where}: scale is out of range - got {scale!r}, expected a positive number "
                f"[{self.unit or '-'}]; give one"
            )

    def bound(self, side: Literal["lower", "upper"], model: Any, size: int) -> Array:
        """Return the bounds of one side for a model, (size,)."""
        bound = self.lower if side == "lower" else self.upper
        try:
            values = numbers_of(bound(model) if callable(bound) else bound, self.where, f"{side} bound")
        except AttributeError as error:
            raise ProblemError(
                f"{self.where}: model '{model.name}' has no such limits - got {error}, "
                f"expected a model of a robot; give {side}= as numbers, or leave the constraint out with .without(...)"
            ) from error
        _flat(values, self.where, f"{side} bound", self.unit)
        if values.size not in (1, size) or np.any(np.isnan(values)):
            raise ShapeError(
                f"{self.where}: {side} bound is unusable - got {values.tolist()}, expected "
                f"1 or {size} numbers [{self.unit or '-'}]; give one per row or a scalar"
            )
        return np.broadcast_to(values, (size,)).astype(float)


def _copied_weight(weight: Any) -> Any:
    if isinstance(weight, ByPhase):
        return ByPhase(copied(weight.default), copied(weight.phases))
    return copied(weight)


def _flat(values: Array, where: str, what: str, unit: str) -> Array:
    """Return numbers in one column or row; raise if they are a matrix."""
    if values.ndim > 1:
        raise ShapeError(
            f"{where}: {what} is a matrix - got shape {values.shape}, expected numbers in one column [{unit or '-'}]; "
            "give one per component, or a scalar"
        )
    return values


def _numbers(parameters: Mapping[str, ArrayLike] | None) -> dict[str, Array]:
    return {
        key: numbers_of(value, f"term ({caller()})", f"parameter '{key}'") for key, value in (parameters or {}).items()
    }


def _as_quantity(quantity: Quantity | str) -> Quantity:
    if isinstance(quantity, str):
        return Quantity(quantity)
    if not isinstance(quantity, Quantity):
        raise ProblemError(
            f"term ({caller()}): is not a quantity - got {quantity!r}, expected one like base.position, or the name of "
            "a state or control; use ocp.residual for your own function"
        )
    return quantity


def track(
    quantity: Quantity | str,
    weight: Any = 1.0,
    *,
    at: At = "running",
    when: When = None,
    to: ArrayLike | None = None,
    mask: Function | None = None,
    name: str | None = None,
) -> Cost:
    """Return a cost ½ Σ wᵢ (q − q_ref)ᵢ² of the difference of a quantity from the motion's path, or from ``to``.

    The residual of a rotation is the body-axis rotation vector from target to value.
    """
    q = _as_quantity(quantity)
    suffix = "" if at == "running" else f" at {at}"
    target = None if to is None else numbers_of(to, f"term '{name or f'track {q}{suffix}'}' ({caller()})", "target")
    return Cost(
        name=name or f"track {q}{suffix}",
        quantity=q,
        weight=weight,
        at=at,
        when=when,
        target=target,
        mask=mask,
        unit=q.unit,
    )


def regularize(
    quantity: Quantity | str,
    weight: Any = 1.0,
    *,
    at: At = "running",
    when: When = None,
    mask: Function | None = None,
    name: str | None = None,
) -> Cost:
    """Return a cost ½ Σ wᵢ qᵢ² that keeps a quantity small; ``mask`` selects rows, as for :func:`track`."""
    q = _as_quantity(quantity)
    suffix = "" if at == "running" else f" at {at}"
    return Cost(
        name=name or f"regularize {q}{suffix}",
        quantity=q,
        weight=weight,
        at=at,
        when=when,
        target=np.zeros(0),
        mask=mask,
        unit=q.unit,
    )


@dataclass(frozen=True)
class Residual:
    """A user's residual; with a weight it is a cost: ``hip_symmetry.weighted(0.1)``."""

    function: Function
    unit: str
    parameters: Mapping[str, Array]
    source: Source
    mask: Function | None = None

    def weighted(self, weight: Any, *, at: At = "running", when: When = None, name: str | None = None) -> Cost:
        """Return the cost ½ Σ wᵢ rᵢ²."""
        return Cost(
            name=name or _name(self.function, "residual"),
            function=self.function,
            weight=weight,
            at=at,
            when=when,
            mask=self.mask,
            unit=self.unit,
            parameters=self.parameters,
            source=self.source,
        )


@overload
def residual(function: Function) -> Residual: ...
@overload
def residual(
    *, unit: str = "", parameters: Mapping[str, ArrayLike] | None = None, mask: Function | None = None
) -> Callable[[Function], Residual]: ...
def residual(
    function: Function | None = None,
    *,
    unit: str = "",
    parameters: Mapping[str, ArrayLike] | None = None,
    mask: Function | None = None,
) -> Residual | Callable[[Function], Residual]:
    """Return the residual of a function of a node's quantities; usable as a decorator, with or without arguments."""
    source = caller()

    def wrap(f: Function) -> Residual:
        return Residual(f, unit, _numbers(parameters), source, mask)

    return wrap if function is None else wrap(function)


def _name(function: Function, otherwise: str) -> str:
    name = str(getattr(function, "__name__", otherwise))
    return otherwise if name == "<lambda>" else name


def _constraint(
    kind: Literal["inequality", "equality"], function: Function | None, name: str | None, **fields: Any
) -> Any:
    source = caller()

    def wrap(f: Function) -> Constraint:
        return Constraint(kind=kind, function=f, name=name or _name(f, kind), source=source, **fields)

    return wrap if function is None else wrap(function)


def inequality(
    function: Function | None = None,
    *,
    lower: Any = None,
    upper: Any = None,
    unit: str = "",
    scale: float | Callable[[Any], float] | None = None,
    name: str | None = None,
    at: At = "running",
    when: When = None,
    mask: Function | None = None,
    parameters: Mapping[str, ArrayLike] | None = None,
    labels: Any = None,
    at_reset: ResetRows | None = None,
    positive: Iterable[str] = (),
) -> Any:
    """Return the constraint lower ≤ f(s) ≤ upper; usable as a function, or as a decorator with or without arguments.

    Without bounds the constraint is f(s) ≥ 0. Rows that depend only on the state hold at every node, other rows at
    every stage. ``at_reset`` adds rows on the impulses of impacts, see :class:`ResetRows`. ``positive`` are the names
    of parameters whose values must be above zero.
    """
    if lower is None and upper is None:
        lower = 0.0
    return _constraint(
        "inequality", function, name, lower=lower, upper=upper, unit=unit, scale=scale, at=at, when=when, mask=mask,
        parameters=_numbers(parameters), labels=labels, at_reset=at_reset, positive=frozenset(positive),
    )  # fmt: skip


def equality(
    function: Function | None = None,
    *,
    at: At = "running",
    unit: str = "",
    scale: float | Callable[[Any], float] | None = None,
    name: str | None = None,
    when: When = None,
    mask: Function | None = None,
    parameters: Mapping[str, ArrayLike] | None = None,
    labels: Any = None,
) -> Any:
    """Return the constraint f(s) = 0; usable as a function, or as a decorator with or without arguments."""
    return _constraint(
        "equality", function, name, unit=unit, scale=scale, at=at, when=when, mask=mask,
        parameters=_numbers(parameters), labels=labels,
    )  # fmt: skip
