"""Time steps of a floating base with joints: from position q, velocity v and the next velocity to the next state."""

from __future__ import annotations

from typing import Literal, get_args

import casadi as cs

from piaffe.errors import ModelError
from piaffe.ocp import rotation

Integrator = Literal["euler", "semi_implicit", "midpoint"]
INTEGRATORS: tuple[Integrator, ...] = get_args(Integrator)


def checked_integrator(name: object, allowed: tuple[Integrator, ...], where: str) -> Integrator:
    """Return an integrator's name; raise ModelError if it is not one of ``allowed``."""
    for known in allowed:
        if name == known:
            return known
    listed = ", ".join(f"'{known}'" for known in allowed[:-1]) + f" or '{allowed[-1]}'"
    raise ModelError(f"{where}: unknown integrator - got {name!r}, expected {listed}; choose one")


def integrate(q: cs.SX, v: cs.SX, dt: cs.SX) -> cs.SX:
    """Return q ⊕ v dt of a floating base and joints, or of joints alone, (nq, 1); v in the state's layout."""
    if q.numel() == v.numel():
        return q + v * dt
    turned = rotation.multiply(q[3:7], rotation.exp(v[3:6] * dt))
    return cs.vertcat(q[:3] + v[:3] * dt, turned, q[7:] + v[6:] * dt)


def begun(integrator: Integrator, x: cs.SX, nv: int, dt: cs.SX) -> cs.SX:
    """Return the state m at which a step evaluates the dynamics: with midpoint (q ⊕ ½ v dt, v), else the state x."""
    q, v = x[:-nv], x[-nv:]
    return cs.vertcat(integrate(q, v, dt / 2), v) if integrator == "midpoint" else x


def finished(integrator: Integrator, w: cs.SX, nv: int, dt: cs.SX) -> cs.SX:
    """Return the next state from w = (m's position, new velocity v⁺): v⁺ moves the position.

    It does so for half of the step with midpoint, for all of it with semi-implicit Euler.
    """
    q, v_next = w[:-nv], w[-nv:]
    return cs.vertcat(integrate(q, v_next, dt / 2 if integrator == "midpoint" else dt), v_next)


def feet_follow_stance(integrator: Integrator) -> int:
    """Return at how many nodes after its liftoff a foot's position depends on the stance alone.

    At the first node it is where the stance left it. A step of Euler moves it by the last velocity of the stance, so
    the second node depends on the stance, too; the other integrators use the swing's first velocity.
    """
    return 2 if integrator == "euler" else 1
