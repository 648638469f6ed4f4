"""Kinematics of legs over batches of samples: where the feet are, and joint angles that put them there.

Legs of equally many joints are worked on together, with the numbers of the ``pinocchio.Model``, in NumPy over any
leading axes S. A leg is the joints from the base to a foot; k is their number, m the number of legs in a group.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from piaffe.ocp import rotation

from .robot import ROOT, Foot, Robot

Array = NDArray[np.float64]

_ITERATIONS = 60
_TOLERANCE = 1e-10  # [m]
_TRIES = 100  # starts of a standing pose
# Damping (Sugihara): half the squared error, so that steps are small far from the target, plus a floor
_FLOOR = 1e-9  # [m^2]


@dataclass(frozen=True, eq=False)
class Legs:
    """Legs of equally many joints, stacked.

    Args:
        feet: where the legs' feet are among the robot's, (m,).
        joints: where their joints are in the state's order, (m, k).
        rotation: axes of each joint in those of the one before, (m, k, 3, 3).
        offset: its origin there, (m, k, 3) [m].
        axis: what it turns about or slides along, (m, k, 3).
        revolute: 1 if it turns, 0 if it slides, (m, k).
        tip: the foot in the last joint's axes, (m, 3) [m].
    """

    feet: NDArray[np.intp]
    joints: NDArray[np.intp]
    rotation: Array
    offset: Array
    axis: Array
    revolute: Array
    tip: Array

    @cached_property
    def _turns(self) -> tuple[Array, Array]:
        """What sine and versine of the angles are multiplied by in Rodrigues' formula, (m, k, 3, 3) each.

        They are R [a]× and R [a]×², with a zero for joints that slide.
        """
        cross = self.revolute[..., None, None] * np.cross(np.eye(3), self.axis[..., None, :])
        return self.rotation @ cross, self.rotation @ cross @ cross

    @cached_property
    def _links(self) -> Array:
        """In each joint's axes, as columns, its own and the origin of the next joint, in the end the foot, (m, k, 3, 2)."""
        after = np.concatenate([self.offset[:, 1:], self.tip[:, None]], axis=1)
        return np.stack([self.axis, after], axis=-1)

    @cached_property
    def _slides(self) -> bool:
        """Whether some joint does not turn."""
        return not np.all(self.revolute > 0)

    @cached_property
    def reach(self) -> Array:
        """The most that each foot can be away from the second joint, the first of fewer than three, (m,) [m]."""
        links = np.linalg.norm(self.offset, axis=-1)[:, 2 if self.joints.shape[1] > 2 else 1 :]
        return np.asarray(links.sum(axis=-1) + np.linalg.norm(self.tip, axis=-1))

    def walk(self, angles: Array) -> tuple[Array, Array, Array]:
        """Return feet, (S, m, 3), joint origins, (S, m, k, 3) [m], and joint axes, (S, m, k, 3), in base axes.

        Args:
            angles: (S, m, k) [rad].
        """
        once, twice = self._turns
        sine, versine = np.sin(angles)[..., None, None], 1 - np.cos(angles)[..., None, None]
        local = self.rotation + sine * once + versine * twice
        origins, axes = np.empty((*angles.shape, 3)), np.empty((*angles.shape, 3))
        place, turn = self.offset[:, 0], np.eye(3)
        for i in range(angles.shape[-1]):
            turn = turn @ local[..., i, :, :]
            columns = turn @ self._links[:, i]
            if self._slides:
                place = place + ((1 - self.revolute[:, i]) * angles[..., i])[..., None] * columns[..., 0]
            origins[..., i, :], axes[..., i, :] = place, columns[..., 0]
            place = place + columns[..., 1]
        return place, origins, axes

    def forward(self, angles: Array) -> tuple[Array, Array]:
        """Return feet in base axes, (S, m, 3) [m], and their derivatives by the legs' angles, (S, m, 3, k)."""
        feet, origins, axes = self.walk(angles)
        columns = _cross(axes, feet[..., None, :] - origins)
        if self._slides:
            columns = np.where(self.revolute[..., None] > 0, columns, axes)
        return feet, np.swapaxes(columns, -1, -2)


