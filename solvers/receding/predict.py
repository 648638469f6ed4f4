"""The state at the time when a plan will be ready, from the last plan's policy and the model's steps."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from piaffe.ocp import SAME_TIME, TIME_STEP, LoweredTransition, Vectorised, solve_implicit

from .plan import Plan

Array = NDArray[np.float64]


def predicted(plan: Plan, x: Array, t: float, until: float) -> Array:
    """Return the state at a later time under the policy of a plan, (nx,), in the plan's frame.

    The model of the plan makes steps of its own length, the first and the last one shorter if need be. At the end of a
    phase the plan's transition applies, an impact included. Beyond the plan's nodes, the state is held.

    Args:
        plan: the last plan.
        x: measured state in its frame (nx,).
        t: its time [s].
        until: the time to predict [s].
    """
    state = np.array(x, dtype=float)
    while t < until - SAME_TIME:
        i = max((i for i, part in enumerate(plan.parts) if part.times[0] <= t + SAME_TIME), default=0)
        part = plan.parts[i]
        if part.mode.state is not plan.parts[0].mode.state or t >= part.times[-1] - SAME_TIME:
            break
        k = max(int(np.searchsorted(part.times, t + SAME_TIME, side="right")) - 1, 0)
        end = min(until, float(part.times[k + 1]))
        space, mode, p = part.mode.state, part.mode, part.p[k].copy()
        p[mode.layout.slices[TIME_STEP]] = end - t
        share = (t - part.times[k]) / (part.times[k + 1] - part.times[k])
        nominal = space.np_plus(part.states[k], share * space.np_minus(part.states[k + 1], part.states[k]))
        u = part.controls[k] + part.feedback[k] @ space.np_minus(state, nominal)
        z = solve_implicit(*Vectorised(mode.functions["implicit"])(state[None], u[None], p[None]))
        state = space.np_normalise(Vectorised(mode.functions["stage"])(state[None], u[None], z, p[None])[0][0])
        t = end
        following = plan.parts[i + 1] if i + 1 < len(plan.parts) else None
        if t < part.times[-1] - SAME_TIME or not part.resets or following is None or part.transition is None:
            continue
        if following.mode.state is space:
            state = space.np_normalise(after_reset(part.transition, part.p_transition, state))
    return state


def after_reset(transition: LoweredTransition, p: Array, x: Array) -> Array:
    """Return the state after a transition, (nx of the next,)."""
    z = solve_implicit(*Vectorised(transition.functions["implicit"])(x[None], p[None]))
    return np.asarray(Vectorised(transition.functions["reset"])(x[None], z, p[None])[0][0])
