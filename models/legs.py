"""Legs over batches of samples: where feet are, and joint angles that put them there.

Legs of equally many joints are worked on together, with the numbers of the ``pinocchio.Model``, in NumPy over any
leading axes S. A leg is the joints from the base to a foot; k is their number, m the number of legs in a group.
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
    def _lanes(self) -> _Lanes:
        """The same numbers, legs last, (..., m, 1)."""
        cross = self.revolute[..., None, None] * np.cross(np.eye(3), self.axis[..., None, :])
        once = self.rotation @ cross
        return _Lanes(*(
            np.moveaxis(array, 0, -1)[..., None]
            for array in (self.rotation, once, once @ cross, self.offset, self.axis, self.revolute, self.tip)
        ))  # fmt: skip

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
        feet, origins, axes = self._lanes.walk(_to_lanes(angles))
        before = angles.shape[:-2]
        return _from_lanes(feet, before), _from_lanes(origins, before), _from_lanes(axes, before)

    def forward(self, angles: Array) -> tuple[Array, Array]:
        """Return feet in base axes, (S, m, 3) [m], and their derivatives by the legs' angles, (S, m, 3, k)."""
        feet, jacobian = self._lanes.forward(_to_lanes(angles))
        return _from_lanes(feet, angles.shape[:-2]), _from_lanes(jacobian, angles.shape[:-2])

    def inverse(
        self, target: Array, angles: Array, bounds: tuple[Array, Array], tolerance: float
    ) -> tuple[Array, Array]:
        """Return angles, (S, m, k) [rad], that put the feet at places, and by how much these are missed, (S, m) [m].

        Args:
            target: places in base axes, (S, m, 3) [m].
            angles: where to start, (S, m, k) [rad].
            bounds: smallest and largest angles, (m, k) [rad].
            tolerance: a miss that is as good as none [m].
        """
        before, lanes = angles.shape[:-2], self._lanes
        wanted, now = _to_lanes(target), _to_lanes(angles)
        lower, upper = (np.moveaxis(bound, 0, -1)[..., None] for bound in bounds)
        for _ in range(_ITERATIONS):
            feet, jacobian = lanes.forward(now)
            error = wanted - feet
            squared = np.sum(error**2, axis=0)
            if np.all(squared < tolerance**2):
                break
            now = np.clip(now + _least(jacobian, error, 0.5 * squared + _FLOOR), lower, upper)
        miss = np.sqrt(np.sum((wanted - lanes.walk(now)[0]) ** 2, axis=0))
        return _from_lanes(now, before), _from_lanes(miss, before)

    def rates(self, angles: Array, velocity: Array) -> Array:
        """Return the rates of the angles that move the feet at velocities, (S, m, k) [rad/s].

        Args:
            angles: (S, m, k) [rad].
            velocity: of the feet in base axes, (S, m, 3) [m/s].
        """
        _, jacobian = self._lanes.forward(_to_lanes(angles))
        return _from_lanes(_least(jacobian, _to_lanes(velocity), np.array(1e-9)), angles.shape[:-2])


@dataclass(frozen=True, eq=False)
class _Lanes:
    """Legs for arithmetic on many samples at once: components first, then legs, samples last, as long rows are fast.

    Args:
        rotation, once, twice: what 1, sine and 1 − cosine of the angles are multiplied by in Rodrigues' formula: R,
            R [a]×, R [a]×², the latter two zero for joints that slide, (k, 3, 3, m, 1).
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
    def slides(self) -> bool:
        """Whether some joint does not turn."""
        return not np.all(self.revolute > 0)

    def walk(self, angles: Array) -> tuple[Array, Array, Array]:
        """Return feet, (3, m, S), joint origins, (k, 3, m, S), and joint axes, (k, 3, m, S), for angles (k, m, S)."""
        sine, versine = np.sin(angles)[:, None, None], 1 - np.cos(angles)[:, None, None]
        local = self.rotation + sine * self.once + versine * self.twice
        origins, axes = (np.empty((len(angles), 3, *angles.shape[1:])) for _ in range(2))
        place, turn = self.offset[0], local[0]
        for i in range(len(angles)):
            if i > 0:
                place, turn = place + _product(turn, self.offset[i]), _product(turn, local[i])
            axes[i] = _product(turn, self.axis[i])
            if self.slides:
                place = place + (1 - self.revolute[i]) * angles[i] * axes[i]
            origins[i] = place
        return place + _product(turn, self.tip), origins, axes

    def forward(self, angles: Array) -> tuple[Array, Array]:
        """Return feet, (3, m, S), and their derivatives by the angles, (3, k, m, S)."""
        feet, origins, axes = self.walk(angles)
        (ax, ay, az), (bx, by, bz) = np.moveaxis(axes, 1, 0), np.moveaxis(feet - origins, 1, 0)
        columns = np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])
        if self.slides:
            columns = np.where(self.revolute > 0, columns, np.moveaxis(axes, 1, 0))
        return feet, columns


def legs_of(robot: Robot) -> tuple[Legs, ...]:
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


def _least(jacobian: Array, rate: Array, damping: Array) -> Array:
    """Return Jᵀ (J Jᵀ + λ I)⁻¹ r, (k, m, S), for J (3, k, m, S) and r (3, m, S), by cofactors.

    Of legs of fewer than three joints by elimination, of the smaller (JᵀJ + λ I)⁻¹ Jᵀ r: cofactors of a matrix of rank
    one are nothing but rounding.
    """
    if jacobian.shape[1] < 3:
        rows = np.moveaxis(jacobian, (0, 1), (-2, -1))
        columns = np.swapaxes(rows, -1, -2)
        gram = columns @ rows + np.broadcast_to(damping, rows.shape[:-2])[..., None, None] * np.eye(rows.shape[-1])
        found = np.linalg.solve(gram, columns @ np.moveaxis(rate, 0, -1)[..., None])
        return np.asarray(np.moveaxis(found[..., 0], -1, 0))
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


def _to_lanes(array: Array) -> Array:
    """Return (S, m, n), any S, as (n, m, S), S flat."""
    flat = array.reshape(-1, *array.shape[-2:])
    return np.ascontiguousarray(np.moveaxis(flat, (0, 1), (-1, -2)))


def _from_lanes(array: Array, before: tuple[int, ...]) -> Array:
    """Return (..., m, S), S flat, as (S, m, ...)."""
    back = np.moveaxis(array, (-1, -2), (0, 1))
    return back.reshape(*before, *back.shape[1:])
