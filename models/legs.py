"""Kinematics of groups of legs over batches of samples: foot positions, Jacobians and inverse kinematics.

A leg is the chain of joints from the base to a foot. Legs with the same number of joints are computed together, with
the numbers of the ``pinocchio.Model``, in NumPy over any leading axes S. The number of joints of a leg is k, the number
of legs in a group is m.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from .robot import ROOT, Foot, Robot

Array = NDArray[np.float64]

_ITERATIONS = 60
# Damping (Sugihara): half the squared error, so that steps are small far from the target, plus a floor
DAMPING_FLOOR = 1e-9  # [m^2]
RATE_DAMPING = 1e-9  # of the rates [m^2]


@dataclass(frozen=True, eq=False)
class Legs:
    """A group of legs with the same number of joints.

    Args:
        feet: indices of the legs' feet in the robot's order, (m,).
        joints: indices of the legs' joints in the state's order, (m, k).
        rotation: orientation of each joint's frame in the frame of the joint before, (m, k, 3, 3).
        offset: origin of each joint's frame in the frame of the joint before, (m, k, 3) [m].
        axis: axis of rotation or translation, (m, k, 3).
        revolute: 1 for a revolute joint, 0 for a prismatic one, (m, k).
        tip: position of the foot in the last joint's frame, (m, 3) [m].
    """

    feet: NDArray[np.intp]
    joints: NDArray[np.intp]
    rotation: Array
    offset: Array
    axis: Array
    revolute: Array
    tip: Array

    @cached_property
    def _samples_last(self) -> _SamplesLast:
        """The same numbers with the axis of the legs last, (..., m, 1)."""
        cross = self.revolute[..., None, None] * np.cross(np.eye(3), self.axis[..., None, :])
        once = self.rotation @ cross
        return _SamplesLast(*(
            np.moveaxis(array, 0, -1)[..., None]
            for array in (self.rotation, once, once @ cross, self.offset, self.axis, self.revolute, self.tip)
        ))  # fmt: skip

    @cached_property
    def reach(self) -> Array:
        """Largest distance of each foot from the second joint of its leg, (m,) [m]; with k < 3 from the first."""
        links = np.linalg.norm(self.offset, axis=-1)[:, 2 if self.joints.shape[1] > 2 else 1 :]
        return np.asarray(links.sum(axis=-1) + np.linalg.norm(self.tip, axis=-1))

    def forward(self, angles: Array) -> tuple[Array, Array, Array]:
        """Return feet, (S, m, 3) [m], joint origins, (S, m, k, 3) [m], and joint axes, (S, m, k, 3), in base axes.

        Args:
            angles: (S, m, k) [rad].
        """
        leading = angles.shape[:-2]
        feet, origins, axes = (
            _from_samples_last(array, leading) for array in self._samples_last.forward(_to_samples_last(angles))
        )
        return feet, origins, axes

    def jacobian(self, angles: Array) -> tuple[Array, Array]:
        """Return feet in base axes, (S, m, 3) [m], and their derivatives by the legs' angles, (S, m, 3, k)."""
        feet, jacobian = self._samples_last.jacobian(_to_samples_last(angles))
        return _from_samples_last(feet, angles.shape[:-2]), _from_samples_last(jacobian, angles.shape[:-2])

    def inverse(
        self, target: Array, angles: Array, bounds: tuple[Array, Array], tolerance: float
    ) -> tuple[Array, Array]:
        """Return angles, (S, m, k) [rad], that put the feet at given positions, and the remaining errors, (S, m) [m].

        Args:
            target: wanted positions in base axes, (S, m, 3) [m].
            angles: angles of the first iteration, (S, m, k) [rad].
            bounds: smallest and largest angles, (m, k) [rad].
            tolerance: error at which the iteration stops [m].
        """
        leading, legs = angles.shape[:-2], self._samples_last
        wanted, now = _to_samples_last(target), _to_samples_last(angles)
        lower, upper = (np.moveaxis(bound, 0, -1)[..., None] for bound in bounds)
        for _ in range(_ITERATIONS):
            feet, jacobian = legs.jacobian(now)
            error = wanted - feet
            squared = np.sum(error**2, axis=0)
            if np.all(squared < tolerance**2):
                break
            now = np.clip(now + _damped_step(jacobian, error, 0.5 * squared + DAMPING_FLOOR), lower, upper)
        distance = np.sqrt(np.sum((wanted - legs.forward(now)[0]) ** 2, axis=0))
        return _from_samples_last(now, leading), _from_samples_last(distance, leading)

    def rates(self, angles: Array, velocity: Array) -> Array:
        """Return the rates of the angles that move the feet at given velocities, (S, m, k) [rad/s].

        Args:
            angles: (S, m, k) [rad].
            velocity: of the feet in base axes, (S, m, 3) [m/s].
        """
        _, jacobian = self._samples_last.jacobian(_to_samples_last(angles))
        step = _damped_step(jacobian, _to_samples_last(velocity), np.array(RATE_DAMPING))
        return _from_samples_last(step, angles.shape[:-2])


