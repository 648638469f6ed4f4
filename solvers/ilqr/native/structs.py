"""The C structures of ``template/piaffe.h``, for ctypes."""

from __future__ import annotations

import ctypes as ct
from dataclasses import dataclass
from typing import Any

from ... import constants

Doubles = ct.c_void_p  # an address: pointers with a type take ten times longer to make

_NUMBERS = [
    "max_defect", "max_equality", "max_inequality", "cost_tolerance", "barrier_weight", "barrier_factor", "barrier_gap",
    "min_barrier_weight", "relaxation", "stiffness", "max_stiffness", "penalty", "penalty_factor", "max_penalty",
    "armijo", "merit_margin", "merit_offset", "step_shrink", "min_step", "regularization", "max_regularization",
    "cost_scale", "cost_floor", "time_scale", "time_limit_s",
]  # fmt: skip
_COUNTS = ["max_iterations", "max_inner", "corrections", "adapt"]
OPTIONS = _NUMBERS + _COUNTS
RECORD = [
    "iteration", "cost", "merit", "expected", "max_defect", "max_equality", "max_inequality", "step_size",
    "regularization", "barrier_weight", "wall_s",
]  # fmt: skip
_OF_PHASE = [
    "x", "u", "xt", "ut", "x_outside", "u_outside", "x_next", "start", "d", "dt_trial", "D", "finish", "grad", "H",
    "end_grad", "end_H", "P", "dx", "du", "k", "K", "V_x", "V_first", "V_last", "V_xx", "Q_x", "Q_u", "Q_xx", "Q_ux",
    "Q_uu",
]  # fmt: skip
_OF_BLOCK = [
    "p", "weight", "g_mask", "h_mask", "z", "residual", "g", "h", "z0", "residual0", "g0", "h0", "factors",
    "factors0", "relaxation", "shift", "multiplier", "penalty", "work",
]  # fmt: skip
OF_SOLVE = [
    "share", "weight", "rho", "least_rho", "regularization_now", "cost", "gap", "max_defect", "max_equality",
    "max_inequality", "last_equality", "last_cost", "last_violation", "last_inequality", "stiffness", "last_step",
    "resume_merit", "resume_cost", "began",
]  # fmt: skip
COUNTERS = ["resume_converged", "inner", "unmoved", "has_last_cost", "has_inequalities", "num_gains", "blocked"]


class OptionsStruct(ct.Structure):
    """Options, in the order of the header."""

    _fields_ = [*((name, ct.c_double) for name in _NUMBERS), *((name, ct.c_int) for name in _COUNTS)]


class RecordStruct(ct.Structure):
    """One iteration."""

    _fields_ = [(name, ct.c_double) for name in RECORD]


class Phase(ct.Structure):
    """One phase."""


Phase._fields_ = [
    ("mode", ct.c_void_p),
    ("N", ct.c_int),
    ("dt", ct.c_double),
    *((name, Doubles) for name in _OF_PHASE),
    ("work", Doubles),
    ("shooting", ct.c_void_p),
    ("keep", ct.c_int),
    ("next", ct.POINTER(Phase)),
]


class ModeSizes(ct.Structure):
    """The sizes at the beginning of a mode's table."""

    _fields_ = [(name, ct.c_int) for name in ("nx", "ndx", "nu", "nz", "nf", "num_finish", "num_work")]


class TransitionSizes(ct.Structure):
    """The sizes at the beginning of a transition's table."""

    _fields_ = [(name, ct.c_int) for name in ("nx", "ndx", "nx_next", "ndx_next", "nz", "nf", "num_work")]


@dataclass(frozen=True)
class Structs:
    """Structures whose layout depends on the number of doubles per vector."""

    Block: Any
    Group: Any
    Problem: Any


def structs_of(width: int) -> Structs:
    """Return the structures for a number of doubles per vector."""

    class Block(ct.Structure):
        _fields_ = [
            ("count", ct.c_int),
            ("phase", ct.c_int * width),
            ("index", ct.c_int * width),
            ("dt", ct.c_double * width),
            *((name, Doubles) for name in _OF_BLOCK),
        ]

    class Group(ct.Structure):
        _fields_ = [
            ("mode", ct.c_void_p),
            ("transition", ct.c_void_p),
            ("num_blocks", ct.c_int),
            ("num_ends", ct.c_int),
            ("blocks", ct.POINTER(Block)),
            ("ends", ct.POINTER(Block)),
        ]

    class Problem(ct.Structure):
        _fields_ = [
            ("num_phases", ct.c_int),
            ("num_groups", ct.c_int),
            ("num_transitions", ct.c_int),
            ("phases", ct.POINTER(Phase)),
            ("groups", ct.POINTER(Group)),
            ("transitions", ct.POINTER(Group)),
            ("initial", Doubles),
            ("options", OptionsStruct),
            ("history", ct.POINTER(RecordStruct)),
            ("num_records", ct.c_int),
            ("cancel", ct.c_int),
            ("cleared", ct.c_int),
            ("slope", Doubles),
            ("curvature", Doubles),
            *((name, ct.c_double) for name in OF_SOLVE),
            *((name, ct.c_int) for name in COUNTERS),
            ("clock", ct.c_void_p),
            ("clock_data", ct.c_void_p),
            ("gains", ct.c_double * constants.PATIENCE),
        ]

    return Structs(Block, Group, Problem)