class Kinematics:
    """Feet and joint angles of a robot; n are its joints, nf its feet.

    Args:
        robot: the robot.
    """

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        self.groups = _groups(robot)

    @cached_property
    def reach(self) -> Array:
        """The most that each foot can be away from the second joint of its leg, (nf,) [m]."""
        reach = np.zeros(len(self.robot.feet))
        for legs in self.groups:
            reach[legs.feet] = legs.reach
        return reach

    def feet(self, joints: Array) -> Array:
        """Return the feet in base axes, (S, nf, 3) [m], for joint angles (S, n) [rad]."""
        joints = np.asarray(joints, dtype=float)
        feet = np.empty((*joints.shape[:-1], len(self.robot.feet), 3))
        for legs in self.groups:
            feet[..., legs.feet, :] = legs.walk(joints[..., legs.joints])[0]
        return feet

    def world_feet(self, base_position: Array, base_orientation: Array, joints: Array) -> Array:
        """Return the feet in the world, (S, nf, 3) [m].

        Args:
            base_position: (S, 3) [m].
            base_orientation: unit quaternions, w first, (S, 4).
            joints: (S, n) [rad].
        """
        turn = rotation.np_matrix(base_orientation)[..., None, :, :]
        return base_position[..., None, :] + _turn(turn, self.feet(joints))

    def inverse(self, feet: Array, start: object = "stand", tolerance: float = _TOLERANCE) -> tuple[Array, Array]:
        """Return joint angles that put the feet at places in base axes, and by how much they miss.

        Damped least squares from ``start``, kept within the joint limits; a place out of reach gives the nearest found.
        Joints of no leg keep their start.

        Args:
            feet: places in base axes, (S, nf, 3) [m].
            start: a pose to start from, which decides to which side knees bend, or angles (S, n) [rad].
            tolerance: a miss that is as good as none [m].

        Returns:
            Joint angles (S, n) [rad] and distances from the wanted places (S, nf) [m].
        """
        feet = np.asarray(feet, dtype=float)
        first: Array = start if isinstance(start, np.ndarray) and start.ndim > 1 else self.robot.pose(start)
        joints: Array = np.array(np.broadcast_to(first, (*feet.shape[:-2], self.robot.num_joints)))
        misses = np.zeros(feet.shape[:-1])
        for legs in self.groups:
            angles, miss = self._inverse(legs, feet[..., legs.feet, :], joints[..., legs.joints], tolerance)
            joints[..., legs.joints] = angles
            misses[..., legs.feet] = miss
        return joints, misses

    def world_inverse(
        self,
        base_position: Array,
        base_orientation: Array,
        feet: Array,
        start: object = "stand",
        tolerance: float = _TOLERANCE,
    ) -> tuple[Array, Array]:
        """Return :meth:`inverse` for places in the world, (S, nf, 3) [m], and a base pose."""
        turn = np.swapaxes(rotation.np_matrix(base_orientation), -1, -2)[..., None, :, :]
        return self.inverse(_turn(turn, feet - base_position[..., None, :]), start, tolerance)

    def joint_velocities(self, joints: Array, feet_velocity: Array) -> Array:
        """Return the joint velocities, (S, n) [rad/s], that move the feet at velocities relative to the base.

        Args:
            joints: (S, n) [rad].
            feet_velocity: derivative of the feet in base axes, (S, nf, 3) [m/s].
        """
        velocities = np.zeros_like(joints)
        for legs in self.groups:
            jacobian = legs.forward(joints[..., legs.joints])[1]
            velocities[..., legs.joints] = _least(jacobian, feet_velocity[..., legs.feet, :], 1e-9)
        return velocities

    @cached_property
    def workspace(self) -> tuple[Array, Array]:
        """Joint angles drawn evenly within their limits, (2000, n) [rad], and the feet in base axes, (2000, nf, 3) [m].

        A joint without limits turns from −π to π. The draw is seeded: the same robot gives the same samples.
        """
        lower, upper = np.maximum(self.robot.joint_lower, -np.pi), np.minimum(self.robot.joint_upper, np.pi)
        joints = np.random.default_rng(0).uniform(lower, upper, (2000, self.robot.num_joints))
        return joints, self.feet(joints)

    def standing_pose(self, extension: float) -> Array:
        """Return joint angles with each foot straight below its place at zero angles and knees behind, (n,) [rad].

        Args:
            extension: how far below its leg's first joint, as a fraction of the farthest that the foot can be.
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
        tried, miss = self.inverse(np.broadcast_to(targets, (_TRIES, *targets.shape)), start)
        joints = np.zeros(self.robot.num_joints)
        for legs in self.groups:
            angles = tried[:, legs.joints]
            ahead = legs.walk(angles)[1][..., -1, 0] > targets[legs.feet, 0]  # the knee before the foot
            cost = np.linalg.norm(angles, axis=-1) + 10 * ahead + 100 * (miss[:, legs.feet] > 1e-6)
            joints[legs.joints] = angles[np.argmin(cost, axis=0), np.arange(len(legs.feet))]
        return joints

    def _inverse(self, legs: Legs, target: Array, angles: Array, tolerance: float) -> tuple[Array, Array]:
        lower, upper = self.robot.joint_lower[legs.joints], self.robot.joint_upper[legs.joints]
        for _ in range(_ITERATIONS):
            feet, jacobian = legs.forward(angles)
            error = target - feet
            squared = np.sum(error**2, axis=-1)
            if np.all(squared < tolerance**2):
                break
            angles = np.clip(angles + _least(jacobian, error, 0.5 * squared + _FLOOR), lower, upper)
        return angles, np.linalg.norm(target - legs.walk(angles)[0], axis=-1)


def _least(jacobian: Array, rate: Array, damping: Array | float) -> Array:
    """Return Jᵀ (J Jᵀ + λ I)⁻¹ r, (..., k), for J (..., 3, k) and r (..., 3)."""
    transposed = np.swapaxes(jacobian, -1, -2)
    normal = jacobian @ transposed + np.asarray(damping)[..., None, None] * np.eye(3)
    return np.asarray((transposed @ np.linalg.solve(normal, rate[..., None]))[..., 0])


def _turn(matrix: Array, vectors: Array) -> Array:
    """Return matrices times vectors, (..., 3, 3) and (..., 3) → (..., 3)."""
    return np.asarray((matrix @ vectors[..., None])[..., 0])


def _cross(a: Array, b: Array) -> Array:
    """Return a × b, (..., 3); NumPy's own takes four times as long."""
    (ax, ay, az), (bx, by, bz) = ([v[..., i] for i in range(3)] for v in (a, b))
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=-1)


