"""Kinematics of a robot's legs over batches of samples, in base axes and in the world."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from piaffe.ocp import rotation

from .legs import legs_of
from .robot import Robot

Array = NDArray[np.float64]

_TOLERANCE = 1e-10  # [m]
_TRIES = 100  # starting points of the search for a standing pose


class Kinematics:
    """Forward and inverse kinematics of a robot's legs; n is its number of joints, nf its number of feet.

    Args:
        robot: the robot.
    """

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        self.groups = legs_of(robot)

    @cached_property
    def reach(self) -> Array:
        """Largest distance of each foot from the second joint of its leg, (nf,) [m]."""
        reach = np.zeros(len(self.robot.feet))
        for legs in self.groups:
            reach[legs.feet] = legs.reach
        return reach

    def feet(self, joints: Array) -> Array:
        """Return the positions of the feet in base axes, (S, nf, 3) [m], for joint angles (S, n) [rad]."""
        joints = np.asarray(joints, dtype=float)
        feet: Array = np.array(np.broadcast_to(self._fixed, (*joints.shape[:-1], *self._fixed.shape)))
        for legs in self.groups:
            feet[..., legs.feet, :] = legs.forward(joints[..., legs.joints])[0]
        return feet

    @cached_property
    def _fixed(self) -> Array:
        """Position of each foot in the frame of the joint that moves it, (nf, 3) [m]; without a joint, on the base."""
        frames = [self.robot.model.frames[self.robot.frame_id(foot.frame)] for foot in self.robot.feet]
        return np.array([frame.placement.translation for frame in frames])

    def world_feet(self, base_position: Array, base_orientation: Array, joints: Array) -> Array:
        """Return the positions of the feet in the world, (S, nf, 3) [m].

        Args:
            base_position: (S, 3) [m].
            base_orientation: unit quaternions, w first, (S, 4).
            joints: (S, n) [rad].
        """
        to_world = rotation.np_matrix(base_orientation)[..., None, :, :]
        return base_position[..., None, :] + _rotate(to_world, self.feet(joints))

    def inverse(self, feet: Array, start: object = "stand", tolerance: float = _TOLERANCE) -> tuple[Array, Array]:
        """Return joint angles that put the feet at given positions in base axes, and the remaining errors.

        The method is damped least squares from ``start``; the angles stay within the joint limits. For a position out
        of reach the result is the nearest one that was found. Joints that belong to no leg keep their start.

        Args:
            feet: wanted positions in base axes, (S, nf, 3) [m].
            start: a pose, or angles (S, n) [rad]; it decides to which side the knees bend.
            tolerance: error at which the iteration stops [m].

        Returns:
            Joint angles (S, n) [rad] and distances from the wanted positions (S, nf) [m].
        """
        feet = np.asarray(feet, dtype=float)
        first: Array = start if isinstance(start, np.ndarray) and start.ndim > 1 else self.robot.pose(start)
        joints: Array = np.array(np.broadcast_to(first, (*feet.shape[:-2], self.robot.num_joints)))
        errors = np.zeros(feet.shape[:-1])
        for legs in self.groups:
            bounds = self.robot.joint_lower[legs.joints], self.robot.joint_upper[legs.joints]
            angles, error = legs.inverse(feet[..., legs.feet, :], joints[..., legs.joints], bounds, tolerance)
            joints[..., legs.joints] = angles
            errors[..., legs.feet] = error
        return joints, errors

    def world_inverse(
        self,
        base_position: Array,
        base_orientation: Array,
        feet: Array,
        start: object = "stand",
        tolerance: float = _TOLERANCE,
    ) -> tuple[Array, Array]:
        """Return :meth:`inverse` for positions in the world, (S, nf, 3) [m], and a base pose."""
        to_base = np.swapaxes(rotation.np_matrix(base_orientation), -1, -2)[..., None, :, :]
        return self.inverse(_rotate(to_base, feet - base_position[..., None, :]), start, tolerance)

    def joint_velocities(self, joints: Array, feet_velocity: Array) -> Array:
        """Return the joint velocities, (S, n) [rad/s], that move the feet at given velocities relative to the base.

        Args:
            joints: (S, n) [rad].
            feet_velocity: time derivative of the foot positions in base axes, (S, nf, 3) [m/s].
        """
        velocities = np.zeros_like(joints)
        for legs in self.groups:
            velocities[..., legs.joints] = legs.rates(joints[..., legs.joints], feet_velocity[..., legs.feet, :])
        return velocities

    @cached_property
    def workspace(self) -> tuple[Array, Array]:
        """Uniform samples of the joint angles, (2000, n) [rad], and the feet in base axes, (2000, nf, 3) [m].

        The angles are within the joint limits; a joint without limits has the range −π to π. The samples are seeded:
        the same robot gives the same samples.
        """
        lower, upper = np.maximum(self.robot.joint_lower, -np.pi), np.minimum(self.robot.joint_upper, np.pi)
        joints = np.random.default_rng(0).uniform(lower, upper, (2000, self.robot.num_joints))
        return joints, self.feet(joints)

    def standing_pose(self, extension: float) -> Array:
        """Return joint angles that put each foot below its position at zero angles, with knees behind, (n,) [rad].

        Args:
            extension: distance of the foot below its leg's first joint, as a fraction of the largest possible one.
        """
        samples, places = self.workspace
        targets = self.feet(np.zeros(self.robot.num_joints))
        roots = np.zeros(len(targets))
        for legs in self.groups:
            roots[legs.feet] = legs.offset[:, 0, 2]
        targets[:, 2] = roots - extension * np.max(roots - places[:, :, 2].min(axis=0))
        start = np.zeros((_TRIES, self.robot.num_joints))
        for legs in self.groups:
            for m, foot in enumerate(legs.feet):
                near = np.argsort(np.linalg.norm(places[:, foot] - targets[foot], axis=-1))[:_TRIES]
                start[:, legs.joints[m]] = samples[near][:, legs.joints[m]]
        tried, error = self.inverse(np.broadcast_to(targets, (_TRIES, *targets.shape)), start)
        joints = np.zeros(self.robot.num_joints)
        for legs in self.groups:
            angles = tried[:, legs.joints]
            ahead = legs.forward(angles)[1][..., -1, 0] > targets[legs.feet, 0]  # the knee is in front of the foot
            cost = np.linalg.norm(angles, axis=-1) + 10 * ahead + 100 * (error[:, legs.feet] > 1e-6)
            joints[legs.joints] = angles[np.argmin(cost, axis=0), np.arange(len(legs.feet))]
        return joints


def _rotate(matrix: Array, vectors: Array) -> Array:
    """Return matrices times vectors, (..., 3, 3) and (..., 3) → (..., 3)."""
    return np.asarray((matrix @ vectors[..., None])[..., 0])
