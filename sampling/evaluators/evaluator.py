"""Evaluators of the cost and violations of a mode, and of any function of a node, over samples and steps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import casadi as cs

from piaffe.errors import ShapeError
from piaffe.ocp import Constraint, Cost, LoweredMode

from .batch_function import PER_SAMPLE, BatchFunction
from .scoring import Scoring


class Evaluator:
    """Cost and violations of a lowered mode over n samples and S steps.

    Except with JAX, the next call with the same numbers of samples and steps overwrites the results; copy them to keep
    them. States may be views with strides, such as ``rolled[:, :-1]``; they are not copied.

    Args:
        scoring: the functions of the mode.
        engine: name of the engine.
        stage: cost and violation of a stage.
        terminal: cost and violation of the last node.
    """

    def __init__(self, scoring: Scoring, engine: str, stage: BatchFunction, terminal: BatchFunction) -> None:
        self.scoring, self.engine = scoring, engine
        self._stage, self._terminal = stage, terminal

    @property
    def mode(self) -> LoweredMode:
        """The mode."""
        return self.scoring.mode

    def constraints(self, terms: Sequence[Cost | Constraint]) -> tuple[str, ...]:
        """Return the name of the constraint that each row of a stage's violation belongs to, (nc,)."""
        return self.scoring.constraints(terms)

    def stage(
        self, states: Any, controls: Any, p: Any, weight: Any, g_mask: Any, h_mask: Any, z: Any = None
    ) -> tuple[Any, Any]:
        """Return running cost (n, S), per unit of time, and violation (nc, n, S), divided by the row's scale.

        Args:
            states: x (n, S, nx).
            controls: u (n, S, nu).
            p: parameters of the steps (S, np).
            weight: residual weights (S, nr).
            g_mask: 0 or 1 per inequality (S, ng).
            h_mask: 0 or 1 per equality (S, nh).
            z: implicit variables (n, S, nz); None for a model without them.

        Raises:
            ShapeError: an array has the wrong shape.
        """
        given = {"x": states, "u": controls, "p": p, "weight": weight, "g_mask": g_mask, "h_mask": h_mask, "z": z}
        (cost, violation) = _evaluate(self._stage, f"evaluator of '{self.mode.model.name}', stage", given)
        return cost[0], violation

    def terminal(self, states: Any, p: Any, weight: Any, g_mask: Any, h_mask: Any) -> tuple[Any, Any]:
        """Return the cost (n,) and violation (nc_end, n) of the last node.

        Args:
            states: x (n, nx).
            p: parameters (np,).
            weight: residual weights (nr_end,).
            g_mask: 0 or 1 per inequality (ng_end,).
            h_mask: 0 or 1 per equality (nh_end,).

        Raises:
            ShapeError: an array has the wrong shape.
        """
        where = f"evaluator of '{self.mode.model.name}', terminal"
        given = {"x": states, "p": p, "weight": weight, "g_mask": g_mask, "h_mask": h_mask}
        (cost, violation) = _evaluate(self._terminal, where, given, is_end=True)
        return cost[0, :, 0], violation[:, :, 0]


class Rows:
    """An evaluator of a function of a node's x, u, z and p, over n samples and S steps.

    Args:
        engine: name of the engine.
        function: the function.
    """

    def __init__(self, engine: str, function: BatchFunction) -> None:
        self.engine, self._function = engine, function

    def __call__(self, states: Any = None, controls: Any = None, p: Any = None, z: Any = None) -> Any:
        """Return the rows of the function's first output, (n, S, m); the next call overwrites them, as in Evaluator.

        Args:
            states: x (n, S, nx).
            controls: u (n, S, nu).
            p: parameters of the steps (S, np).
            z: implicit variables (n, S, nz).

        Raises:
            ShapeError: an array has the wrong shape, or an array that the function needs is missing.
        """
        where = f"rows of '{self._function.function.name()}'"
        return _evaluate(self._function, where, {"x": states, "u": controls, "p": p, "z": z})[0]


def rows_inputs(function: cs.Function) -> None:
    """Check that a function is a function of a node.

    Raises:
        ShapeError: the name of an input is not x, u, z or p, or an input or the output is not a column.
    """
    unknown = [name for name in function.name_in() if name not in ("x", "u", "z", "p")]
    not_columns = [name for i, name in enumerate(function.name_in()) if function.size2_in(i) != 1]
    if unknown or not_columns or function.n_out() < 1 or function.size2_out(0) != 1:
        raise ShapeError(
            f"rows of '{function.name()}': not a function of a node - got {function}, expected columns named among x, "
            "u, z and p, and a column; change their names and shapes"
        )


def _evaluate(function: BatchFunction, where: str, given: Mapping[str, Any], *, is_end: bool = False) -> list[Any]:
    """Check shapes and evaluate; arrays of the last node have no axis of steps."""
    arguments, n, steps = [], None, None
    arrays = {
        name: function.array(given[name]) for name, size in function.inputs if size and given.get(name) is not None
    }
    if is_end:
        arrays = {name: a[:, None] if name == "x" and a.ndim == 2 else a[None] for name, a in arrays.items()}
    for name, array in arrays.items():
        if name in PER_SAMPLE and array.ndim == 3:
            n, steps = (array.shape[:2]) if n is None else (n, steps)
        elif name not in PER_SAMPLE and array.ndim == 2 and steps is None:
            steps = array.shape[0]
    n, steps = 1 if n is None else n, 1 if steps is None else steps
    for name, size in function.inputs:
        shape = (n, steps, size) if name in PER_SAMPLE else (steps, size)
        if size == 0:
            arguments.append(function.array([]).reshape(shape))
            continue
        got = arrays[name].shape if name in arrays else None
        if got != shape:
            advice = "p, weights and masks need one row per step, others one per sample and step" if got else "pass it"
            raise ShapeError(
                f"{where}: {_LONG_NAMES.get(name, name)} does not fit - got {got or 'none'}, expected {shape}; {advice}"
            )
        arguments.append(arrays[name])
    return function(arguments, n, steps)


_LONG_NAMES = {"x": "states", "u": "controls"}
