"""Rigid-body recursions over a tree: inverse dynamics, mass matrix, motion of points, as CasADi expressions.

The tree is a floating base (link 0) with revolute and prismatic joints; its numbers are a :class:`~.tree.Tree`. The
layout is that of the state: ``q`` = world position of the base origin, quaternion (w, x, y, z), joint positions; ``v``
= world velocity of the base origin, body angular velocity, joint velocities; ``a`` = dv/dt. Forces are dual to v: world
force on the base, body torque about its origin, joint torques. A tree with a fixed base has the parts of the joints
alone in q, v, a and forces; its base is at the origin.

Vectors of a link are in the link's frame. Two choices keep the expressions and their derivatives small:

* Rotation enters only through Ω = [α×] + [ω×]², the matrix that maps a point r fixed to the link to its acceleration
  Ω r. With first moment h = ∫ r dm and second moment Σ = ∫ r rᵀ dm about the link's origin, whose acceleration is e::

      f = m e + Ω h,        n = ∫ r × (e + Ω r) dm = h × e + vee(Ω Σ)

* The recursion is *relative to the base origin*. The acceleration of the origin and gravity add one term per link, the
  cross product with the first moment of its subtree. Derivatives with respect to attitude, base acceleration and
  contact force therefore need few instructions: they do not depend on the recursion over the tree.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property

import casadi as cs
import numpy as np
from numpy.typing import NDArray

from piaffe.ocp import rotation

from .tree import Inertials, Point, Tree, stack

Array = NDArray[np.float64]

_BASE = 6  # velocities of a base that floats
_ORIGIN = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])  # place of a base that is fixed


class Recursion:
    """Kinematics and dynamics of a tree at one state: motion of its points, and the generalised forces of its motion.

    Args:
        tree: the tree.
        q: configuration, (7 + n, 1); the quaternion is used as given, unit or not. With a fixed base (n, 1), so are v
            and a.
        v: velocity, (6 + n, 1); None at rest. The attribute has the base's part, zero if it is fixed, in any case.
        a: acceleration, (6 + n, 1); None for zero. The same holds for the attribute.
        dt: if given, the step over which a is the mean acceleration [s]. Squares of velocities in accelerations and
            forces are then products of v and v + a dt, and γ acts on their mean.
    """

    def __init__(
        self, tree: Tree, q: cs.SX, v: cs.SX | None = None, a: cs.SX | None = None, dt: cs.SX | None = None
    ) -> None:
        self.tree = tree
        if tree.fixed:
            q = cs.vertcat(cs.SX(_ORIGIN), q)
            v, a = (None if each is None else cs.vertcat(cs.SX.zeros(_BASE), each) for each in (v, a))
        self.position = q[:3]
        self.attitude = rotation.matrix(q[3:7])
        self.v = cs.SX.zeros(tree.num_links + 5) if v is None else v
        self.a = cs.SX.zeros(tree.num_links + 5) if a is None else a
        self.v_next = self.v if dt is None else self.v + self.a * dt
        self._rotations, self._offsets = [self.attitude], list(tree.offsets)
        for i in range(1, tree.num_links):
            if i in tree.slides:
                self._rotations.append(cs.SX(tree.rotations[i]))
                self._offsets[i] = cs.SX(tree.offsets[i]) + q[6 + i] * (tree.rotations[i] @ tree.axes[i])
            else:
                self._rotations.append(_rotation(tree.rotations[i], tree.axes[i], q[6 + i]))

    def turn(self, link: int) -> cs.SX:
        """Return the rotation of a link's frame in its parent's, the base's in the world, (3, 3)."""
        return self._rotations[link]

    # ---- motion of the links, from the base to the feet

    def _angular(self, v: cs.SX) -> list[cs.SX]:
        """Return the angular velocity of every link at a velocity v."""
        omega = [v[3:6]]
        for i in range(1, self.tree.num_links):
            parent = self._rotations[i].T @ omega[self.tree.parents[i]]
            omega.append(parent if i in self.tree.slides else parent + self.tree.axes[i] * v[5 + i])
        return omega

    @cached_property
    def _omega(self) -> list[cs.SX]:
        return self._angular(self.v)

    @cached_property
    def _omega_next(self) -> list[cs.SX]:
        return self._omega if self.v_next is self.v else self._angular(self.v_next)

    @cached_property
    def _spin(self) -> list[cs.SX]:
        """Ω of every link, from its angular acceleration and velocity."""
        alpha, omega = [self.a[3:6]], self._omega
        omega_next = self._omega_next
        for i in range(1, self.tree.num_links):
            if i in self.tree.slides:
                alpha.append(self._rotations[i].T @ alpha[self.tree.parents[i]])
                continue
            axis = cs.SX(self.tree.axes[i])
            turning = cs.cross(omega[i], axis * self.v_next[5 + i])
            if omega_next is not omega:
                turning = 0.5 * (turning + cs.cross(omega_next[i], axis * self.v[5 + i]))
            parent = self._rotations[i].T @ alpha[self.tree.parents[i]]
            alpha.append(parent + axis * self.a[5 + i] + turning)
        return [_spin(*each) for each in zip(alpha, omega, omega_next, strict=True)]

    def _sliding(self, v: cs.SX) -> dict[int, cs.SX]:
        """Return the velocity of each prismatic joint in its link's frame, at a velocity v, by link."""
        return {i: self.tree.axes[i] * v[5 + i] for i in self.tree.slides}

    @cached_property
    def _sliding_faster(self) -> dict[int, cs.SX]:
        """Acceleration of each prismatic joint in its link's frame, with that of Coriolis 2 ω × v, by link."""
        faster = {}
        for i in self.tree.slides:
            axis = cs.SX(self.tree.axes[i])
            turning = 2 * cs.cross(self._omega[i], axis * self.v_next[5 + i])
            if self._omega_next is not self._omega:
                turning = 0.5 * (turning + 2 * cs.cross(self._omega_next[i], axis * self.v[5 + i]))
            faster[i] = axis * self.a[5 + i] + turning
        return faster

    def _origins(self, maps: list[cs.SX], sliding: Mapping[int, cs.SX]) -> list[cs.SX]:
        """Return the motion of every link's origin relative to the base origin, in the link's frame.

        Args:
            maps: per link, the matrix that maps a point fixed to the link to its motion relative to the link's origin,
                (3, 3): [ω×] for velocities, Ω for accelerations.
            sliding: motion of the prismatic joints in the frames of their links, (3, 1).
        """
        moved = [cs.SX.zeros(3)]
        for i in range(1, self.tree.num_links):
            parent = self.tree.parents[i]
            moved.append(self._rotations[i].T @ (moved[parent] + maps[parent] @ self._offsets[i]))
            if i in sliding:
                moved[i] += sliding[i]
        return moved

    # ---- points

    def _relative(self, point: Point) -> list[cs.SX]:
        """Return the point relative to the origin of each link on its path, in that link's frame, the base last."""
        arms = [cs.SX(point.offset)]
        for i in self.tree.path(point.link):
            arms.append(self._offsets[i] + self._rotations[i] @ arms[-1])
        return arms

    def _motion(self, point: Point, maps: list[cs.SX], sliding: Mapping[int, cs.SX]) -> cs.SX:
        """Return the motion of a point relative to the base origin, in base axes; arguments as in :meth:`_origins`."""
        motion, offset, link = cs.SX.zeros(3), point.offset, point.link
        for i in self.tree.path(point.link):
            motion = motion + maps[i] @ offset
            if i in sliding:
                motion += sliding[i]
            motion = self._rotations[i] @ motion
            offset, link = self._offsets[i], self.tree.parents[i]
        return motion + maps[link] @ offset

    def point(self, point: Point) -> cs.SX:
        """Return a point's world position, (3, 1) [m]."""
        return self.position + self.attitude @ self._relative(point)[-1]

    def velocity(self, point: Point) -> cs.SX:
        """Return a point's world velocity, (3, 1) [m/s]."""
        motion = self._motion(point, [cs.skew(w) for w in self._omega], self._sliding(self.v))
        return self.v[:3] + self.attitude @ motion

    def acceleration(self, point: Point, gamma: cs.SX | float = 0.0) -> cs.SX:
        """Return a point's world (classical) acceleration, plus γ times its velocity, (3, 1) [m/s²]."""
        v, omega = self.v, self._omega
        if self.v_next is not self.v:
            v = 0.5 * (v + self.v_next)
            omega = [0.5 * (w + w_next) for w, w_next in zip(omega, self._omega_next, strict=True)]
        maps = [spin + gamma * cs.skew(w) for spin, w in zip(self._spin, omega, strict=True)]
        slow = self._sliding(v)
        sliding = {i: faster + gamma * slow[i] for i, faster in self._sliding_faster.items()}
        return self.a[:3] + gamma * v[:3] + self.attitude @ self._motion(point, maps, sliding)

    def jacobian(self, point: Point) -> cs.SX:
        """Return J of a point: J v is its world velocity, (3, 6 + n); (3, n) with a fixed base."""
        arms, links = self._relative(point), self.tree.path(point.link)
        J = cs.SX(3, self.tree.num_links + 5)
        J[:, :3] = cs.SX.eye(3)
        J[:, 3:6] = -self.attitude @ cs.skew(arms[-1])
        turn = self.attitude
        for i, arm in reversed(list(zip(links, arms[:-1], strict=True))):
            turn = turn @ self._rotations[i]
            axis = cs.SX(self.tree.axes[i])
            J[:, 5 + i] = turn @ (axis if i in self.tree.slides else cs.cross(axis, arm))
        return J[:, _BASE:] if self.tree.fixed else J

    # ---- forces, from the feet to the base

    def _gather(
        self, maps: list[cs.SX], sliding: Mapping[int, cs.SX], body: Inertials
    ) -> tuple[list[cs.SX], list[cs.SX]]:
        """Return the inertial force of every link's subtree, and its moment about the link's origin.

        With ``maps`` and ``sliding`` of velocities these are momenta, see :meth:`_origins`.
        """
        moved = self._origins(maps, sliding)
        force, moment = [], []
        for m, h, second, e, spin in zip(body.mass, body.first, body.second, moved, maps, strict=True):
            force.append(m * e + spin @ h)
            moment.append(cs.cross(h, e) + _vee(spin @ second))
        for i in reversed(range(1, self.tree.num_links)):
            parent, pull = self.tree.parents[i], self._rotations[i] @ force[i]
            force[parent] += pull
            moment[parent] += self._rotations[i] @ moment[i] + cs.cross(cs.SX(self._offsets[i]), pull)
        return force, moment

    def _subtree_first(self, body: Inertials) -> tuple[list[cs.SX], list[cs.SX]]:
        """Return mass and first moment of every subtree about its root's origin."""
        mass, first = list(body.mass), list(body.first)
        for i in reversed(range(1, self.tree.num_links)):
            first[self.tree.parents[i]] += mass[i] * self._offsets[i] + self._rotations[i] @ first[i]
            mass[self.tree.parents[i]] += mass[i]
        return mass, first

    def inverse_dynamics(self, body: Inertials, gravity: cs.SX, forces: Sequence[tuple[Point, cs.SX]] = ()) -> cs.SX:
        """Return the generalised force of the accelerated motion, minus gravity and external forces on points.

        Args:
            body: inertial parameters of the links.
            gravity: world gravity, (3, 1) [m/s²].
            forces: points and the world force on each, (3, 1) [N].

        Returns:
            World force on the base, body torque about its origin, joint torques, (6 + n, 1); with a fixed base the
            last, (n, 1).
        """
        tree = self.tree
        own_force, moment = self._gather(self._spin, self._sliding_faster, body)
        mass, first = self._subtree_first(body)
        pull = [self.attitude.T @ (self.a[:3] - gravity)]
        for i in range(1, tree.num_links):
            pull.append(self._rotations[i].T @ pull[tree.parents[i]])
        moment = [n + cs.cross(h, g) for n, h, g in zip(moment, first, pull, strict=True)]
        linear = mass[0] * (self.a[:3] - gravity) + self.attitude @ own_force[0]
        along = {i: own_force[i] + mass[i] * pull[i] for i in tree.slides}
        for point, force in forces:
            linear -= force
            links = [*tree.path(point.link), 0]
            turned = {0: self.attitude.T @ force}
            for i in reversed(links[:-1]):
                turned[i] = self._rotations[i].T @ turned[tree.parents[i]]
            for i, arm in zip(links, self._relative(point), strict=True):
                moment[i] -= cs.cross(arm, turned[i])
                if i in along:
                    along[i] -= turned[i]
        return self._stacked(linear, moment, along)

    def weight(self, body: Inertials, gravity: cs.SX) -> cs.SX:
        """Return :meth:`inverse_dynamics` at rest; it needs masses and first moments alone."""
        tree, (mass, first) = self.tree, self._subtree_first(body)
        lift = [-self.attitude.T @ gravity]
        for i in range(1, tree.num_links):
            lift.append(self._rotations[i].T @ lift[tree.parents[i]])
        moment = [cs.cross(h, g) for h, g in zip(first, lift, strict=True)]
        return self._stacked(-mass[0] * gravity, moment, {i: mass[i] * lift[i] for i in tree.slides})

    def _stacked(self, linear: cs.SX, moment: list[cs.SX], along: Mapping[int, cs.SX]) -> cs.SX:
        """Return the generalised force of a world force on the base, moments of links, and forces of sliding ones."""
        axes, fixed = self.tree.axes, self.tree.fixed
        torques = [cs.dot(axes[i], along[i] if i in along else moment[i]) for i in range(1, self.tree.num_links)]
        return cs.vertcat(*torques) if fixed else cs.vertcat(linear, moment[0], *torques)

    # ---- sums over the tree

    def mass_matrix(self, body: Inertials) -> cs.SX:
        """Return the joint-space inertia M in the state's layout, (nv, nv), by composite rigid bodies."""
        tree, (mass, first), second = self.tree, self._subtree_first(body), list(body.second)
        for i in reversed(range(1, tree.num_links)):
            p, h = cs.SX(self._offsets[i]), self._rotations[i] @ first[i]
            shifted = self._rotations[i] @ second[i] @ self._rotations[i].T + p @ h.T + h @ p.T + mass[i] * p @ p.T
            second[tree.parents[i]] += shifted
        M = cs.SX(tree.num_links + 5, tree.num_links + 5)
        M[:3, :3] = mass[0] * cs.SX.eye(3)
        M[3:6, :3] = cs.skew(first[0]) @ self.attitude.T
        M[3:6, 3:6] = cs.trace(second[0]) * cs.SX.eye(3) - second[0]
        for i in range(1, tree.num_links):
            axis = cs.SX(tree.axes[i])
            if i in tree.slides:
                force, moment = mass[i] * axis, cs.cross(first[i], axis)
            else:
                force, moment = cs.cross(axis, first[i]), _vee(cs.skew(tree.axes[i]) @ second[i])
            for j in [*tree.path(i), 0]:
                if j:
                    M[5 + i, 5 + j] = M[5 + j, 5 + i] = cs.dot(tree.axes[j], force if j in tree.slides else moment)
                    force = self._rotations[j] @ force
                    moment = self._rotations[j] @ moment + cs.cross(cs.SX(self._offsets[j]), force)
            M[5 + i, :3], M[5 + i, 3:6] = (self.attitude @ force).T, moment.T
        lower = cs.tril(M, False)
        M = cs.tril(M) + lower.T
        return M[_BASE:, _BASE:] if tree.fixed else M

    def centre_of_mass(self, body: Inertials) -> cs.SX:
        """Return the world position of the centre of mass, (3, 1) [m]."""
        mass, first = self._subtree_first(body)
        return self.position + self.attitude @ (first[0] / mass[0])

    def momentum(self, body: Inertials) -> tuple[cs.SX, cs.SX]:
        """Return world momentum [kg m/s] and world angular momentum about the centre of mass [kg m²/s], (3, 1) each."""
        mass, first = self._subtree_first(body)
        relative, moment = self._gather([cs.skew(w) for w in self._omega], self._sliding(self.v), body)
        about_com = moment[0] - cs.cross(first[0] / mass[0], relative[0])
        return mass[0] * self.v[:3] + self.attitude @ relative[0], self.attitude @ about_com


