"""One rigid body that stands for a robot: its numbers, and how forces change its velocity in a step."""

from __future__ import annotations

from collections.abc import Mapping

import casadi as cs
import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from piaffe.errors import ModelError
from piaffe.ocp import rotation

from .robot import Robot

Array = NDArray[np.float64]


def body_numbers(robot: Robot, mass: float | None, inertia: ArrayLike | None) -> dict[str, object]:
    """Return the slots ``mass``, ``inertia`` and ``gravity`` of a model with one body.

    Args:
        robot: the robot.
        mass: m [kg]; None for the mass of all links.
        inertia: in body axes, (3, 3) or its xx, yy, zz, xy, xz, yz [kg m²]; None for that of the standing robot about
            its centre of mass.

    Raises:
        ModelError: a number is not that of a rigid body.
    """
    if mass is not None and not (isinstance(mass, int | float | np.floating) and 0 < mass < np.inf):
        raise ModelError(
            f"rigid body of '{robot.name}': mass is out of range - got {mass!r}, expected a positive number [kg]; "
            "give one"
        )
    return {
        "mass": robot.mass if mass is None else mass,
        "inertia": _six(robot, _standing_inertia(robot) if inertia is None else inertia),
        "gravity": robot.model.gravity.linear,
    }


def refused_inertia(six: Array) -> str:
    """Return what is expected of an inertia as a parameter; empty if it is usable."""
    return "" if np.all(_principal(six) > 0) else "an inertia with positive principal values [kg m^2]"


def tensor_of(six: cs.SX) -> cs.SX:
    """Return the tensor, (3, 3), of xx, yy, zz, xy, xz, yz."""
    xx, yy, zz, xy, xz, yz = cs.vertsplit(six)
    return cs.vertcat(cs.horzcat(xx, xy, xz), cs.horzcat(xy, yy, yz), cs.horzcat(xz, yz, zz))


def next_velocity(
    orientation: cs.SX, v: cs.SX, force: cs.SX, torque: cs.SX, dt: cs.SX, p: Mapping[str, cs.SX], *, mean: bool
) -> cs.SX:
    """Return the velocity of a body after a step, world linear and body angular, (6, 1).

    The equations are those of :class:`~piaffe.models.SingleRigidBody`.

    Args:
        orientation: quaternion at which the torque acts, w first, (4, 1).
        v: velocity before the step, (6, 1).
        force: world force [N].
        torque: world torque about the body's centre of mass [Nm].
        dt: time step [s].
        p: ``mass``, ``inertia`` and ``gravity``.
        mean: whether ω × I ω is the mean of ω × I ω⁺ and ω⁺ × I ω, with ω⁺ = ω + ω̇ dt.
    """
    omega, tensor = v[3:], tensor_of(p["inertia"])
    inertia, momentum = tensor, tensor @ omega
    if mean:
        inertia = tensor + dt / 2 * (cs.skew(omega) @ tensor - cs.skew(momentum))
    spin = _inverse(inertia) @ (rotation.matrix(orientation).T @ torque - cs.cross(omega, momentum))
    return v + cs.vertcat(force / p["mass"] + p["gravity"], spin) * dt


def spin_momentum(orientation: cs.SX, omega: cs.SX, p: Mapping[str, cs.SX]) -> cs.SX:
    """Return the angular momentum about the centre of mass in world axes, (3, 1) [kg m²/s]."""
    return rotation.matrix(orientation) @ tensor_of(p["inertia"]) @ omega


def moment_maps(arms: Array) -> Array:
    """Return the maps of contact forces to force and moment on a body, (N, 6, 3 nf).

    Args:
        arms: the feet relative to its centre of mass, world axes, (N, nf, 3) [m].
    """
    maps = np.zeros((len(arms), 6, 3 * arms.shape[1]))
    for i in range(3):
        maps[:, i, i::3] = 1.0
        maps[:, 3:, i::3] = np.cross(arms, np.eye(3)[i]).swapaxes(1, 2)
    return maps


def _standing_inertia(robot: Robot) -> Array:
    """Return the inertia of the standing robot about its centre of mass, in body axes, (3, 3) [kg m²]."""
    q = pin.neutral(robot.model)
    q[7:] = robot.pose("stand")
    data = robot.model.createData()
    pin.ccrba(robot.model, data, q, np.zeros(robot.model.nv))
    return np.array(data.Ig.inertia)


def _six(robot: Robot, inertia: ArrayLike) -> Array:
    """Return xx, yy, zz, xy, xz, yz of an inertia; raise ModelError if it is not the inertia of a rigid body."""
    array: Array = np.asarray(inertia, dtype=float)
    if array.shape == (3, 3) and np.allclose(array, array.T):
        array = array[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    if array.shape != (6,):
        raise ModelError(
            f"rigid body of '{robot.name}': inertia is unusable - got shape {array.shape}, expected a symmetric (3, 3) "
            "tensor or its (xx, yy, zz, xy, xz, yz) [kg m^2]; give one of them"
        )
    principal = _principal(array)
    if not np.all(principal > 0):
        raise ModelError(
            f"rigid body of '{robot.name}': inertia is not positive - got principal inertias {principal.tolist()} "
            "kg m^2, expected positive ones; check its signs"
        )
    return array


def _principal(six: Array) -> Array:
    """Return the principal inertias of xx, yy, zz, xy, xz, yz, (3,) [kg m^2]; the six if they are not finite."""
    xx, yy, zz, xy, xz, yz = six
    return np.linalg.eigvalsh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) if np.all(np.isfinite(six)) else six


def _inverse(tensor: cs.SX) -> cs.SX:
    """Return the inverse of a (3, 3) matrix by its cofactors."""
    a, b, c = tensor[0, :].T, tensor[1, :].T, tensor[2, :].T
    cofactors = cs.horzcat(cs.cross(b, c), cs.cross(c, a), cs.cross(a, b))
    return cofactors / cs.dot(a, cofactors[:, 0])
