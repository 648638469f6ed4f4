"""Costs of legged robots, for any robot model; they are terms of an objective."""

from __future__ import annotations

from typing import Any

from piaffe.ocp import Cost, residual


def soft_landing(weight: Any = 1.0) -> Cost:
    """Return a cost on the normal speed of every foot that lands, at the end of the phase before: ½ Σ wᵢ vᵢ².

    The normal speed v is that along the normal of the ground where the foot lands.

    It is for receding horizons, in which a landing is often at the end of what the plan sees.

    Args:
        weight: weight w [s²/m²], a number or one per foot, in the robot's order of feet.
    """
    rows = residual(unit="m/s", mask=_landing)(_normal_speed)
    return rows.weighted(weight, at="phase_end", name="soft landing")


def _normal_speed(s: Any) -> Any:
    return s.feet.normal_speed


def _landing(s: Any) -> Any:
    return s.feet.landing