@dataclass(frozen=True, eq=False)
class _SamplesLast:
    """The numbers of :class:`Legs` with the axes components, legs, samples: NumPy is fast on long last axes.

    Args:
        rotation, once, twice: the factors of 1, sin q and 1 − cos q in Rodrigues' formula: R, R [a]×, R [a]×². The last
            two are zero for prismatic joints, (k, 3, 3, m, 1).
        offset, axis: (k, 3, m, 1). revolute: (k, m, 1). tip: (3, m, 1). As in :class:`Legs`.
    """

    rotation: Array
    once: Array
    twice: Array
    offset: Array
    axis: Array
    revolute: Array
    tip: Array

    @cached_property
    def has_prismatic(self) -> bool:
        """Whether some joint is prismatic."""
        return not np.all(self.revolute > 0)

    def forward(self, angles: Array) -> tuple[Array, Array, Array]:
        """Return feet, (3, m, S), joint origins, (k, 3, m, S), and joint axes, (k, 3, m, S), for angles (k, m, S)."""
        sine, versine = np.sin(angles)[:, None, None], 1 - np.cos(angles)[:, None, None]
        local = self.rotation + sine * self.once + versine * self.twice
        origins, axes = (np.empty((len(angles), 3, *angles.shape[1:])) for _ in range(2))
        origin, frame = self.offset[0], local[0]
        for i in range(len(angles)):
            if i > 0:
                origin, frame = origin + _product(frame, self.offset[i]), _product(frame, local[i])
            axes[i] = _product(frame, self.axis[i])
            if self.has_prismatic:
                origin = origin + (1 - self.revolute[i]) * angles[i] * axes[i]
            origins[i] = origin
        return origin + _product(frame, self.tip), origins, axes

    def jacobian(self, angles: Array) -> tuple[Array, Array]:
        """Return feet, (3, m, S), and their derivatives by the angles, (3, k, m, S)."""
        feet, origins, axes = self.forward(angles)
        (ax, ay, az), (bx, by, bz) = np.moveaxis(axes, 1, 0), np.moveaxis(feet - origins, 1, 0)
        columns = np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])
        if self.has_prismatic:
            columns = np.where(self.revolute > 0, columns, np.moveaxis(axes, 1, 0))
        return feet, columns


def legs_of(robot: Robot) -> tuple[Legs, ...]:
    """Return the robot's legs in groups of the same number of joints."""
    lengths = [len(_joints(robot, foot)) for foot in robot.feet]
    return tuple(
        _stack(robot, [i for i, length in enumerate(lengths) if length == k]) for k in sorted(set(lengths)) if k
    )


def _joints(robot: Robot, foot: Foot) -> list[int]:
    """Return the joints from the base to a foot, by their index in the pinocchio model."""
    index = robot.model.frames[robot.frame_id(foot.frame)].parentJoint
    chain: list[int] = []
    while index > ROOT:
        chain.insert(0, index)
        index = robot.model.parents[index]
    return chain


def _stack(robot: Robot, feet: list[int]) -> Legs:
    """Return the group of the legs of some feet."""
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


def _damped_step(jacobian: Array, rate: Array, damping: Array) -> Array:
    """Return Jᵀ (J Jᵀ + λ I)⁻¹ r, (k, m, S), for J (3, k, m, S) and r (3, m, S), by cofactors.

    With fewer than three joints J Jᵀ is singular, and its cofactors are mostly rounding errors. Then the equal
    (JᵀJ + λ I)⁻¹ Jᵀ r is computed by elimination.
    """
    if jacobian.shape[1] < 3:
        rows = np.moveaxis(jacobian, (0, 1), (-2, -1))
        columns = np.swapaxes(rows, -1, -2)
        gram = columns @ rows + np.broadcast_to(damping, rows.shape[:-2])[..., None, None] * np.eye(rows.shape[-1])
        step = np.linalg.solve(gram, columns @ np.moveaxis(rate, 0, -1)[..., None])
        return np.asarray(np.moveaxis(step[..., 0], -1, 0))
    x, y, z = jacobian
    xx, yy, zz = (np.sum(row * row, axis=0) + damping for row in (x, y, z))
    xy, xz, yz = np.sum(x * y, axis=0), np.sum(x * z, axis=0), np.sum(y * z, axis=0)
    c_xx, c_yy, c_zz = yy * zz - yz**2, xx * zz - xz**2, xx * yy - xy**2
    c_xy, c_xz, c_yz = xz * yz - xy * zz, xy * yz - xz * yy, xy * xz - xx * yz
    r = rate / (xx * c_xx + xy * c_xy + xz * c_xz)
    return np.asarray(
        x * (c_xx * r[0] + c_xy * r[1] + c_xz * r[2])
        + y * (c_xy * r[0] + c_yy * r[1] + c_yz * r[2])
        + z * (c_xz * r[0] + c_yz * r[1] + c_zz * r[2])
    )


def _product(a: Array, b: Array) -> Array:
    """Return matrices (3, 3, m, S) times columns (3, m, S) or matrices (3, 3, m, S)."""
    if b.ndim == a.ndim:
        a = a[:, :, None]
    return np.asarray(a[:, 0] * b[0] + a[:, 1] * b[1] + a[:, 2] * b[2])


def _to_samples_last(array: Array) -> Array:
    """Return (S, m, n), with any leading axes S, as (n, m, S), with S flat."""
    flat = array.reshape(-1, *array.shape[-2:])
    return np.ascontiguousarray(np.moveaxis(flat, (0, 1), (-1, -2)))


def _from_samples_last(array: Array, leading: tuple[int, ...]) -> Array:
    """Return (..., m, S), with S flat, as (S, m, ...), with the leading axes S."""
    moved = np.moveaxis(array, (-1, -2), (0, 1))
    return moved.reshape(*leading, *moved.shape[1:])
