"""The parts of a loop: what runs in one, and what is known of the plan that acts."""

from __future__ import annotations

from typing import NamedTuple

from piaffe.errors import SolverError

from ..solution import Status
from ..tracking import LowLevel
from ..tracking import NativeTick as LowTick
from .native_tick import NativeTick


class ActingPlan(NamedTuple):
    """What is known of the plan that acts.

    Attributes:
        measured_at: time of its state [s].
        seconds: time of the processor that it took [s].
        iterations: of its solve.
        status: why its solve ended.
        motion: the motion that it plans, of several; empty for a planner of one.
        request: the motion that is asked for, and has not begun; empty for none.
    """

    measured_at: float
    seconds: float
    iterations: int
    status: Status
    motion: str = ""
    request: str = ""


def checked_parts(
    planner: NativeTick | None, low: LowLevel, period: float, latency: float, *, thread: bool
) -> tuple[NativeTick, LowTick]:
    """Return the ticks of a planner and of a low level that run in a loop.

    Raises:
        SolverError: one is not compiled, the low level is for other plans, or a thread would have no time for plans.
    """
    tick: LowTick | None = getattr(low, "compiled", None)  # a low level of the user may have none
    if planner is None or tick is None:
        what, got = ("receding horizon", "numpy") if planner is None else ("low level", type(low).__name__)
        raise SolverError(
            f"loop: the {what} is not compiled - got {got}, expected both with backend='native', and "
            "qp='own' for Vwbc; call plan(x, t), follow(plan) and control(x, t) one by one"
        )
    if tick.modes != planner.modes:
        raise SolverError(
            "loop: the low level is for other plans - got one with other modes, expected those of this receding "
            f"horizon; make it with {type(low).__name__}(mpc.plan(mpc.initial, 0.0))"
        )
    if thread and latency == 0:
        raise SolverError(
            f"loop: a plan in a thread needs time - got a latency of 0 s, expected up to the period, {period:g} s; "
            "give RecedingHorizon the latency, or thread=False"
        )
    return planner, tick
