"""Quantities: the named physical quantities that terms use.

A :class:`Quantity` is only a name with a unit and a geometric kind. Models *bind* the quantities they can supply to
CasADi expressions of their own state and control (:class:`Bound`).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Literal

import casadi as cs

from piaffe.errors import UnknownNameError

Kind = Literal["vector", "point", "direction", "rotation"]

_ANGLES = {"roll": "x", "pitch": "y", "yaw": "z"}  # axes about which these angles turn a level base


@dataclass(frozen=True)
class Quantity:
    """The name of a physical quantity.

    Args:
        path: dotted name, e.g. ``"base.position"``.
        unit: SI unit of one component, ``""`` if it has none. A rotation has unit ``"rad"``.
        kind: ``"vector"``: plain numbers. ``"point"``: stacked world points (x, y, z), moved by a change of
            frame. ``"direction"``: stacked world vectors (x, y, z), turned by it. ``"rotation"``: a unit quaternion
            (w, x, y, z) whose differences are body-axis rotation vectors.
    """

    path: str
    unit: str = ""
    kind: Kind = "vector"

    def __str__(self) -> str:
        return self.path

    def __hash__(self) -> int:
        return hash(self.path)  # fast: samples have quantities as keys; two quantities seldom share a path


@dataclass(frozen=True)
class QuantityGroup:
    """Quantities with one prefix, as attributes: ``base.position``."""

    name: str
    members: Mapping[str, Quantity]

    def __getattr__(self, name: str) -> Quantity:
        if name.startswith("__"):
            raise AttributeError(name)
        try:
            return self.members[name]
        except KeyError:
            raise UnknownNameError(f"quantities '{self.name}'", "quantity", name, self.members) from None


def group(name: str, **members: Quantity | tuple[str, Kind] | str) -> QuantityGroup:
    """Return a group; each member is a quantity, a unit, or a pair (unit, kind)."""
    built = {}
    for key, value in members.items():
        if isinstance(value, Quantity):
            built[key] = value
        else:
            unit, kind = (value, "vector") if isinstance(value, str) else value
            built[key] = Quantity(f"{name}.{key}", unit, kind)  # type: ignore[arg-type]  # Literal from caller
    return QuantityGroup(name, built)


@dataclass(frozen=True)
class Bound:
    """A quantity bound by a model: its expression and the names of its components.

    Args:
        quantity: the quantity.
        value: expression, shape (n, 1); for a rotation the quaternion (4, 1).
        labels: one name per component of a *difference* of two values: ``("x", "y", "z")``, joint names, or
            ``("FL x", "FL y", ...)`` for stacked feet.
        mask: optional expression of parameters, (len(labels), 1), 0 where a component is absent (a foot in the air).
        scale: divisor of rows that a model derives from the quantity, in its unit.
    """

    quantity: Quantity
    value: cs.SX
    labels: tuple[str, ...]
    mask: cs.SX | None = None
    scale: float = 1.0

    @property
    def size(self) -> int:
        """Number of components of a difference (3 for a rotation)."""
        return len(self.labels)

    def indices(self, key: str) -> list[int]:
        """Return the components that a key names: a label, or the part of labels before or after ``_`` or a space."""
        return match_labels(self.labels, key, f"quantity '{self.quantity}'")


def match_labels(labels: tuple[str, ...], key: str, where: str) -> list[int]:
    """Return the indices of the labels that ``key`` names; raise if there is none.

    ``"FL_HAA"`` names that joint, ``"HAA"`` that joint of every leg, ``"FL"`` every component of that leg, ``"FL x"``
    one component of a stacked foot.
    """
    if key in labels:
        return [labels.index(key)]
    found = [
        i
        for i, label in enumerate(labels)
        for separator in ("_", " ")
        if label.startswith(key + separator) or label.endswith(separator + key)
    ]
    if not found:
        raise UnknownNameError(where, "component", key, labels, _advice(labels, key))
    return sorted(set(found))


def _advice(labels: tuple[str, ...], key: str) -> str:
    """Return what to write in place of a label that does not exist; empty if the labels alone say it."""
    if key in _ANGLES and labels == tuple(_ANGLES.values()):
        return f"the components are axes; for {key} write '{_ANGLES[key]}'"
    parts = [label.partition(separator) for label in labels for separator in ("_", " ") if separator in label]
    kinds = [kind for kind, count in Counter(tail for _, _, tail in parts).items() if count > 1]
    legs = [leg for leg, count in Counter(head for head, _, _ in parts).items() if count > 1]
    if not kinds:
        return ""
    close = " or ".join(map(repr, get_close_matches(key, kinds, n=2, cutoff=0.4)))
    return (f"did you mean {close}? " if close else "") + (
        f"one name may stand for several components: {', '.join(kinds)} in every leg, {', '.join(legs)} for a leg"
    )
