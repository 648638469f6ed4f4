"""Driving the compiled solver: start, progress, interruption, and the result handed back to Python."""

from __future__ import annotations

import ctypes as ct
import threading
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from ..iterate import Iterate
from ..outer import Outer
from ..record import Record
from ..status import Status
from . import structs as s
from .machine import Machine

Array = NDArray[np.float64]

_STATUS = (
    Status.CONVERGED, Status.ITERATION_LIMIT, Status.TIME_LIMIT, Status.LINE_SEARCH_FAILED, Status.INFEASIBLE,
    Status.NOT_FINITE, Status.INTERRUPTED,
)  # fmt: skip
_POLL_S = 0.05


def drive(
    machine: Machine, start: Iterate, outer: Outer, resumed: bool, report: Callable[[Record], None] | None
) -> tuple[Status, Iterate, list[Record]]:
    """Run the compiled solver from a start; ``outer`` is read first and holds the end's duals afterwards.

    The solver runs in a thread of its own, so that its log can be shown and Ctrl-C can stop it.
    """
    for i, (x, u) in enumerate(zip(start.states, start.controls, strict=True)):
        machine.trial(i, "x")[:], machine.trial(i, "u")[:] = x.reshape(-1), u.reshape(-1)
    for name in ("relaxation", "shift", "multiplier", "penalty"):
        machine.write_rows(name, "stage", [getattr(d, name) for d in outer.duals])
        machine.write_rows(name, "end", [getattr(d, f"end_{name}") for d in outer.duals])
    c = machine.c
    c.weight, c.cancel, c.num_records = outer.weight, 0, 0
    last = outer.last_cost
    c.has_last_cost, c.last_cost = int(last is not None), last or 0.0
    result: list[int] = []

    def work() -> None:
        result.append(machine.library.piaffe_solve(ct.byref(c), int(resumed)))

    history: list[Record] = []
    try:
        if report is None:
            work()
        else:
            thread = threading.Thread(target=work, daemon=True)
            thread.start()
            while thread.is_alive():
                thread.join(_POLL_S)
                _read(machine, history, report)
            _read(machine, history, report)
    except KeyboardInterrupt:
        c.cancel = 1
        if report is not None:
            thread.join()
        result[:] = [len(_STATUS) - 1]
    _read(machine, history, None)
    for name in ("relaxation", "shift", "multiplier", "penalty"):
        stages, ends = machine.read_rows(name, "stage"), machine.read_rows(name, "end")
        for dual, stage, end in zip(outer.duals, stages, ends, strict=True):
            setattr(dual, name, stage.reshape(getattr(dual, name).shape))
            setattr(dual, f"end_{name}", end.reshape(getattr(dual, f"end_{name}").shape))
    outer.weight = c.weight
    which = "accepted" if _STATUS[result[0]] is not Status.NOT_FINITE else "trial"
    states, controls = [], []
    for i, phase in enumerate(machine.problem.phases):
        read = getattr(machine, which)
        states.append(read(i, "x").reshape(phase.num_stages + 1, -1).copy())
        controls.append(read(i, "u").reshape(phase.num_stages, -1).copy())
    return _STATUS[result[0]], Iterate(states, controls), history


def _read(machine: Machine, history: list[Record], report: Callable[[Record], None] | None) -> None:
    """Append the records that the solver has finished since the last call."""
    for j in range(len(history), machine.c.num_records):
        row: s.Record = machine.history[j]
        values = {name: getattr(row, name) for name, _ in s.Record._fields_}
        values["iteration"] = int(values["iteration"])
        history.append(Record(**values))
        if report is not None:
            report(history[-1])
