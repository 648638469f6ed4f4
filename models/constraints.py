"""Constraints of legged robots: friction, torques, joints, the base and the feet, for any robot model.

Each function returns an ``ocp`` constraint. Rows of feet to which it does not apply are masked. The functions that
compute rows and labels are at module level, so that two constraints of one kind share their generated code.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import casadi as cs
import numpy as np

from piaffe.errors import ProblemError
from piaffe.ocp import OverPhase, PhaseTime, ResetRows, When, caller, inequality, match_labels, over_phase

from . import natural

_PYRAMID = ("normal", "-x", "+x", "-y", "+y")
_MOST_FRICTION = 2.0  # rubber on dry stone has about 1


def friction_cone(mu: float = 0.6, *, impulses: bool = True, scale: float | None = None) -> Any:
    """Keep the force of every foot on the ground, and the impulse of every foot that lands, in the friction pyramid.

    The pyramid circumscribes the cone; pass μ/√2 for the inscribed one. Per foot, in axes of the ground where it
    stands, z along its normal (on level ground those of the world) [N]::

        F_z ≥ 0,   μ F_z − F_x ≥ 0,   μ F_z + F_x ≥ 0,   μ F_z − F_y ≥ 0,   μ F_z + F_y ≥ 0

    The impulse Λ [N s] of a foot that lands meets the same conditions at the end of the phase before. Violations are
    divided by the robot's mass times 0.1 m/s there. Feet that stand before and after an impact have no such rows, and
    models without impacts have none.

    Args:
        mu: friction coefficient μ.
        impulses: whether impulses are limited too.
        scale: what a violation of a force is divided by [N]; None: 1, or that of a very small or large robot.
    """
    _require("friction_cone", "mu", mu, lambda value: value > 0, "a positive number")
    return inequality(
        _pyramid,
        name="friction cone",
        unit="N",
        mask=_pyramid_contact,
        parameters={"mu": mu},
        positive=("mu",),
        usual={"mu": (_MOST_FRICTION, "give a coefficient, as 0.7, and neither an angle nor per cent")},
        labels=_faces,
        at_reset=_IMPULSES if impulses else None,
        scale=natural.force if scale is None else scale,
    )


def torque_limits(fraction: float | OverPhase = 1.0, *, scale: float | None = None) -> Any:
    """Keep joint torques within the robot's limits, or a fraction of them [Nm]; passive joints have no rows.

    Args:
        fraction: of the limits, a number or ``ocp.over_phase`` of a function of time.
        scale: what a violation is divided by [Nm]; None: 1, or that of a very small or large robot.
    """
    _require_fraction("torque_limits", fraction)
    return inequality(
        _torque,
        name="torque limits",
        unit="Nm",
        lower=_share(_torques, fraction, -1.0),
        upper=_share(_torques, fraction, 1.0),
        labels=_motors,
        scale=natural.torque if scale is None else scale,
    )


def joint_limits(margin: float = 0.0, *, scale: float = 1.0) -> Any:
    """Keep joint angles within the robot's limits, reduced by a margin [rad].

    Args:
        margin: distance from the limits [rad].
        scale: what a violation is divided by [rad].
    """
    _require("joint_limits", "margin", margin, lambda value: value >= 0, "a number ≥ 0 [rad]")
    return inequality(
        _angle,
        name="joint limits",
        unit="rad",
        lower=_Bound(_lowest, added=margin),
        upper=_Bound(_highest, added=-margin),
        labels=_joints,
        scale=scale,
    )


def joint_speed_limits(fraction: float | OverPhase = 1.0, *, scale: float | None = None) -> Any:
    """Keep joint speeds within the robot's limits, or a fraction of them [rad/s].

    Args:
        fraction: of the limits, a number or ``ocp.over_phase`` of a function of time.
        scale: what a violation is divided by [rad/s]; None: 1, or that of a very small or large robot.
    """
    _require_fraction("joint_speed_limits", fraction)
    return inequality(
        _speed,
        name="joint speed limits",
        unit="rad/s",
        lower=_share(_fastest, fraction, -1.0),
        upper=_share(_fastest, fraction, 1.0),
        labels=_joints,
        scale=natural.speed if scale is None else scale,
    )


def joint_range(
    joints: str,
    limit: float | None = None,
    *,
    lower: float | OverPhase | None = None,
    upper: float | OverPhase | None = None,
    scale: float = 1.0,
) -> Any:
    """Keep the angles of some joints within a given range [rad].

    Args:
        joints: a label: ``"HAA"`` for that joint of every leg, ``"FL"`` for every joint of that leg, or a joint's name.
        limit: bound of |q|, in place of ``lower`` and ``upper`` [rad].
        lower: smallest angle [rad], a number or ``ocp.over_phase`` of a function of time.
        upper: largest angle [rad], the same.
        scale: what a violation is divided by in reports [rad].
    """
    if limit is not None:
        _require("joint_range", "limit", limit, lambda value: value >= 0, "a number ≥ 0 [rad]")
        lower, upper = -limit, limit
    _require_bound("joint_range", "limit, lower or upper", lower, upper)
    return inequality(
        _SomeJoints(joints), name=f"{joints} range", unit="rad", lower=lower, upper=upper, scale=scale,
        labels=_SomeNames(joints),
    )  # fmt: skip


def base_height(
    minimum: float | OverPhase | None = None, *, maximum: float | OverPhase | None = None, scale: float | None = None
) -> Any:
    """Keep ``base.height``, the height of the base's origin above the terrain below the feet, within bounds [m].

    Args:
        minimum: smallest height [m], a number or ``ocp.over_phase`` of a function of time; None for none.
        maximum: largest height [m], the same.
        scale: what a violation is divided by in reports [m]; None: 1, or more or less for a very small or
            large robot.
    """
    _require_bound("base_height", "minimum or maximum", minimum, maximum)
    return inequality(
        _height, name="base height", unit="m", lower=minimum, upper=maximum,
        scale=natural.length if scale is None else scale, labels=_base,
    )  # fmt: skip


def foot_clearance(minimum: float | OverPhase = 0.0, *, when: When = None, scale: float | None = None) -> Any:
    """Keep feet in the air at least ``minimum`` above the terrain [m], touchdown included.

    Feet on the ground are masked, because the contact holds them there. A foot is also masked at the first node after
    liftoff (with Euler's step at the first two), because its position there depends on the stance phase alone,
    integration error included. The height of a foot is 0 at liftoff and at touchdown. A positive ``minimum`` is
    therefore feasible only in phases without liftoff and touchdown; name these phases in ``when``.

    On a terrain that is not level, a foot stays above a plane that goes from where it leaves the ground to where it
    reaches the ground. Two more rows per foot keep it ``over`` the surface below its reference, and ``beside`` the
    blocks that its reference has not yet reached, or has left.

    Args:
        minimum: smallest height above the terrain [m], a number or ``ocp.over_phase`` of a function of time.
        when: phases it applies to: a name, names, a predicate of the name, or None for all.
        scale: what a violation is divided by [m]; None: 1, or that of a very small or large robot.
    """
    return inequality(
        _foot_height,
        name="foot clearance",
        unit="m",
        lower=minimum,
        when=when,
        mask=_swing,
        labels=_kept,
        scale=natural.length if scale is None else scale,
    )


# ---- rows


@dataclass(frozen=True)
class _Bound:
    """Limits of the robot times a factor, plus a margin; unlike a lambda it can be sent to another process."""

    limits: Callable[[Any], Any]
    factor: float = 1.0
    added: float = 0.0

    def __call__(self, model: Any) -> Any:
        return self.factor * self.limits(model) + self.added


@dataclass(frozen=True)
class _BoundAt:
    """Limits of the robot times a factor and a fraction that varies over a phase."""

    limits: Callable[[Any], Any]
    fraction: OverPhase
    factor: float

    def __call__(self, at: PhaseTime) -> Any:
        return self.factor * self.fraction(at) * self.limits(at.model)


def _share(limits: Callable[[Any], Any], fraction: float | OverPhase, factor: float) -> Any:
    """Return a fraction of limits of the robot as a bound."""
    if isinstance(fraction, OverPhase):
        return over_phase(_BoundAt(limits, fraction, factor))
    return _Bound(limits, factor=factor * fraction)


@dataclass(frozen=True)
class _SomeJoints:
    """The angles of the joints that a label names; equal for equal labels, so that constraints share their code."""

    label: str

    def __call__(self, s: Any) -> Any:
        return s.joints.position[self.label]


@dataclass(frozen=True)
class _SomeNames:
    """The names of the joints that a label names; equal for equal labels."""

    label: str

    def __call__(self, model: Any) -> tuple[str, ...]:
        names: tuple[str, ...] = model.robot.joint_names
        return tuple(names[i] for i in match_labels(names, self.label, f"robot '{model.robot.name}'"))


def _pyramid(s: Any, mu: cs.SX) -> cs.SX:
    return _faces_of(s.feet.contact_force, mu)


def _faces_of(stacked: Any, mu: cs.SX) -> cs.SX:
    vectors = cs.reshape(cs.SX(stacked), 3, -1)
    x, y, z = vectors[0, :], vectors[1, :], vectors[2, :]
    return cs.vec(cs.vertcat(z, mu * z - x, mu * z + x, mu * z - y, mu * z + y))


def _impulse_pyramid(s: Any, mu: cs.SX) -> cs.SX:
    return _faces_of(s.feet.contact_impulse, mu)


def _pyramid_landing(s: Any) -> cs.SX:
    return cs.vec(cs.repmat(cs.SX(s.feet.landing).T, len(_PYRAMID), 1))


def _pyramid_contact(s: Any) -> cs.SX:
    return cs.vec(cs.repmat(cs.SX(s.feet.contact).T, len(_PYRAMID), 1))


def _torque(s: Any) -> Any:
    return s.joints.torque


def _angle(s: Any) -> Any:
    return s.joints.position


def _speed(s: Any) -> Any:
    return s.joints.velocity


def _height(s: Any) -> Any:
    return s.base.height


def _foot_height(s: Any) -> Any:
    return s.feet.clearance


def _swing(s: Any) -> Any:
    in_air = (1 - s.feet.contact) * (1 - s.feet.lifting)
    kept = cs.SX(s.feet.clearance).numel() // max(cs.SX(s.feet.contact).numel(), 1)
    return in_air if kept == 1 else cs.repmat(cs.SX(in_air), kept, 1)


def _joints(model: Any) -> tuple[str, ...]:
    names: tuple[str, ...] = model.robot.joint_names
    return names


def _motors(model: Any) -> tuple[str, ...]:
    names: tuple[str, ...] = model.robot.motor_names
    return names


def _torques(model: Any) -> Any:
    return model.robot.torque_limit[list(model.robot.motors)]


def _lowest(model: Any) -> Any:
    return model.robot.joint_lower


def _highest(model: Any) -> Any:
    return model.robot.joint_upper


def _fastest(model: Any) -> Any:
    return model.robot.joint_speed_limit


def _faces(model: Any) -> tuple[str, ...]:
    return tuple(f"{foot.name} {face}" for foot in model.robot.feet for face in _PYRAMID)


def _impulse_faces(model: Any) -> tuple[str, ...]:
    return tuple(f"impulse {face}" for face in _faces(model))


def _feet(model: Any) -> tuple[str, ...]:
    names: tuple[str, ...] = model.robot.foot_names
    return names


def _kept(model: Any) -> tuple[str, ...]:
    names = _feet(model)
    if not model.slots_of_ground:
        return names
    return (*names, *(f"{name} over" for name in names), *(f"{name} beside" for name in names))


def _base(model: Any) -> tuple[str, ...]:
    return ("base z",)


def _require(where: str, what: str, got: Any, holds: Callable[[float], bool], expected: str) -> None:
    if not isinstance(got, int | float | np.number) or isinstance(got, bool) or not holds(float(got)):
        raise ProblemError(
            f"{where} ({caller()}): {what} is out of range - got {got!r}, expected {expected}; change it"
        )


def _require_fraction(where: str, fraction: float | OverPhase) -> None:
    if not isinstance(fraction, OverPhase):
        _require(where, "fraction", fraction, lambda value: value > 0, "a positive number")


def _require_bound(where: str, what: str, lower: object, upper: object) -> None:
    if lower is None and upper is None:
        raise ProblemError(f"{where} ({caller()}): no bound - got none, expected {what}; give one")


_IMPULSES = ResetRows(
    function=_impulse_pyramid, mask=_pyramid_landing, unit="N s", scale=natural.impulse, labels=_impulse_faces
)
"""The friction pyramid of impulses; one object, so that two constraints share their code."""
