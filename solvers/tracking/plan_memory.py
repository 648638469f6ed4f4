"""A plan in memory, as the low level in C reads it: ``struct plan`` of ``template/plan.h``."""

from __future__ import annotations

import ctypes as ct
from collections.abc import Sequence
from functools import lru_cache
from importlib.resources import files
from struct import Struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piaffe.errors import ShapeError
from piaffe.ocp import ORIGIN, LoweredMode, PlanarFrame

from .plan import PlanPhase

Array = NDArray[np.float64]

_ARRAYS = ("times", "states", "controls", "feedback", "Q_u", "Q_ux", "Q_uu", "p", "g_mask", "h_mask")
_PHASE = Struct(f"@2i{len(_ARRAYS)}P")
PHASE_BYTES = _PHASE.size
"""Size of ``struct plan_phase``."""
PLAN_HEADER = files(__package__).joinpath("template", "plan.h").read_text(encoding="utf-8")
"""The text of ``plan.h``, for other C that makes or reads plans."""
_DOUBLE = np.dtype(np.float64)
_first: Any = ct.c_char.from_buffer


class PlanStruct(ct.Structure):
    """See the header."""

    _fields_ = [("num_phases", ct.c_int), ("phases", ct.c_void_p), ("anchor", ct.c_double * 3)]


class PlanMemory:
    """A plan as ``struct plan`` of ``plan.h``; it refers to the arrays of the phases and grows only.

    Args:
        modes: the modes, in the order of their numbers.
    """

    def __init__(self, modes: Sequence[LoweredMode]) -> None:
        self._numbers = {mode: i for i, mode in enumerate(modes)}
        self._plan, self._phases = PlanStruct(), bytearray(0)
        self._room: Any = None
        self._kept_alive: tuple[Any, ...] = ()
        self.address = ct.addressof(self._plan)

    def hold(self, phases: Sequence[PlanPhase], anchor: PlanarFrame = ORIGIN) -> None:
        """Refer to the arrays of some phases; arrays of another type or order are copied.

        Args:
            phases: the phases.
            anchor: the frame of their states in the world (x, y, yaw).

        Raises:
            ShapeError: an array has another size than its mode's.
        """
        copies: list[Array] = []
        records = [self._record(phase, copies) for phase in phases]  # before anything is written, for the error
        if len(phases) * _PHASE.size > len(self._phases):
            self._room = None
            self._phases = bytearray(2 * len(phases) * _PHASE.size)
            self._room = _first(self._phases)
            self._plan.phases = ct.addressof(self._room)
        for i, record in enumerate(records):
            _PHASE.pack_into(self._phases, i * _PHASE.size, *record)
        self._plan.num_phases, self._plan.anchor[:] = len(phases), anchor
        self._kept_alive = (phases, copies)

    def _record(self, phase: PlanPhase, copies: list[Array], double: Any = _DOUBLE) -> list[int]:
        """Return the numbers of a ``struct plan_phase``; this is fast, since plans come 50 times a second."""
        arrays = (
            phase.times, phase.states, phase.controls, phase.feedback, phase.Q_u, phase.Q_ux, phase.Q_uu, phase.p,
            phase.g_mask, phase.h_mask,
        )  # fmt: skip
        mode, n = phase.mode, len(phase.controls)
        if tuple([array.size for array in arrays]) != _sizes(mode, n):
            raise _wrong_size(mode, n, arrays)
        address, first = ct.addressof, _first
        return [
            self._numbers[mode], n,
            *[
                address(first(array)) if array.flags.carray and array.dtype is double and array.size
                else _other(array, copies) for array in arrays
            ],
        ]  # fmt: skip


def _other(array: Array, copies: list[Array]) -> int:
    """Return the address of an array that is empty or read-only, or of its copy; copies are kept."""
    if not array.size:
        return 0
    copies.append(np.ascontiguousarray(array, dtype=float))
    return int(copies[-1].ctypes.data)


@lru_cache(maxsize=1024)
def _sizes(mode: LoweredMode, n: int) -> tuple[int, ...]:
    """Return the numbers of entries of the arrays of a phase with n stages."""
    nx, ndx, nu = mode.state.nx, mode.state.ndx, mode.nu
    rows = len(mode.rows["stage_g"]), len(mode.rows["stage_h"])
    stage = (nu, nu * ndx, nu, nu * ndx, nu * nu, mode.layout.size, *rows)
    return (n + 1, (n + 1) * nx, *[n * size for size in stage])


def _wrong_size(mode: LoweredMode, n: int, arrays: Sequence[Array]) -> ShapeError:
    name, got, expected = next(
        (name, array.size, size)
        for name, array, size in zip(_ARRAYS, arrays, _sizes(mode, n), strict=True)
        if array.size != size
    )
    return ShapeError(
        f"plan, phase of model '{mode.model.name}', {name}: wrong size - got {got} numbers, expected {expected} for "
        f"{n} stages; see PlanPhase"
    )
