"""The memory of a loop in C, ``struct loop`` of ``template/loop.h``, and the library that works on it."""

from __future__ import annotations

import ctypes as ct
from functools import lru_cache
from importlib.resources import files
from typing import Any

import numpy as np

from piaffe.codegen import SOLVER_FLAGS, build, load

from ..ilqr import constants_header
from ..tracking import PLAN_HEADER
from ..tracking import NativeTick as LowTick
from .keeper import Keeper
from .native_tick import NativeTick
from .plan import Plan
from .structs import fields

PLACES = 4
_HEADERS = ("handover.h", "loop.h", "thread.inc", "priority.inc")
_P = ct.c_void_p


class _Handover(ct.Structure):
    _fields_ = fields((ct.c_uint, "middle back acting next"))


class LoopStruct(ct.Structure):
    """See the header."""

    _fields_ = [
        *fields((_P, "make tick planner low followed")), ("memories", _P * PLACES), ("views", _P * PLACES),
        *fields(
            (ct.c_double, "period latency"), (ct.c_int, "num_state num_commands"),
            (_P, "commands told asked_state asked_commands"), (ct.c_double, "asked_at"),
        ),
        ("measured_at", ct.c_double * PLACES), ("seconds", ct.c_double * PLACES), ("plans", _Handover),
        *fields(
            (ct.c_int, "work failed unusable"), (_P, "thread"), (ct.c_uint, "newest"),
            (ct.c_double, "now next due within"), (ct.c_int, "fault ready waits open skipped"),
            (ct.c_long, "asked missed taken"),
        ),
    ]  # fmt: skip


class LoopMemory(Keeper):
    """The memory of a loop.

    Args:
        planner: makes the plans. low: the tick.
        period: between plans [s].
        latency: of plans [s].
    """

    def __init__(self, planner: NativeTick, low: LowTick, period: float, latency: float) -> None:
        super().__init__()
        self.planner, self.low, self.library = planner, low, loop_library()
        commands, (make, address) = planner.commands, planner.maker
        self.places = tuple(planner.plan_memory() for _ in range(PLACES))
        self.told = self.keep(np.zeros(len(commands)))
        """The commands of the next plan, which the caller sets."""
        nx = planner.horizon.models[0].state.nx
        self.c = LoopStruct(
            make=ct.cast(make, _P), tick=low.function, planner=address,
            low=low.address, followed=low.followed, period=period, latency=latency, num_state=nx,
            num_commands=len(commands), commands=commands.ctypes.data, told=self.told.ctypes.data,
            asked_state=self.zeros(nx), asked_commands=self.zeros(len(commands)),
        )  # fmt: skip
        self.c.memories[:] = [ct.addressof(place.c) for place in self.places]
        self.c.views[:] = [place.address for place in self.places]
        self.address = ct.addressof(self.c)
        self._x = np.zeros(nx)

    def begin(self, x: Any, t: float) -> None:
        """Make a plan now."""
        self._x[:] = x
        self.library.loop_begin(self.address, self._x.ctypes.data, t)

    def wait_with(self, plan: Plan) -> None:
        """Let a plan of the planner wait for its start."""
        place = int(self.c.plans.next)
        self.planner.copy_into(self.places[place], plan)
        self.c.measured_at[place], self.c.seconds[place], self.c.waits = plan.measured_at, 0.0, 1

    def take_fault(self) -> int:
        """Return the code of what went wrong since the last call, 0 for nothing."""
        code = int(self.c.fault)
        if code:
            self.c.fault = 0
        return code


@lru_cache(maxsize=2)
def loop_library(threads: bool = True) -> ct.CDLL:
    """Return the library of loops, which is the same for all problems.

    Args:
        threads: whether it may start threads.
    """
    template = files(__package__).joinpath("template")
    headers = {name: template.joinpath(name).read_text(encoding="utf-8") for name in _HEADERS}
    headers |= {"plan.h": PLAN_HEADER, "constants.h": constants_header()}
    text = template.joinpath("loop.c").read_text(encoding="utf-8")
    flags = (*SOLVER_FLAGS, *(() if threads else ("-DPIAFFE_NO_THREADS",)))
    built = build([("loop", text)], headers=headers, flags=flags, link=("-lm", "-pthread"), width=1, label="loop")
    library = load(built)
    library.loop_init.argtypes = (_P, ct.c_int, ct.c_double)
    library.loop_begin.argtypes = (_P, _P, ct.c_double)
    library.loop_tick.argtypes = (_P, _P, ct.c_double, _P, _P)
    library.loop_start.argtypes = library.loop_stop.argtypes = (_P,)
    for function in (library.loop_init, library.loop_begin, library.loop_tick, library.loop_stop):
        function.restype = None
    return library
