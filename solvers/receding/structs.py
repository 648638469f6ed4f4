"""The C structures of ``template/receding.h``, for ctypes."""

from __future__ import annotations

import ctypes as ct
from typing import Any

from ..ilqr import OptionsStruct

_P = ct.c_void_p


def fields(*parts: tuple[Any, str]) -> list[tuple[str, Any]]:
    """Return fields from pairs of a type and names that are separated by blanks."""
    return [(name, kind) for kind, names in parts for name in names.split()]


class Copies(ct.Structure):
    """See the header."""

    _fields_ = fields((ct.c_int, "count"), (_P, "to of"))


class Store(ct.Structure):
    """See the header."""

    _fields_ = fields((_P, "rows copies weights end_weights fall"), (ct.c_int, "time_step"))


class Segment(ct.Structure):
    """See the header."""

    _fields_ = [
        *fields((ct.c_int, "step half window cut space rows"), (ct.c_double, "dt")),
        *fields((_P, "first mode stage end link controls")),
        ("state", Copies), ("acting", Copies),
    ]  # fmt: skip


class Space(ct.Structure):
    """See the header."""

    _fields_ = fields((_P, "state control"), (ct.c_int, "nx nu"))


class Entry(ct.Structure):
    """See the header."""

    _fields_ = fields((ct.c_int, "piece length following"), (ct.c_long, "start"), (ct.c_double, "lands_at"))


class Piece(ct.Structure):
    """See the header."""

    _fields_ = fields(
        (_P, "start begin advance move sample pose pick"),
        (ct.c_int, "num_memory num_sample num_schedule num_start num_commands first_entry"),
        (ct.c_long, "first_tick"),
        (_P, "places schedules begins command"),
        (ct.c_double * 3, "first last turn"),
    )


class HorizonTables(ct.Structure):
    """``Horizon`` of the header."""

    _fields_ = fields(
        (ct.c_double, "tick"),
        (ct.c_long, "total period"),
        (ct.c_int, "num_entries cycle num_pieces num_segments num_targets num_modes num_transitions"),
        (_P, "entries segments pieces spaces samples frames initial modes transitions mode_tables transition_tables"),
        (_P, "moved_sample pose placed solve policy adapt"),
        (ct.c_int, "lean follows num_lanes num_work"),
        (_P, "clock followed"),
    )


class Place(ct.Structure):
    """See the header."""

    _fields_ = fields((ct.c_int, "entry"), (ct.c_long, "number start"))


class Span(ct.Structure):
    """See the header."""

    _fields_ = [*fields((ct.c_int, "segment stages ends last")), ("place", Place), ("first", ct.c_long)]


class Node(ct.Structure):
    """See the header."""

    _fields_ = [("place", Place), *fields((ct.c_long, "tick"), (ct.c_int, "row"))]


class Course(ct.Structure):
    """See the header."""

    _fields_ = [
        ("tick", ct.c_long), ("place", Place), *fields((ct.c_double * 3, "anchor moved frame"), (_P, "memory"))
    ]  # fmt: skip


class Clock(ct.Structure):
    """See the header."""

    _fields_ = fields((ct.c_double, "limit gain"), (ct.c_long, "shift base flight"), (ct.c_double, "late"))


class Plan(ct.Structure):
    """See the header."""

    _fields_ = fields((_P, "header numbers phases view"))


class Arena(ct.Structure):
    """See the header."""

    _fields_ = fields((_P, "base"), (ct.c_size_t, "used"))


class Receding(ct.Structure):
    """See the header."""

    _fields_ = [
        ("horizon", _P), ("course", Course), *fields((ct.c_int, "has_plan began")), ("last", Plan),
        ("options", OptionsStruct), ("latency", ct.c_double), ("clock", Clock),
        *fields((ct.c_int, "first_iterations iterations"), (ct.c_double, "adapt_below last_equality")),
        ("arena", Arena),
        *fields((_P, "problem spans nodes firsts"), (ct.c_int, "num_nodes")),
        *fields((_P, "samples frames memories nows"), (ct.c_int, "most_memory")),
        *fields((_P, "single rows x lanes work")),
    ]  # fmt: skip


class Motion(ct.Structure):
    """See ``motions.h``."""

    _fields_ = fields((_P, "planner"), (ct.c_int, "after"), (_P, "entries"))


class Motions(ct.Structure):
    """See ``motions.h``."""

    _fields_ = [
        *fields((_P, "motions"), (ct.c_int, "num preparations"), (ct.c_double, "period"), (_P, "wanted")),
        ("ahead", Plan),
        *fields(
            (ct.c_double, "seen"), (ct.c_int, "active home request next entry made left"), (ct.c_double, "until")
        ),
    ]  # fmt: skip
