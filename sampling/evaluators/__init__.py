"""Evaluators: compute a mode's cost and violations over samples and steps, on one of several equivalent engines.

==========  ===========================================================  =======================
engine      how                                                          needs
==========  ===========================================================  =======================
``native``  C with SIMD over samples, on threads                         a C compiler
``numpy``   the instruction list on NumPy arrays                         nothing
``vm``      CasADi's virtual machine, one sample after another           nothing
``jax``     the instruction list on JAX arrays, also within ``jit``      ``piaffe[sampling]``
==========  ===========================================================  =======================
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from typing import Literal, get_args

import casadi as cs

from piaffe.codegen import NoCompilerError, NoCompilerWarning, available_cores
from piaffe.errors import SamplingError
from piaffe.ocp import LoweredMode

from .arrays import ArrayFunction
from .batch_function import BatchFunction
from .evaluator import Evaluator as Evaluator
from .evaluator import Rows as Rows
from .evaluator import rows_inputs
from .jax import JaxFunction
from .native import NativeFunction, library_of
from .scoring import Scoring as Scoring
from .scoring import scoring as scoring
from .vm import VmFunction

EngineName = Literal["native", "numpy", "vm", "jax"]


def evaluator(mode: LoweredMode, engine: EngineName = "native", *, threads: int | None = None) -> Evaluator:
    """Return an evaluator of a mode.

    Args:
        mode: the lowered mode.
        engine: ``"native"``, ``"numpy"``, ``"vm"`` or ``"jax"``; without a working compiler, ``"native"`` is replaced
            by ``"numpy"``, with one warning.
        threads: number of threads of the native engine, at least 1; one per core by default.

    Raises:
        SamplingError: the engine is unknown, or JAX is not installed.
        ModelError: this engine does not support an operation of the mode.
    """
    own = scoring(mode)
    functions = {"stage": own.stage, "terminal": own.terminal}
    label = f"{mode.model.name}, scoring"
    used, made = _functions_on(functions, engine, label, by_row=True, threads=threads)
    return Evaluator(own, used, made["stage"], made["terminal"])


def rows(function: cs.Function, engine: EngineName = "native", *, threads: int | None = None) -> Rows:
    """Return an evaluator of a function of a node over samples and steps, such as the inputs of a value function.

    Args:
        function: function of columns with names among x, u, z and p, with a column as its output.
        engine: as in :func:`evaluator`.
        threads: number of threads of the native engine, at least 1; one per core by default.

    Raises:
        ShapeError: the inputs or the output of the function are others.
        SamplingError: the engine is unknown, or JAX is not installed.
        ModelError: this engine does not support an operation of the function.
    """
    rows_inputs(function)
    inputs = [cs.SX.sym(name, function.size1_in(i)) for i, name in enumerate(function.name_in())]
    output = cs.densify(function.call(inputs)[0])
    dense = cs.Function(function.name(), inputs, [output], function.name_in(), ["rows"], {"cse": True})
    used, made = _functions_on({"rows": dense}, engine, f"{function.name()}, rows", by_row=False, threads=threads)
    return Rows(used, made["rows"])


def _functions_on(
    functions: Mapping[str, cs.Function], engine: str, label: str, *, by_row: bool, threads: int | None
) -> tuple[str, dict[str, BatchFunction]]:
    """Return the name of the engine that is used, and each function on this engine, by name."""
    if engine not in get_args(EngineName):
        known = " or ".join(f"'{name}'" for name in get_args(EngineName))
        raise SamplingError(f"evaluator: engine is unknown - got {engine!r}, expected {known}; choose one")
    threads = available_cores() if threads is None else threads
    if threads < 1:
        raise SamplingError(f"evaluator: threads - got {threads}, expected 1 or more; correct it")
    if engine == "native":
        try:
            library = library_of(tuple(functions.items()), label)
        except NoCompilerError as error:
            warnings.warn(f"evaluating in NumPy, about ten times slower: {error}", NoCompilerWarning, stacklevel=3)
            engine = "numpy"
        else:
            return "native", {
                name: NativeFunction(library, name, f, by_row=by_row, threads=threads) for name, f in functions.items()
            }
    return engine, {name: _KINDS[engine](f, by_row=by_row) for name, f in functions.items()}


_KINDS: Mapping[str, Callable[..., BatchFunction]] = {"numpy": ArrayFunction, "vm": VmFunction, "jax": JaxFunction}
