"""Hold a robot at rest: contact forces that carry its weight, and joint torques with them; for the initial guess."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property

import casadi as cs
import numpy as np
from numpy.typing import NDArray

from piaffe.ocp import Vectorised

from .recursions import Recursion
from .tree import Inertials, Point, Tree

Array = NDArray[np.float64]

_RIDGE = 1e-10
"""Added to the normal equations, relative to their trace, so that wrenches that no forces give need no case."""
_SLOTS = ("gravity", "link_mass", "link_com")


def holding_forces(maps: Array, contact: Array, wrench: Array, length: float = 1.0) -> Array:
    """Return the smallest contact forces that give a wrench on the base, or come nearest to it, (N, 3 nf) [N].

    Per node, F minimises ``|G S F − w|``, and among the minimisers |F|, with the 0/1 flags S of the feet on the
    ground. A foot that would pull on the ground is taken out, the one that pulls most first.

    Args:
        maps: G, maps forces to the wrench, (N, 6, 3 nf): first the force [N], then the moment [Nm].
        contact: 1 for feet on the ground, 0 for feet in the air, (N, nf).
        wrench: w, (N, 6).
        length: moments count in newtons times this length [m].
    """
    on = contact > 0
    if length != 1.0:
        units = np.array([1.0, 1.0, 1.0, length, length, length])
        maps, wrench = maps / units[:, None], wrench / units
    while True:
        acting = maps * np.repeat(on, 3, axis=1)[:, None, :]
        normal = acting @ acting.swapaxes(1, 2)
        size = np.trace(normal, axis1=1, axis2=2)
        normal += (_RIDGE * np.where(size > 0, size, 1.0))[:, None, None] * np.eye(6)
        inverse = acting.swapaxes(1, 2) @ np.linalg.inv(normal)
        forces = inverse @ wrench[:, :, None]
        forces = (forces + inverse @ (wrench[:, :, None] - acting @ forces))[..., 0]  # takes out the ridge's error
        vertical = np.where(on, forces[:, 2::3], 0.0)
        pulls = vertical.min(axis=1, initial=0.0) < 0
        if not pulls.any():
            return forces
        on[pulls, vertical.argmin(axis=1)[pulls]] = False


class Holding:
    """Joint torques with which a tree stands still on its feet.

    Without motion the generalised force of the weight is n, and J maps v to the velocities of the feet. The base needs
    ``J_bᵀ F = n_b`` of the forces F of the feet on the ground. The torques are ``τ = n_j − J_jᵀ F``.

    Args:
        tree: the tree.
        contacts: the contact points of its feet.
        length: see :func:`holding_forces`.
    """

    def __init__(self, tree: Tree, contacts: tuple[Point, ...], length: float = 1.0) -> None:
        self.tree, self.contacts, self.length = tree, contacts, length

    def torques(self, q: Array, contact: Array, p: Mapping[str, Array]) -> Array:
        """Return the torques at N nodes, (N, n) [Nm]; zero in flight of a base that floats.

        Args:
            q: configurations, (N, nq).
            contact: 1 for feet on the ground, 0 for feet in the air, (N, nf).
            p: gravity and inertial parameters, as in the slots of the whole body, (N, size) each.
        """
        torques, standing = np.zeros((len(q), self.tree.num_links - 1)), contact.any(axis=1) | self.tree.fixed
        if not standing.any():
            return torques
        parts = [each[standing] for each in (q, *(p[name] for name in _SLOTS), contact)]
        table = np.hstack(parts)
        new = np.append(True, np.any(table[1:] != table[:-1], axis=1))  # equal nodes in a row are computed once
        *inputs, flags = (part[new] for part in parts)
        load, jacobian = self._function(*inputs)
        if self.tree.fixed:  # the base carries the weight
            torques[standing] = load[np.cumsum(new) - 1]
            return torques
        transposed = jacobian.swapaxes(1, 2)
        forces = holding_forces(transposed[:, :6], flags, load[:, :6], self.length)
        joints = load[:, 6:] - (transposed[:, 6:] @ forces[:, :, None])[..., 0]
        torques[standing] = joints[np.cumsum(new) - 1]
        return torques

    @cached_property
    def _function(self) -> Vectorised:
        """The load n and the Jacobian J at rest, of q and the slots."""
        tree, q, gravity = self.tree, cs.SX.sym("q", self.tree.nq), cs.SX.sym("gravity", 3)
        mass, com = cs.SX.sym("link_mass", tree.num_links), cs.SX.sym("link_com", 3 * tree.num_links)
        masses, centres = cs.vertsplit(mass), cs.vertsplit(com, 3)
        body = Inertials(masses, [m * c for m, c in zip(masses, centres, strict=True)], [])
        rest = Recursion(tree, q)
        load, jacobian = rest.weight(body, gravity), cs.vertcat(cs.SX(0, tree.nv), *map(rest.jacobian, self.contacts))
        names = ["q", *_SLOTS], ["load", "jacobian_x"]
        return Vectorised(cs.Function("holding", [q, gravity, mass, com], [load, jacobian], *names))
