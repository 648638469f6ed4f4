"""Files of solutions: one ``.npz`` with a JSON header that contains the name and the version of the format."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piaffe.errors import FileFormatError
from piaffe.files import Fault, assembling, read_archive, write_archive
from piaffe.ocp import Block, Manifold, PhaseTrajectory, Quantity, Trajectory, Violation

from .parts import PhaseSolution
from .record import Record
from .search_state import SearchState
from .status import Status

FORMAT = "piaffe-solution"
VERSION = 1
_AGAIN = "save it again"

Array = NDArray[np.float64]
_ARRAYS = ("feedforward", "feedback", "V_x", "V_xx", "Q_x", "Q_u", "Q_xx", "Q_ux", "Q_uu", "defects", "target_states")
_NUMBERS = ("cost", "max_defect", "max_equality", "max_inequality", "barrier_weight", "wall_s", "compile_s")


def _space(space: Manifold) -> list[dict[str, Any]]:
    return [
        {"quantity": asdict(b.quantity), "labels": b.labels, "rate_of": asdict(b.rate_of) if b.rate_of else None}
        for b in space.blocks
    ]


def _read_space(blocks: list[dict[str, Any]]) -> Manifold:
    return Manifold(
        tuple(
            Block(Quantity(**b["quantity"]), tuple(b["labels"]), Quantity(**b["rate_of"]) if b["rate_of"] else None)
            for b in blocks
        )
    )


def write(solution: Mapping[str, Any], path: Path) -> Path:
    """Write a solution, atomically.

    Args:
        solution: fields of the solution by name, see :class:`Solution`.
        path: the file; ``.npz`` is added if it is missing.

    Returns:
        The path of the file.
    """
    arrays: dict[str, Array] = {}
    phases = []
    for i, (part, policy) in enumerate(zip(solution["trajectory"].phases, solution["phases"], strict=True)):
        arrays |= {f"{i}/times": part.times, f"{i}/states": part.states, f"{i}/controls": part.controls}
        arrays |= {f"{i}/{name}": getattr(policy, name) for name in _ARRAYS}
        arrays |= {f"{i}/multipliers/{name}": value for name, value in policy.multipliers.items()}
        arrays |= {f"{i}/outputs/{j}": value for j, value in enumerate(part.outputs.values())}
        arrays |= {f"{i}/reset_outputs/{j}": value for j, value in enumerate(part.reset_outputs.values())}
        phases.append({
            "name": part.name, "mode": part.mode, "model": part.model, "ends_phase": part.ends_phase,
            "state": _space(part.state), "control": _space(part.control),
            "outputs": [asdict(quantity) for quantity in part.outputs], "multipliers": list(policy.multipliers),
            "reset_outputs": [asdict(quantity) for quantity in part.reset_outputs],
            "output_labels": {of.path: list(labels) for of, labels in part.output_labels.items()},
        })  # fmt: skip
    names = [field.name for field in fields(Record)]
    arrays["history"] = np.array([[getattr(r, n) for n in names] for r in solution["history"]]).reshape(-1, len(names))
    header = {
        "format": FORMAT, "version": VERSION, "status": solution["status"].name, "phases": phases, "history": names,
        "term_costs": dict(solution["term_costs"]), "violations": [asdict(v) for v in solution["violations"]],
        "models": dict(solution["models"]), "limits": list(solution["limits"]), "fault": solution["fault"],
        "search": None if solution["search"] is None else solution["search"].to_json(),
        **{name: solution[name] for name in _NUMBERS},
    }  # fmt: skip
    path = target(path)
    write_archive(path, header, arrays)
    return path


def target(path: Path) -> Path:
    """Return the path with ``.npz`` added if it is missing."""
    return path if path.suffix == ".npz" else path.with_name(path.name + ".npz")


def _error(path: Path, what: str, got: object, expected: str, advice: str) -> FileFormatError:
    return FileFormatError(f"file '{path.name}': {what} - got {got}, expected {expected}; {advice}")


def read(path: Path) -> dict[str, Any]:
    """Return the fields of a solution by name.

    Raises:
        FileFormatError: the file is missing, truncated, foreign, or written by a newer version.
    """
    if not path.is_file():
        raise _error(path, "does not exist", "no file", "a saved solution", "check the path")

    def refuse(fault: Fault) -> FileFormatError:
        return _refusal(path, fault)

    header, data = read_archive(path, FORMAT, VERSION, refuse)
    with assembling(refuse):
        return _assemble(header, data)


def _refusal(path: Path, fault: Fault) -> FileFormatError:
    """Return the error of a file that is damaged or is not a solution."""
    if fault.kind == "inconsistent":
        if isinstance(fault.got, KeyError):
            return _error(path, "incomplete", f"no {fault.got}", "every array of the header", _AGAIN)
        return _error(path, "inconsistent", fault.got, f"what version {VERSION} describes", _AGAIN)
    if fault.kind in ("damaged", "unreadable"):
        return _error(path, "truncated or not an archive", fault.got, "a .npz saved by Piaffe", _AGAIN)
    if fault.kind == "newer":
        return _error(path, "written by a newer Piaffe", fault.got, f"at most {VERSION}", "upgrade Piaffe")
    got = "no readable header" if fault.kind == "headless" else fault.got
    expected = {"headless": f"one of format '{FORMAT}'", "foreign": f"'{FORMAT}'", "unversioned": "a whole number"}
    return _error(path, "foreign archive", got, expected[fault.kind], "pass a file saved by Piaffe")


def _record(values: dict[str, Any]) -> Record:
    return Record(**{**values, "iteration": int(values["iteration"])})


def _check_shapes(where: str, part: PhaseTrajectory, policy: PhaseSolution) -> None:
    """Raise ValueError if the arrays of a phase do not fit each other."""
    n, nx, ndx, nu = len(part.controls), part.state.nx, part.state.ndx, part.control.nx
    expected = {
        "feedforward": (n, nu), "feedback": (n, nu, ndx), "V_x": (n + 1, ndx), "V_xx": (n + 1, ndx, ndx),
        "Q_x": (n, ndx), "Q_u": (n, nu), "Q_xx": (n, ndx, ndx), "Q_ux": (n, nu, ndx), "Q_uu": (n, nu, nu),
        "defects": (n + 1, ndx), "target_states": (n + 1, nx),
    }  # fmt: skip
    found = {name: getattr(policy, name) for name in expected}
    expected |= {"times": (n + 1,), "states": (n + 1, nx), "controls": (n, nu)}
    found |= {name: getattr(part, name) for name in ("times", "states", "controls")}
    for name, shape in expected.items():
        if found[name].shape != shape or found[name].dtype.kind != "f":
            raise ValueError(f"'{where}/{name}' {found[name].shape} of {found[name].dtype}, beside {n} controls")


def _assemble(header: dict[str, Any], data: dict[str, Array]) -> dict[str, Any]:
    parts, policies = [], []
    for i, phase in enumerate(header["phases"]):
        outputs = {Quantity(**q): data[f"{i}/outputs/{j}"] for j, q in enumerate(phase["outputs"])}
        at_reset = phase.get("reset_outputs", [])  # not in the files of earlier releases
        reset_outputs = {Quantity(**q): data[f"{i}/reset_outputs/{j}"] for j, q in enumerate(at_reset)}
        labels = phase.get("output_labels", {})  # nor are these
        output_labels = {of: tuple(labels[of.path]) for of in (*outputs, *reset_outputs) if of.path in labels}
        parts.append(
            PhaseTrajectory(
                name=phase["name"], mode=phase["mode"], model=phase["model"], times=data[f"{i}/times"],
                states=data[f"{i}/states"], controls=data[f"{i}/controls"], outputs=outputs,
                state=_read_space(phase["state"]), control=_read_space(phase["control"]),
                ends_phase=phase["ends_phase"], reset_outputs=reset_outputs, output_labels=output_labels,
            )
        )  # fmt: skip
        multipliers = {name: data[f"{i}/multipliers/{name}"] for name in phase["multipliers"]}
        policies.append(PhaseSolution(**{name: data[f"{i}/{name}"] for name in _ARRAYS}, multipliers=multipliers))
        _check_shapes(str(i), parts[-1], policies[-1])
    if data["history"].ndim != 2:
        raise ValueError(f"'history' {data['history'].shape}")
    history = tuple(_record(dict(zip(header["history"], map(float, row), strict=True))) for row in data["history"])
    return dict(
        status=Status[header["status"]], trajectory=Trajectory(tuple(parts)), phases=tuple(policies), history=history,
        term_costs=header["term_costs"], violations=tuple(Violation(**v) for v in header["violations"]),
        models=header["models"], limits=tuple(header["limits"]), fault=header.get("fault", ""),
        search=SearchState.from_json(header["search"]) if header.get("search") else None,
        **{name: float(header[name]) for name in _NUMBERS},
    )  # fmt: skip
