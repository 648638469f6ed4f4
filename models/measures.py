"""Measures of a motion: rotation and apex of the base, smallest height of the feet, joint speeds, impacts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piaffe.ocp import CompiledProblem, Trajectory, quantity_values, rotation

from .quantities import base, feet, joints

Array = NDArray[np.float64]

_SMALLEST_IMPULSE = 1e-3  # [N s]


@dataclass(frozen=True, eq=False)
class Impact:
    """The impulses on the feet that land at the end of a phase.

    Args:
        phase: name of the phase.
        time: time of the impact [s].
        impulses: world impulses of all feet (nf, 3) [N s]; NaN for feet that do not land.
        normals: upward unit normals of the ground where they land (nf, 3); None for level ground.
    """

    phase: str
    time: float
    impulses: Array
    normals: Array | None = None

    @property
    def normal(self) -> Array:
        """The impulses of the feet that land, along the normal of the ground [N s]."""
        return self._landing[:, 2]

    @property
    def on_ground(self) -> Array:
        """The impulses of all feet in axes of the ground where each lands, the normal last (nf, 3) [N s]."""
        return self.impulses if self.normals is None else on_ground(self.impulses, self.normals)

    @property
    def ratio(self) -> float:
        """The largest of the feet's :func:`impulse_ratios`; 0 if no foot has an impulse."""
        return float(np.nanmax(impulse_ratios(self._landing), initial=0.0))

    @property
    def _landing(self) -> Array:
        return self.on_ground[np.isfinite(self.impulses[:, 0])]


def on_ground(vectors: Array, normals: Array) -> Array:
    """Return vectors (..., 3) in axes of the ground, x and y of the world turned with the vertical onto the normals.

    The quantities ``feet.contact_force`` and ``feet.contact_impulse`` are in the same axes.
    """
    tilt, along = normals[..., :2], np.sum(vectors * normals, axis=-1, keepdims=True)
    share = (vectors[..., 2:] + along) / (1 + normals[..., 2:])
    return np.concatenate([vectors[..., :2] - share * tilt, along], axis=-1)


def impulse_ratios(impulses: Array) -> Array:
    """Return max(|Λ_x|, |Λ_y|) / Λ_z of impulses (…, 3), z along the normal; infinite if the ground would have to pull.

    It is NaN for impulses below 1 mN s, of which a solve does not tell the direction, and for feet that do not land.
    """
    normal = impulses[..., 2]
    ratios = np.full(normal.shape, np.nan)
    there = np.abs(impulses).max(axis=-1) >= _SMALLEST_IMPULSE
    sideways = np.abs(impulses[..., :2]).max(axis=-1)
    ratios[there] = np.inf
    np.divide(sideways, normal, out=ratios, where=there & (normal > 0))
    return ratios


def impacts(trajectory: Trajectory) -> list[Impact]:
    """Return the recorded impacts, in the order of time."""
    found = []
    for phase in trajectory.phases:
        stored = {quantity.path: values for quantity, values in phase.reset_outputs.items()}
        if feet.impulse.path in stored and feet.landing.path in stored:
            lands = stored[feet.landing.path] > 0
            impulses = np.where(lands[:, None], stored[feet.impulse.path].reshape(-1, 3), np.nan)
            normals = stored[feet.normal.path].reshape(-1, 3) if feet.normal.path in stored else None
            found.append(Impact(phase.name, float(phase.times[-1]), impulses, normals))
    return found


def series(trajectory: Trajectory, path: str) -> Array | None:
    """Return a quantity of the state at all nodes of the phases that have it, (nodes, size); None if none has it."""
    parts = []
    for phase in trajectory.phases:
        for quantity, where in phase.state.slices.items():
            if quantity.path == path:
                parts.append(phase.states[:, where])
    return np.concatenate(parts) if parts else None


@dataclass(frozen=True)
class JointSpeed:
    """The largest speed of a joint.

    Args:
        name: name of the joint.
        speed: largest speed [rad/s], or [m/s] of a prismatic joint.
        limit: of the robot, in the same unit.
    """

    name: str
    speed: float
    limit: float

    @property
    def ratio(self) -> float:
        """The speed as a part of the limit."""
        return self.speed / self.limit


def fastest_joint(compiled: CompiledProblem, trajectory: Trajectory) -> JointSpeed | None:
    """Return the joint that is fastest for its limit; None without a robot that has joints and limits."""
    found: JointSpeed | None = None
    for phase, part in zip(compiled.phases, trajectory.phases, strict=True):
        robot, where = getattr(phase.mode.model, "robot", None), part.state.slices.get(joints.velocity)
        if robot is None or where is None:
            continue
        speeds, limits = np.abs(part.states[:, where]).max(axis=0), robot.joint_speed_limit
        for name, speed, limit in zip(robot.joint_names, speeds, limits, strict=True):
            if np.isfinite(limit) and limit > 0 and (found is None or speed / limit > found.ratio):
                found = JointSpeed(name, float(speed), float(limit))
    return found


def turns(trajectory: Trajectory) -> Array | None:
    """Return the sum of the base's rotation vectors from node to node, in its own axes, (3,) [rad]."""
    orientations = series(trajectory, base.orientation.path)
    if orientations is None:
        return None
    steps = rotation.np_multiply(rotation.np_conjugate(orientations[:-1]), orientations[1:])
    return np.asarray(np.sum(rotation.np_log(steps), axis=0))


def apex(trajectory: Trajectory) -> float | None:
    """Return the largest height of the base's origin [m]."""
    positions = series(trajectory, base.position.path)
    return None if positions is None else float(positions[:, 2].max())


def lowest_foot(compiled: CompiledProblem, trajectory: Trajectory) -> float | None:
    """Return the smallest gap between a foot's ball and the terrain [m], over the phases whose model has legs."""
    heights = [each for each in quantity_values(compiled, trajectory, feet.height) if each is not None and each.size]
    return float(min(values.min() for values in heights)) if heights else None
