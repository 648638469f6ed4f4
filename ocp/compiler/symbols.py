"""Symbols of a node: state, control, implicit part and parameter vector; checks that an expression has no others."""

from __future__ import annotations

import casadi as cs

from piaffe.errors import ProblemError

from ..language import TIME_STEP, ModelBase, Parameter, ParameterKey, find_parameter
from .layout import Layout


class NodeSymbols:
    """Symbols of one node, and a parameter vector to which terms and reset maps add parts.

    Args:
        model: the node's model; the time step and its slots come first in the parameter vector.
        nz: size of the implicit part z.
    """

    def __init__(self, model: ModelBase, nz: int) -> None:
        self.x = cs.SX.sym("x", model.state.nx)
        self.u = cs.SX.sym("u", model.control.nx)
        self.z = cs.SX.sym("z", nz)
        self._parts: dict[ParameterKey, cs.SX] = {TIME_STEP: cs.SX.sym("dt")}
        for slot in model.slots:
            key = ParameterKey("slot", slot.name, model=model.name, positive=slot.positive, check=slot.check)
            self._parts[key] = cs.SX.sym(slot.name, slot.size)
        self._parameters: dict[ParameterKey, Parameter] = {}

    @property
    def p(self) -> cs.SX:
        """The parameter vector so far."""
        return cs.vertcat(*self._parts.values())

    @property
    def layout(self) -> Layout:
        """The positions of the parameters in the vector so far."""
        return Layout((key, symbol.numel()) for key, symbol in self._parts.items())

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The user's parameters in the vector so far."""
        return tuple(self._parameters.values())

    def of_model(self) -> dict[str, cs.SX]:
        """Return the parts that the model uses, by its own names: its slots and ``"dt"``."""
        slots = {key.name: symbol for key, symbol in self._parts.items() if key.kind == "slot"}
        return {**slots, "dt": self._parts[TIME_STEP]}

    def part(self, key: ParameterKey, size: int) -> cs.SX:
        """Return the part of the parameter vector with this key; a new one if there is none."""
        if key not in self._parts:
            self._parts[key] = cs.SX.sym(key.name or key.kind, size)
        return self._parts[key]

    def check(self, where: str, expression: cs.SX, absent: cs.SX | None = None) -> None:
        """Check the symbols of an expression, and add the user's parameters in it to the parameter vector.

        Args:
            where: the declaration of the expression, for messages.
            expression: the expression.
            absent: symbols that do not exist at this place.

        Raises:
            ProblemError: the expression contains a symbol that is not of this node, or one that is absent.
        """
        if absent is not None and cs.depends_on(expression, absent):
            raise ProblemError(
                f"{where}: depends on control or contact force where there is none - got an expression of them at the "
                "end of a phase, expected one of the state; change it"
            )
        own = {
            e.element_hash()
            for part in (self.x, self.u, self.z, *self._parts.values(), *self._parameters.values())
            for e in cs.symvar(part)
        }
        for symbol in cs.symvar(expression):
            if symbol.element_hash() in own:
                continue
            parameter = find_parameter(symbol)
            if parameter is None:
                raise ProblemError(
                    f"{where}: a symbol is not from the node's quantities - got '{symbol.name()}', expected only what "
                    "the function's argument supplies (or an ocp.parameter); compute it inside the function from its "
                    "argument"
                )
            self._add(parameter, where)
            own |= {e.element_hash() for e in cs.symvar(parameter)}

    def _add(self, parameter: Parameter, where: str) -> None:
        """Add a part for a user's parameter of a declaration."""
        key = ParameterKey("parameter", parameter.label)
        if self._parameters.get(key, parameter) is not parameter:
            raise ProblemError(
                f"{where}, parameter '{parameter.label}': two parameters share a name - got two objects, expected one; "
                "rename one"
            )
        self._parameters[key] = parameter
        self._parts[key] = cs.SX(parameter)
