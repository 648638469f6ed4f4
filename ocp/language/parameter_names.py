"""Names of parameters: the numbers of a declaration that can change, their names and their valid values.

=====================  ==========================================================================
name                   parameter
=====================  ==========================================================================
``"NAME"``             an ``ocp.parameter``
``"MODEL.SLOT"``       a model's: ``"mini_cheetah.link_mass"``, ``"mini_cheetah.terrain"``
``"TERM.PARAMETER"``   a term's own: ``"friction cone.mu"``
``"TERM.weight"``      a cost's weights, in the phases where it applies
``"TERM.target"``      a cost's own target (``to=``), if it is no rotation
``"TERM.lower"``       a constraint's bounds, if it has that side; ``"TERM.upper"`` likewise
=====================  ==========================================================================

Terms that share a name get an index in their order: ``"TERM[0].weight"``.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from piaffe.errors import ProblemError, ShapeError, UnknownNameError

from .model import ModelBase
from .parameter_key import ParameterKey
from .term import Constraint, Cost
from .user_input import brief, numbers_of

Array = NDArray[np.float64]
Names = Mapping[str, ParameterKey]


def parameter_names(terms: Sequence[Cost | Constraint], models: Iterable[ModelBase]) -> dict[str, ParameterKey]:
    """Return the parameters of terms and models by name, without ``ocp.parameter``: only functions contain these.

    Raises:
        ProblemError: two parameters share a name.
    """
    names: dict[str, ParameterKey] = {}
    for name, key in (*_of_models(models), *_of_terms(terms)):
        if name in names:
            raise ProblemError(
                f"parameter '{name}': two parameters share a name - got {names[name]} and {key}, expected one; rename "
                "the model, the term or the term's own parameter"
            )
        names[name] = key
    return names


def _of_models(models: Iterable[ModelBase]) -> Iterator[tuple[str, ParameterKey]]:
    for model in dict.fromkeys(models):
        for slot in model.slots:
            key = ParameterKey("slot", slot.name, model=model.name, positive=slot.positive, check=slot.check)
            yield f"{model.name}.{slot.name}", key


def _of_terms(terms: Sequence[Cost | Constraint]) -> Iterator[tuple[str, ParameterKey]]:
    names = [term.name for term in terms]
    for k, term in enumerate(terms):
        owner = term.name if names.count(term.name) == 1 else f"{term.name}[{names[:k].count(term.name)}]"
        if isinstance(term, Cost):
            yield f"{owner}.weight", ParameterKey("weight", term=k)
            kind = term.quantity.kind if term.quantity is not None else "rotation"
            if term.target is not None and term.target.size and kind != "rotation":
                yield f"{owner}.target", ParameterKey("target", term=k)
        else:
            if term.lower is not None:
                yield f"{owner}.lower", ParameterKey("lower", term=k)
            if term.upper is not None:
                yield f"{owner}.upper", ParameterKey("upper", term=k)
        for name in term.parameters:
            yield f"{owner}.{name}", ParameterKey("parameter", name, term=k, positive=name in term.positive)


def merged(values: Mapping[str, ArrayLike] | None, named: Mapping[str, ArrayLike], where: str) -> dict[str, ArrayLike]:
    """Return the parameters of a mapping and of keywords as one mapping.

    Raises:
        ProblemError: ``values`` is not a mapping, or a name is given twice.
    """
    if not isinstance(values, Mapping | None):
        raise ProblemError(
            f"{where}: parameters are unusable - got {brief(values)}, expected a mapping from names to numbers; write "
            "with_parameters({'friction cone.mu': 0.5}) or with_parameters(mu=0.5)"
        )
    for name in values or {}:
        if not isinstance(name, str):
            raise ProblemError(
                f"{where}: the name of a parameter is unusable - got {brief(name)}, expected text, as "
                "'friction cone.mu'; correct it"
            )
    twice = sorted({*(values or {})} & {*named})
    if twice:
        raise ProblemError(
            f"{where}: a parameter is given twice - got {twice} in the mapping and as keywords, expected each name "
            "once; remove one"
        )
    return {**(values or {}), **named}


def find_key(names: Names, name: str, where: str) -> ParameterKey:
    """Return the key of a parameter of a declaration; an unknown name without a dot counts as an ``ocp.parameter``.

    Raises:
        UnknownNameError: there is no such parameter; the message lists those that exist.
    """
    if name in names:
        return names[name]
    if "." in name:
        raise UnknownNameError(where, "parameter", name, names)
    return ParameterKey("parameter", name)


def check_value(name: str, key: ParameterKey, value: ArrayLike, where: str, size: int | None = None) -> Array:
    """Return a value for a parameter, (size,).

    Args:
        name: the parameter's name, for messages.
        key: the parameter's key.
        value: the value to check.
        where: the declaration or the call, for messages.
        size: number of entries; None if it is not known yet.

    Raises:
        ShapeError: the value has another size.
        ProblemError: it is not a number, it is not finite (a bound may be infinite), or it is a negative weight or not
            above zero where the model needs that.
    """
    array = numbers_of(value, where, f"parameter '{name}'").ravel()
    if size is not None and array.size != size:
        raise ShapeError(
            f"{where}, parameter '{name}': wrong size - got {array.size} entries, expected {size}; give as many as the "
            "present value has"
        )
    bad = np.isnan(array) if key.is_bound else ~np.isfinite(array)
    if np.any(bad):
        entry = int(np.argmax(bad))
        raise ProblemError(
            f"{where}, parameter '{name}': is not finite - got {array[entry]} at entry {entry}, expected finite "
            "numbers; fix it"
        )
    if key.kind == "weight" and np.any(array < 0):
        raise ProblemError(
            f"{where}, parameter '{name}': weight is unusable - got {array.tolist()}, expected numbers ≥ 0; fix it"
        )
    if key.positive and np.any(array <= 0):
        raise ProblemError(
            f"{where}, parameter '{name}': is out of range - got {array.tolist()}, expected numbers > 0; fix it"
        )
    expected = key.check(array) if key.check is not None else ""
    if expected:
        raise ProblemError(
            f"{where}, parameter '{name}': is out of range - got {array.tolist()}, expected {expected}; fix it"
        )
    return array
