"""Losses of the joints: viscous damping and dry friction, as torques of a time step that are affine in acceleration."""

from __future__ import annotations

from collections.abc import Mapping

import casadi as cs

FRICTION_SPEED = 0.3
"""Speed v₀ at which dry friction has 71 % of its full torque, by default [rad/s]."""

_TINY = 1e-9  # [kg m²], avoids 0/0 of joints without rotor inertia and friction


def loss_torque(v: cs.SX, a: cs.SX, dt: cs.SX, p: Mapping[str, cs.SX], inertia: float = 1.0) -> cs.SX:
    """Return the torque of damping and dry friction against the motion of the joints, (n, 1) [Nm].

    With the change of velocity in half a step, δ = ½ a dt, damping d and the smoothed friction f of the torque f₀::

        τ = d (v + δ) + f(v) + β δ,   f(v) = f₀ v / s,   s = √(v² + v₀²)

    Damping acts at the mean velocity of the step. Friction is linearised at v: β = f′ = f₀ v₀² / s³ would be of second
    order, but passes through zero in steps with f dt > 2 v I of a joint's inertia I, and then does not come to rest.
    The slope of the secant, c = f₀ / s, never does, but is of first order. β lies between the two::

        β = f′ + (c − f′) c dt / (c dt + 2 I)

    With the rotor inertia as I, which is not larger than the joint's, a step does not make a joint faster that nothing
    else moves. β − f′ is proportional to dt, so the error of a step is that of second order. With dt = 0 the torque is
    d v + f(v).

    Args:
        v: joint velocities at the start of the step, (n, 1) [rad/s].
        a: joint accelerations of the step, (n, 1) [rad/s²].
        dt: time step [s].
        p: the slots ``joint_damping`` [Nm s/rad], ``joint_friction`` [Nm], ``armature`` [kg m²], ``friction_speed``.
        inertia: natural size of an inertia [kg m²]; a billionth of it counts as zero.
    """
    tiny = _TINY * inertia
    half, per_speed = 0.5 * dt, 1 / cs.sqrt(v * v + p["friction_speed"] ** 2)
    secant = p["joint_friction"] * per_speed
    bend = secant * (v * per_speed) ** 2  # c − f′
    held = half * secant
    slope = secant - bend * (p["armature"] + tiny) / (held + p["armature"] + tiny)
    loss: cs.SX = (p["joint_damping"] + secant) * v + (p["joint_damping"] + slope) * (half * a)
    return loss
