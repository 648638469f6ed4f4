"""Value functions and their files. A file contains what the value was learnt for; a different use raises an error."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from piaffe.errors import FileFormatError, SamplingError, UnknownNameError
from piaffe.files import Fault, assembling, read_archive, write_archive
from piaffe.ocp import Nodes

from ..options import Options
from ..reward import Reward
from .compiled import compiled_network
from .fingerprint import Entries, differences, fingerprint
from .inputs import BoundInputs, Feature, ValueInputs
from .network import Network, Single

Array = NDArray[np.float64]
Precision = Literal["half", "single"]

FORMAT, VERSION = "piaffe-value", 1
_HEADER = "manifest.json"
_EXACT = ("mean", "std", "head_bias")  # stored in single precision, even if the others are in half precision


class Served(Protocol):
    """The parts of a controller that a value is checked against."""

    @property
    def nodes(self) -> Nodes:
        """Nodes of its problem."""
        ...

    @property
    def reward(self) -> Reward:
        """Reward as a function of the cost."""
        ...

    @property
    def options(self) -> Options:
        """Its options."""
        ...


@dataclass(frozen=True, eq=False)
class Value:
    """A value function: the expected return from a state on, V = E[γ₀ (1 − δ) (r + V')], never negative.

    The value of a robot that has fallen is 0.

    Args:
        network: V as a function of the inputs.
        inputs: inputs of the network.
        made_for: the fingerprint of what it was learnt for, see :mod:`piaffe.sampling.value.fingerprint`.
        record: how it was learnt: options, results, curves, ``constraints`` and their ``c_max``, the command that made
            it; anything that JSON can hold.
        fall: ``tilt`` from the ground's normal [rad] and ``height`` [m] beyond which a robot has fallen; empty if it
            cannot fall.
    """

    network: Network
    inputs: ValueInputs
    made_for: Entries
    record: Entries = field(default_factory=dict)
    fall: Mapping[str, float] = field(default_factory=dict)
    _bound: dict[Nodes, BoundInputs] = field(default_factory=dict, repr=False)

    def __repr__(self) -> str:
        robot = self.made_for.get("robot", {}).get("name", "?")
        known = f"Value(of '{robot}', γ₀ = {self.discount:g}, inputs = {list(self.made_for['inputs'])}, "
        return f"{known}hidden = {self.network.hidden})"

    def __call__(self, states: Array, k: int, nodes: Nodes) -> Array:
        """Return V of states at a node, (n,).

        Args:
            states: (n, nx).
            k: index of the node; its time is ``k dt``.
            nodes: nodes of the problem.
        """
        if nodes not in self._bound:
            self._bound[nodes] = self.inputs.bind(nodes)
        seen = self._bound[nodes](states, k)
        values = self._compiled(seen).astype(float)
        values[self._fallen(seen)] = 0.0
        return values

    @cached_property
    def _compiled(self) -> Callable[[Array], Single]:
        return compiled_network(self.network)

    @property
    def discount(self) -> float:
        """γ₀."""
        return float(self.made_for["discount"])

    def _fallen(self, seen: Array) -> NDArray[np.bool_]:
        """Return which rows of inputs (n, m) are falls; a criterion whose input is missing is not used."""
        fallen, start = np.zeros(len(seen), dtype=bool), 0
        for name, size in self.made_for["inputs"].items():
            if name == "ground normal" and "tilt" in self.fall:
                fallen |= seen[:, start + 2] < np.cos(self.fall["tilt"])
            if name == "base height" and "height" in self.fall:
                fallen |= seen[:, start] < self.fall["height"]
            start += size
        return fallen

    def check(
        self, nodes: Nodes, reward: Reward, options: Options, allow: Collection[str] = (), where: str = "value"
    ) -> None:
        """Raise an error unless the value was learnt for the controller's problem, reward and options.

        Args:
            nodes: nodes of the controller's problem.
            reward: the controller's reward.
            options: options of the controller.
            allow: entries that may differ: ``"terrain"``, ``"payload"``, ``"motion.commands"``,
                ``"objective.track base.height"``, …
            where: start of the error message.

        Raises:
            SamplingError: an entry differs that is not in ``allow``; the message names it.
            UnknownNameError: ``allow`` has a name that is not an entry.
        """
        now = fingerprint(nodes, reward, options, self.inputs)
        allow = allow.replace(",", " ").split() if isinstance(allow, str) else allow
        entries = sorted({*self.made_for, *now})
        for name in allow:
            if name.split(".")[0] not in entries:
                raise UnknownNameError(f"{where}, allow", "entry", name, entries)
        found = differences(self.made_for, json.loads(json.dumps(now)))
        found = [each for each in found if not any(each[0] == n or each[0].startswith(f"{n}.") for n in allow)]
        if found:
            path, kept, here = found[0]
            others = tuple(dict.fromkeys(each.split(".")[0] for each, _, _ in found))
            use = f', or pass allow={others} (--allow "{" ".join(others)}") to use it anyway'
            raise SamplingError(
                f"{where}: was learnt for something else - got '{path}' {_brief(here)}, expected {_brief(kept)}"
                f"{f' (and {len(found) - 1} more differ)' if len(found) > 1 else ''}; learn one for this problem"
                f"{'' if 'robot' in others else use}"
            )

    def save(self, path: str | os.PathLike[str], precision: Precision = "single") -> Path:
        """Write the value to one file, in one atomic step.

        Args:
            path: the file; ``.value`` is added if it is missing.
            precision: precision of the weights; ``"half"`` halves the file's size, with errors of about 1e-3 in values.

        Returns:
            The path of the file.
        """
        target = Path(path)
        target = target if target.suffix == ".value" else target.with_name(target.name + ".value")
        kind = np.float16 if precision == "half" else np.float32
        header = {
            "format": FORMAT, "version": VERSION, "precision": precision, "hidden": self.network.hidden,
            "made_for": self.made_for, "fall": dict(self.fall), "record": self.record,
        }  # fmt: skip
        arrays = {
            name.replace("/", "."): values if name in _EXACT else values.astype(kind)
            for name, values in self.network.arrays().items()
        }
        write_archive(target, header, arrays, member=_HEADER)
        return target


def load_value(
    path: str | os.PathLike[str],
    controller: Served | None = None,
    *,
    allow: Collection[str] = (),
    features: Iterable[Feature] = (),
) -> Value:
    """Return the value function of a file.

    Args:
        path: the file.
        controller: the controller that will use it; the value is checked against it. None reads without a check.
        allow: entries that may differ, see :meth:`Value.check`.
        features: the user's own features among the inputs.

    Raises:
        FileFormatError: the file is not a value file, is damaged, or was written by a newer version.
        SamplingError: the value was learnt for another robot, objective, reward, discount, …
        UnknownNameError: it has an input that is not a known feature.
    """
    file = Path(path)
    refuse = _refusing(file)
    header, arrays = _read(file)
    own = {feature.name: feature for feature in features}
    with assembling(refuse):
        made_for, fall, record = (_object(header, name) for name in ("made_for", "fall", "record"))
        limits = {str(name): float(limit) for name, limit in fall.items()}
        sizes = [int(size) for size in _object(made_for, "inputs").values()]
        inputs = ValueInputs([own.get(name, name) for name in made_for["inputs"]])
        network = Network.from_arrays(arrays)
        network.check(sum(sizes))
        float(made_for["discount"])
        value = Value(network, inputs, made_for, record, limits)
    if controller is not None:
        value.check(controller.nodes, controller.reward, controller.options, allow, f"value '{file}'")
    return value


def digest(path: str | os.PathLike[str]) -> str:
    """Return a digest of a value file: of what the value was learnt for, and of its numbers.

    The record of the learning has no effect on it: an interrupted run that was resumed gives the same digest.
    """
    header, arrays = _read(Path(path))
    with assembling(_refusing(Path(path))):
        found = hashlib.sha256(json.dumps([header["made_for"], header["fall"]], sort_keys=True).encode())
    for name in sorted(arrays):
        found.update(name.encode() + np.ascontiguousarray(arrays[name]).tobytes())
    return found.hexdigest()


def _read(file: Path) -> tuple[dict[str, Any], dict[str, Array]]:
    header, arrays = read_archive(file, FORMAT, VERSION, _refusing(file), header=_HEADER)
    return header, {name.replace(".", "/"): values for name, values in arrays.items()}


def _refusing(file: Path) -> Callable[[Fault], FileFormatError]:
    """Return the function that makes the error for a fault of a file."""

    def refuse(fault: Fault) -> FileFormatError:
        if fault.kind == "unreadable":
            return FileFormatError(
                f"value '{file}': cannot be read - got {fault.got}, expected the path of a value; correct it, or learn "
                "one by piaffe.sampling.train_value"
            )
        if fault.kind in ("damaged", "headless", "inconsistent"):
            got = f"no {fault.got}" if isinstance(fault.got, KeyError) else fault.got
            return FileFormatError(
                f"value '{file}': cannot be read - got {got}, expected a file written by Value.save; copy or learn it "
                "again"
            )
        return FileFormatError(
            f"value '{file}': is not a value file that this version reads - got format {fault.format!r}, version "
            f"{fault.version}, expected '{FORMAT}' up to version {VERSION}; update Piaffe or learn it again"
        )

    return refuse


def _object(values: Mapping[str, Any], name: str) -> dict[str, Any]:
    """Return an entry that is an object; raise KeyError or ValueError if it is missing or something else."""
    found = values[name]
    if not isinstance(found, dict):
        raise ValueError(f"'{name}' {found!r}, which is no object"[:200])
    return found


def _brief(value: Any) -> str:
    text = json.dumps(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
