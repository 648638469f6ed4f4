"""Model: a user's own dynamics - named states and controls, and one function per mode."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping
from typing import Any, Literal

import casadi as cs

from piaffe.errors import ModelError, ShapeError, UnknownNameError

from .manifold import Block, Manifold
from .model import Dynamics, ModelBase, Quantities
from .quantity import Bound, Quantity
from .source import Source, caller
from .user_input import call, is_number
from .view import NodeView, column

Vectorfield = Callable[..., Mapping[str, Any]]


def _blocks(entries: Mapping[str, int | str], where: str) -> Manifold:
    blocks = []
    for name, size in entries.items():
        if size != "rotation" and not (is_number(size) and int(size) == size and size > 0):
            raise ModelError(
                f"{where}: size of '{name}' is unusable - got {size!r}, expected a whole number > 0, or 'rotation'; "
                "give one"
            )
        if size == "rotation":
            blocks.append(Block(Quantity(name, "rad", "rotation"), ("x", "y", "z")))
        else:
            labels = ("",) if size == 1 else tuple(str(i) for i in range(int(size)))
            blocks.append(Block(Quantity(name), labels))
    return Manifold(tuple(blocks))


class Model(ModelBase):
    """A model with the user's own dynamics.

    Args:
        name: its name.
        state: names and sizes; ``"rotation"`` instead of a size for a unit quaternion (w, x, y, z).
        control: names and sizes; may be empty.
        modes: mode name → function of the node's quantities returning each state's time derivative (for a rotation
            the body angular velocity) or, with ``integrator="discrete"``, its next value.
        quantities: name → function of the node's quantities; terms may use them like states and controls.
        integrator: ``"euler"`` (explicit, on the manifold), ``"rk4"``, or ``"discrete"``.
    """

    def __init__(
        self,
        name: str,
        *,
        state: Mapping[str, int | str],
        control: Mapping[str, int] | None = None,
        modes: Mapping[str, Vectorfield],
        quantities: Mapping[str, Callable[[NodeView], Any]] | None = None,
        integrator: Literal["euler", "rk4", "discrete"] = "euler",
    ) -> None:
        source = caller()
        where = f"model '{name}' ({source})"
        super().__init__(name, _blocks(state, where), _blocks(control or {}, where))
        if not modes:
            raise ModelError(f"{where}: no modes - got none, expected at least one dynamics function; give modes=")
        if integrator not in ("euler", "rk4", "discrete"):
            raise ModelError(
                f"{where}: integrator is unknown - got {integrator!r}, expected 'euler', 'rk4' or 'discrete'; "
                "choose one"
            )
        names = [*state, *(control or {}), *(quantities or {})]
        twice = sorted({key for key in names if names.count(key) > 1})
        if twice:
            raise ModelError(
                f"{where}: names are not unique - got {twice} twice, expected each state, control and quantity "
                "once; rename one"
            )
        object.__setattr__(self, "source", source)
        object.__setattr__(self, "modes", dict(modes))
        object.__setattr__(self, "extra", dict(quantities or {}))
        object.__setattr__(self, "integrator", integrator)

    modes: Mapping[str, Vectorfield]
    extra: Mapping[str, Callable[[NodeView], Any]]
    integrator: str
    source: Source

    def mode_key(self, mode: Hashable) -> str:
        """Return the mode's name; raise if the model has no such mode."""
        if not isinstance(mode, str) or mode not in self.modes:
            raise UnknownNameError(f"model '{self.name}' ({self.source})", "mode", str(mode), self.modes)
        return str(mode)

    def quantities_at(self, x: cs.SX, u: cs.SX) -> Quantities:
        """Return the states, controls and further expressions as quantities."""
        makers: dict[str, Callable[[], Bound]] = {}

        def bound(quantity: Quantity, value: cs.SX, labels: tuple[str, ...]) -> Callable[[], Bound]:
            return lambda: Bound(quantity, value, labels)

        for space, symbol in ((self.state, x), (self.control, u)):
            for block in space.blocks:
                makers[block.quantity.path] = bound(block.quantity, symbol[space.slices[block.quantity]], block.labels)
        quantities = Quantities(self.name, makers)

        def further(name: str, function: Callable[[NodeView], Any]) -> Callable[[], Bound]:
            def make() -> Bound:
                value = column(
                    call(function, f"model '{self.name}' ({self.source}), quantity '{name}'", NodeView(quantities))
                )
                labels = ("",) if value.numel() == 1 else tuple(str(i) for i in range(value.numel()))
                return Bound(Quantity(name), value, labels)

            return make

        makers.update({name: further(name, function) for name, function in self.extra.items()})
        return quantities

    def vector_field(self, key: str, x: cs.SX, u: cs.SX) -> cs.SX:
        """Return the stacked derivatives of a mode (tangent; or next values, if discrete)."""
        where = f"model '{self.name}' ({self.source}), mode '{key}'"
        given = dict(call(self.modes[key], where, NodeView(self.quantities_at(x, u))))
        paths = [block.quantity.path for block in self.state.blocks]
        missing = [path for path in paths if path not in given]
        if missing or len(given) > len(paths):
            what = "a state has no derivative" if missing else "unknown states"
            raise ModelError(f"{where}: {what} - got {sorted(given)}, expected {paths}; return exactly these")
        parts = []
        for block, path in zip(self.state.blocks, paths, strict=True):
            value = column(given[path])
            size = block.nx if self.integrator == "discrete" else block.ndx
            if value.numel() != size:
                raise ShapeError(
                    f"{where}: '{path}' has the wrong size - got {value.numel()}, expected {size}; return {size}"
                )
            parts.append(value)
        return cs.vertcat(*parts)

    def dynamics(self, key: str, x: cs.SX, u: cs.SX, z: cs.SX, p: Mapping[str, cs.SX]) -> Dynamics:
        """Return the discrete step and the quantities."""
        dt = p["dt"]
        slope = self.vector_field(key, x, u)
        if self.integrator == "discrete":
            step = slope
        elif self.integrator == "euler":
            step = self.state.plus(x, dt * slope)
        else:
            k2 = self.vector_field(key, self.state.plus(x, dt / 2 * slope), u)
            k3 = self.vector_field(key, self.state.plus(x, dt / 2 * k2), u)
            k4 = self.vector_field(key, self.state.plus(x, dt * k3), u)
            step = self.state.plus(x, dt / 6 * (slope + 2 * k2 + 2 * k3 + k4))
        return Dynamics(cs.SX(0, 1), step, self.quantities_at(x, u))
