"""Small problems of balls on rods, for tests of horizons: cheap to compile, with modes, resets and phases at will."""

from __future__ import annotations

from collections.abc import Hashable
from typing import Any

import numpy as np

from piaffe import ocp


def ball(name: str = "ball", *, cut: bool = True) -> ocp.Model:
    """Return a ball on a rod that a thrust moves, in strong or weak gravity; without ``cut``, modes share a phase."""

    def mode(gravity: float) -> Any:
        return lambda s: {"z": s.vz, "vz": s.thrust - gravity}

    made = ocp.Model(
        name, state={"z": 1, "vz": 1}, control={"thrust": 1}, modes={"fall": mode(9.81), "slow": mode(5.0)}
    )
    if not cut:
        object.__setattr__(made, "cut_by_modes", False)
    return made


def phase(name: str, duration: float, z: float = 1.0, mode: Hashable = "fall", **more: Any) -> ocp.Phase:
    """Return a phase with a height as its target."""
    return ocp.Phase(name, mode, duration, target={"z": z}, **more)


def problem(motion: ocp.Motion, schedule: ocp.Schedule, *extra: Any) -> ocp.Problem:
    """Return a problem of balls: heights, a small thrust, and limits of the thrust."""
    objective = ocp.Objective(
        ocp.track("z", weight=10.0), ocp.regularize("thrust", weight=0.1),
        ocp.track("z", weight=5.0, at="phase_end"), *extra,
    )  # fmt: skip
    limits = ocp.Constraints(ocp.inequality(_thrust, lower=-5.0, upper=25.0, name="thrust"))
    return ocp.Problem(motion, schedule, objective, limits, initial=np.array([1.0, 0.0]))


def _thrust(s: Any) -> Any:
    return s.thrust