def _rotation(placed: Array, axis: Array, angle: cs.SX) -> cs.SX:
    """Return the rotation of a link's frame in its parent's, (3, 3)."""
    along, across = np.outer(axis, axis), np.cross(np.eye(3), axis)
    parts = [cs.SX(placed @ part) for part in (along, np.eye(3) - along, across)]
    return parts[0] + cs.cos(angle) * parts[1] + cs.sin(angle) * parts[2]


def _spin(alpha: cs.SX, omega: cs.SX, omega_next: cs.SX) -> cs.SX:
    """Return Ω = [α×] + [ω×]², (3, 3); the square is ½ ([ω×] [ω⁺×] + [ω⁺×] [ω×]) of two velocities."""
    (x, y, z), (u, v, w) = cs.vertsplit(omega), cs.vertsplit(omega_next)
    xx, yy, zz = x * u, y * v, z * w
    if omega_next is omega:
        xy, xz, yz = x * y, x * z, y * z
    else:
        xy, xz, yz = 0.5 * (x * v + y * u), 0.5 * (x * w + z * u), 0.5 * (y * w + z * v)
    a, b, c = cs.vertsplit(alpha)
    return stack([[-(yy + zz), xy - c, xz + b], [xy + c, -(xx + zz), yz - a], [xz - b, yz + a, -(xx + yy)]])


def _vee(moment: cs.SX) -> cs.SX:
    """Return ∫ r × (Ω r) dm from Ω Σ, (3, 1)."""
    return cs.vertcat(moment[2, 1] - moment[1, 2], moment[0, 2] - moment[2, 0], moment[1, 0] - moment[0, 1])
