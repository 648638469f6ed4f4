"""Linear parts of expressions: K and r0 of an implicit part, and Jacobians by the tangent of a state."""

from __future__ import annotations

import casadi as cs

from piaffe.errors import ProblemError, ShapeError

from ..language import Manifold


def affine(implicit: cs.SX, z: cs.SX, where: str) -> tuple[cs.SX, cs.SX]:
    """Return K and r0 of r = r0 + K z; raise if r is not affine in z."""
    if z.numel() != implicit.numel():
        raise ShapeError(
            f"{where}: implicit part has the wrong size - got {implicit.numel()} rows, expected {z.numel()}; return "
            "one row per entry of z"
        )
    K = cs.jacobian(implicit, z)
    if z.numel() and cs.depends_on(K, z):
        raise ProblemError(
            f"{where}: the implicit part is not affine in z - got a Jacobian that depends on z, expected one that does "
            "not; write it as r0 + K z"
        )
    return K, cs.substitute(implicit, z, cs.SX.zeros(z.numel()))


def tangent_jacobians(
    groups: list[cs.SX], state: Manifold, x: cs.SX, dx: cs.SX, u: cs.SX, z: cs.SX
) -> tuple[list[cs.SX], list[cs.SX]]:
    """Return the Jacobians of each group by w = (δx, u) and by z, at x ⊕ δx with δx = 0."""
    nudged = cs.substitute(cs.vertcat(*groups), x, state.nudge(x, dx))
    J = cs.substitute(cs.jacobian(nudged, cs.vertcat(dx, u, z)), dx, cs.SX.zeros(dx.numel()))
    nw = dx.numel() + u.numel()
    by_w, by_z, first = [], [], 0
    for group in groups:
        part = J[first : first + group.numel(), :]
        by_w.append(part[:, :nw])
        by_z.append(part[:, nw:])
        first += group.numel()
    return by_w, by_z
