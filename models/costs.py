"""Costs of legged robots, for any robot model; they are terms of an objective."""

from __future__ import annotations

from typing import Any

import casadi as cs

from piaffe.ocp import Cost, residual


def soft_landing(weight: Any = 1.0) -> Cost:
    """Return a cost on the vertical speed of every foot that lands, at the end of the phase before: ½ Σ wᵢ żᵢ².

    It is for receding horizons, in which a landing is often at the end of what the plan sees.

    Args:
        weight: weight w [s²/m²], a number or one per foot, in the robot's order of feet.
    """
    rows = residual(unit="m/s", mask=_landing)(_vertical_speed)
    return rows.weighted(weight, at="phase_end", name="soft landing")


def _vertical_speed(s: Any) -> cs.SX:
    return cs.reshape(cs.SX(s.feet.velocity), 3, -1)[2, :].T


def _landing(s: Any) -> Any:
    return s.feet.landing