def _groups(robot: Robot) -> tuple[Legs, ...]:
    """Return the robot's legs, those of equally many joints together."""
    lengths = [len(_joints(robot, foot)) for foot in robot.feet]
    return tuple(
        _stack(robot, [i for i, length in enumerate(lengths) if length == k]) for k in sorted(set(lengths)) if k
    )


def _joints(robot: Robot, foot: Foot) -> list[int]:
    """Return the joints from the base to a foot, by their index in the pinocchio model."""
    index = robot.model.frames[robot.frame_id(foot.frame)].parentJoint
    found: list[int] = []
    while index > ROOT:
        found.insert(0, index)
        index = robot.model.parents[index]
    return found


def _stack(robot: Robot, feet: list[int]) -> Legs:
    """Return the legs of some feet from the model's numbers."""
    model = robot.model
    indices = [_joints(robot, robot.feet[i]) for i in feet]
    axes = np.array([[robot.joint_axis(j) for j in leg] for leg in indices])
    revolute = np.linalg.norm(axes[..., 3:], axis=-1) > 0.5
    return Legs(
        feet=np.array(feet),
        joints=np.array(indices) - ROOT - 1,
        rotation=np.array([[model.jointPlacements[j].rotation for j in leg] for leg in indices]),
        offset=np.array([[model.jointPlacements[j].translation for j in leg] for leg in indices]),
        axis=np.where(revolute[..., None], axes[..., 3:], axes[..., :3]),
        revolute=revolute.astype(float),
        tip=np.array([model.frames[robot.frame_id(robot.feet[i].frame)].placement.translation for i in feet]),
    )
