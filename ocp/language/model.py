"""Models, as the compiler uses them: spaces, slots for numbers, dynamics per mode, reset and quantities.

A model's dynamics is ``x⁺ = integrate(x, u, z, p)`` where z solves the implicit part ``r(x, u, z, p) = 0``, affine in
z; explicit models have an empty z. ``p`` is a mapping from slot names to CasADi symbols. It contains all numbers of the
model.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from inspect import isfunction, signature
from typing import Any, Self

import casadi as cs
import numpy as np
from numpy.typing import NDArray

from piaffe.errors import ModelError, ProblemError, UnknownNameError

from . import rotation
from .invariants import Invariants
from .manifold import Manifold
from .quantity import Bound, Quantity
from .schedule import Schedule, Segment
from .sending import sendable
from .sizes import Sizes
from .source import Source

Array = NDArray[np.float64]
Sample = Mapping[Quantity, Array]


@dataclass(frozen=True)
class Slot:
    """A numeric parameter of a model, per node.

    Args:
        name: name within the model, e.g. ``"contact"``.
        size: number of entries.
        default: its value if neither ``node_parameters`` nor a parameter of the problem replaces it, (size,).
        positive: whether values that replace it must be above zero.
        check: function of values that replace it; it returns what is expected of them, or "" if they are usable.
    """

    name: str
    size: int
    default: tuple[float, ...]
    positive: bool = False
    check: Callable[[Array], str] | None = None


@dataclass(frozen=True)
class Node:
    """One node of the horizon, for which a model returns the values of its slots.

    Args:
        time: time since the motion's start [s].
        mode: the phase's mode, as ``resolve`` returns it; on a boundary the later one, unless the node ends the phase.
        next_mode: at the end of a motion phase, the mode of the next phase; else None.
        sample: the targets at this time; at the middle of a stage if the model has quantities that act there.
        previous_mode: the mode of the previous motion phase; None in the first.
        steps: number of stages since the start of the motion phase.
        dt: time step [s]; 0 if it is unknown.
        tracked: the targets of costs if they are not ``sample``.
        phase_time: time since the start of the motion phase [s]; where quantities act during a stage, at its middle.
    """

    time: float
    mode: Hashable
    next_mode: Hashable | None
    sample: Sample
    previous_mode: Hashable | None = None
    steps: int = 0
    dt: float = 0.0
    tracked: Sample | None = None
    phase_time: float = 0.0

    @property
    def targets(self) -> Sample:
        """The targets of costs."""
        return self.sample if self.tracked is None else self.tracked


class Quantities:
    """The quantities that a model can supply, bound on first use.

    Args:
        where: the model's name, for messages.
        makers: path → function that returns the bound quantity.
        absent: path → why the model cannot supply it, for messages.
    """

    def __init__(
        self, where: str, makers: Mapping[str, Callable[[], Bound]], absent: Mapping[str, str] | None = None
    ) -> None:
        self.where = where
        self._makers = makers
        self._absent = absent or {}
        self._made: dict[str, Bound] = {}

    @property
    def paths(self) -> tuple[str, ...]:
        """Every path that can be bound."""
        return tuple(self._makers)

    def __contains__(self, quantity: Quantity | str) -> bool:
        return str(quantity) in self._makers

    def bind(self, quantity: Quantity | str) -> Bound:
        """Return the bound quantity; raise UnknownNameError if the model cannot supply it."""
        path = str(quantity)
        if path not in self._makers:
            raise self.unknown(path)
        if path not in self._made:
            self._made[path] = self._makers[path]()
        return self._made[path]

    def extended(self, *bounds: Bound) -> Quantities:
        """Return these quantities and others; a new quantity replaces the one with the same path."""
        more = {bound.quantity.path: partial(_same, bound) for bound in bounds}
        return Quantities(self.where, {**self._makers, **more}, self._absent)

    def unknown(self, path: str) -> UnknownNameError:
        """Return the error for a path that cannot be bound, with the reason if the model gives one."""
        error = UnknownNameError(f"model '{self.where}'", "quantity", path, self._makers)
        if path in self._absent:
            error.hint = f" ({self._absent[path]})"
        return error


def _same(bound: Bound) -> Bound:
    return bound


@dataclass(frozen=True)
class SplitStep:
    """A step in parts, with states m and w on the way: m = begin(x, p), r(m, u, z, p) = 0, w(m, u, z, p), x⁺(w, p).

    A solver multiplies by the derivatives of the parts one after the other. That is faster than by their product if
    many rows of each part are simple (a position that a velocity moves) and those of the product are not. All states
    have the layout of the model's, with quaternions of unit length.

    Args:
        middle: symbols of m, (nx, 1).
        begin: m as an expression of x and p, (nx, 1).
        residual: r as an expression of (m, u, z, p), (nz, 1).
        first: w as an expression of (m, u, z, p), (nx, 1).
        finish: returns x⁺, (nx, 1), as an expression of its argument w and of p.
    """

    middle: cs.SX
    begin: cs.SX
    residual: cs.SX
    first: cs.SX
    finish: Callable[[cs.SX], cs.SX]

    def dynamics(self, quantities: Quantities, outputs: tuple[Quantity, ...] = ()) -> Dynamics:
        """Return the dynamics with this step."""
        implicit, first = cs.substitute([self.residual, self.first], [self.middle], [self.begin])
        return Dynamics(implicit, self.finish(first), quantities, outputs, self)


@dataclass(frozen=True)
class Dynamics:
    """One mode of a model as expressions of (x, u, z, p).

    Args:
        implicit: r(x, u, z, p), (nz, 1), affine in z.
        next_state: the discrete step given z, (nx, 1); (0, 1) of a model without derivatives.
        quantities: the quantities that terms may use.
        outputs: quantities that a trajectory records in addition to state and control (contact forces).
        split: the step in parts, if solvers are to multiply by the derivatives of each; see :class:`SplitStep`.
    """

    implicit: cs.SX
    next_state: cs.SX
    quantities: Quantities
    outputs: tuple[Quantity, ...] = ()
    split: SplitStep | None = None


@dataclass(frozen=True)
class Reset:
    """The model's own reset of the state at the end of a phase, as expressions of (x, z, p): an impact.

    Args:
        implicit: r(x, z, p), (nz, 1), affine in z.
        next_state: the state after it, (nx, 1).
        quantities: the quantities that terms at ``"phase_end"`` may use there: those of the state before it, and those
            of z (impulses); None if the reset supplies none.
        outputs: quantities that a trajectory records (impulses).
    """

    implicit: cs.SX
    next_state: cs.SX
    quantities: Quantities | None = None
    outputs: tuple[Quantity, ...] = ()


@dataclass(frozen=True)
class ProblemWarning:
    """A warning about a problem: ``solve`` prints it, solvers issue it as ``piaffe.PiaffeWarning``.

    Args:
        where: the declaration, with its file and line.
        text: what is likely wrong - got, expected; what to do.
        source: the file and the line; None for those of the problem.
    """

    where: str
    text: str
    source: Source | None = None

    def __str__(self) -> str:
        return f"{self.where}: {self.text}"


@dataclass(frozen=True, eq=False)
class ModelBase(ABC):
    """Base class of models. Models compare by identity: two models are equal only if they are the same object."""

    name: str
    state: Manifold
    control: Manifold
    slots: tuple[Slot, ...] = field(default=(), kw_only=True)
    cut_by_modes: bool = field(default=True, kw_only=True)

    def __init_subclass__(cls, **options: object) -> None:
        """Refuse methods that ModelBase does not call any more, by their names or their arguments."""
        super().__init_subclass__(**options)
        if "notices" in vars(cls):
            raise ModelError(
                f"model class '{cls.__name__}': 'notices' was renamed - got a method 'notices', expected 'warnings'; "
                "rename it"
            )
        guess = vars(cls).get("control_guess")
        if isfunction(guess) and not _takes(guess, 4):
            raise ModelError(
                f"model class '{cls.__name__}': 'control_guess' has other arguments now - got "
                f"control_guess{signature(guess)}, expected control_guess(self, nodes, states, p); return a row per "
                "stage, from the targets nodes[k].sample"
            )

    def __getstate__(self) -> dict[str, Any]:
        kept = {name: value for name, value in self.__dict__.items() if not _is_cached(type(self), name)}
        return sendable(kept, f"model '{self.name}'")

    def __deepcopy__(self, memo: dict[int, object]) -> Self:
        return self  # models compare by identity, and do not change

    # ---- what every model defines

    @abstractmethod
    def mode_key(self, mode: Hashable) -> str:
        """Return the key of the dynamics that a phase's mode uses; modes that differ only in numbers share a key."""

    @abstractmethod
    def dynamics(self, key: str, x: cs.SX, u: cs.SX, z: cs.SX, p: Mapping[str, cs.SX]) -> Dynamics:
        """Return the dynamics of a mode; ``p`` holds the model's slots and ``"dt"`` [s]."""

    # ---- what a model may override

    @property
    def has_derivatives(self) -> bool:
        """Whether its dynamics is a differentiable expression; False if it is a simulator."""
        return True

    @property
    def sizes(self) -> Sizes:
        """The natural sizes of its lengths, times and masses, to which a solver's numbers are relative; SI units."""
        return Sizes()

    def implicit_size(self, key: str) -> int:
        """Return the size nz of z in a mode."""
        return 0

    def definite_size(self, key: str) -> int:
        """Return how many leading unknowns of z form a positive definite block of K, in a mode and in its reset.

        A compiled solver eliminates these first, in any order, and then the others in the order of z. It does not
        pivot, so K must be regular in that order.
        """
        return 0

    def resolve(self, mode: Hashable) -> Hashable:
        """Return a phase's mode in the model's own form, comparable between phases; raise if the mode is invalid."""
        self.mode_key(mode)
        return mode

    def node_parameters(self, node: Node) -> dict[str, Array]:
        """Return the values of slots that depend on the node; the others keep their defaults."""
        return {}

    @property
    def slots_from_motion(self) -> Mapping[str, Quantity]:
        """The slots that ``node_parameters`` sets to a quantity of the node's sample: slot name → quantity.

        A controller that plans again and again computes these at any time; the other slots follow the phase.
        """
        return {}

    def added_targets(self, path: object) -> object | None:
        """Return the targets that the model adds to those of a motion, an ``ocp.Path``: ``ocp.AddedTargets``, or None.

        A slot of :attr:`slots_from_motion` may take them.
        """
        return None

    @property
    def acting(self) -> frozenset[Quantity]:
        """What acts on the model during a whole stage in which contacts may change; by default nothing.

        A stage takes these quantities, and the motion phase, at its middle. The others are those at its start.
        """
        return frozenset()

    def reset_size(self, key: str) -> int:
        """Return the size of z in the model's own reset."""
        return 0

    def reset(self, key: str, x: cs.SX, z: cs.SX, p: Mapping[str, cs.SX]) -> Reset:
        """Return the model's own reset at a phase's end; by default the identity."""
        return Reset(cs.SX(0, 1), x)

    def lands(self, node: Node) -> bool:
        """Return whether the model's own reset changes the state at this phase end; only then its quantities count."""
        return False

    def switching(self, key: str, quantities: Quantities, p: Mapping[str, cs.SX]) -> Bound | None:
        """Return rows that must be zero at a phase's end because of the next phase (a touchdown), or None."""
        return None

    def invariants(self, key: str, quantities: Quantities, p: Mapping[str, cs.SX]) -> Invariants:
        """Return what holds in a mode over many steps, for a verification; by default nothing."""
        return Invariants()

    def complete_keyframe(self, values: Mapping[str, object]) -> Mapping[str, object]:
        """Return the entries of a keyframe after those that follow from several of them; by default the same."""
        return values

    def keyframe(self, values: Mapping[str, object]) -> dict[Quantity, Array]:
        """Translate a keyframe's entries to quantities; a rotation as roll, pitch, yaw, (3,) [rad], full turns kept."""
        targets: dict[Quantity, Array] = {}
        known = {b.quantity.path: b for b in (*self.state.blocks, *self.control.blocks)}
        for path, value in values.items():
            if path not in known:
                raise UnknownNameError(f"keyframe for model '{self.name}'", "target", path, known)
            block = known[path]
            array = np.atleast_1d(np.asarray(value, dtype=float))
            if array.shape != (block.ndx,):
                named = f" ({', '.join(block.labels)})" if any(block.labels) else ""
                unit = f" [{block.quantity.unit}]" if block.quantity.unit else ""
                raise ModelError(
                    f"keyframe for model '{self.name}', target '{path}': wrong size - got {array.size} entries, "
                    f"expected {block.ndx}{named}{unit}; give one per component"
                )
            targets[block.quantity] = array
        return targets

    @property
    def planar_pose(self) -> tuple[Quantity, Quantity] | None:
        """Position and orientation in the state whose x, y and yaw are the planar frame; None without one."""
        return None

    @property
    def fastest(self) -> float | None:
        """Speed of the position in :attr:`planar_pose` above which targets are reported [m/s]; None for no limit."""
        return None

    def planar_frame(self, sample: Sample) -> tuple[float, float, float]:
        """Return (x, y, yaw) [m, m, rad] of the frame in which the next piece of a motion is placed.

        It is that of :attr:`planar_pose`; without one, the origin.
        """
        if self.planar_pose is None:
            return (0.0, 0.0, 0.0)
        position, orientation = (np.asarray(sample[quantity]) for quantity in self.planar_pose)
        return (float(position[0]), float(position[1]), float(rotation.np_to_rpy(orientation)[2]))

    def warnings(self, path: object) -> list[ProblemWarning]:
        """Return warnings about the targets of a motion, an ``ocp.Path``."""
        return []

    def recipe(self) -> dict[str, object]:
        """Return the values, for JSON, from which plots and films of a saved solution rebuild the model."""
        return {}

    @property
    def own_step(self) -> float | None:
        """The only time step that the model supports [s]; None if it supports any."""
        return None

    def control_guess(self, nodes: Sequence[Node], states: Array, p: Mapping[str, Array]) -> dict[Quantity, Array]:
        """Return the initial guess of the control at the stages of a phase, by default zero.

        The compiler uses it for stages at which the path itself has no control.

        Args:
            nodes: the first nodes of the N stages.
            states: the guess of the states, of the phase's last node, too, (N+1, nx).
            p: the values of the model's slots and ``"dt"`` [s] at the stages, (N, size) each.

        Returns:
            Values of blocks of the control, (N, size) each; blocks that are left out are zero.
        """
        return {}

    # ---- schedules

    def over(self, duration: float, dt: float) -> Schedule:
        """Return a schedule of this model over a duration [s] with time step dt [s]."""
        return Schedule((Segment(self, duration, dt),))

    def until_end(self, dt: float) -> Schedule:
        """Return a schedule of this model until the motion ends, with time step dt [s]."""
        return Schedule((Segment(self, None, dt),))


def _is_cached(owner: type, name: str) -> bool:
    """Return whether an attribute is a result that is computed again when it is needed."""
    return isinstance(getattr(owner, name, None), cached_property)


def _takes(function: Callable[..., object], count: int) -> bool:
    """Return whether a function can be called with this number of positional arguments."""
    try:
        signature(function).bind(*range(count))
    except TypeError:
        return False
    return True


def model_of(segment: Segment) -> ModelBase:
    """Return the model of a segment.

    Raises:
        ProblemError: it is not an ``ocp.ModelBase``.
    """
    if not isinstance(segment.model, ModelBase):
        raise ProblemError(
            f"schedule ({segment.source}): contains no model - got {type(segment.model).__name__}, expected an "
            "ocp.ModelBase; write model.over(duration, dt)"
        )
    return segment.model
