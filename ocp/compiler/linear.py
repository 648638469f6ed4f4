"""Linear parts of expressions: K and r0 of an implicit part, and Jacobians by the tangent of a state."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as cs

from piaffe.errors import ProblemError, ShapeError

from ..language import Manifold, SplitStep


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


@dataclass(frozen=True)
class SplitJacobians:
    """Derivatives of a step in parts: of d = x⁺ ⊖ xn by (δx, u) is ``finish @ first_w``, by z likewise.

    Args:
        r_w: of the implicit part by (δx, u).
        first_w: of what :attr:`SplitStep.first` makes, in its tangent space, by (δx, u).
        first_z: of the same by z.
        finish: of d by that tangent.
    """

    r_w: cs.SX
    first_w: cs.SX
    first_z: cs.SX
    finish: cs.SX

    @property
    def of_defect(self) -> dict[str, cs.SX]:
        """The factors of the derivative of d."""
        return {"first_w": self.first_w, "first_z": self.first_z, "finish": self.finish}


def split_jacobians(
    step: SplitStep, state: Manifold, x: cs.SX, xn: cs.SX, u: cs.SX, z: cs.SX, where: str
) -> SplitJacobians:
    """Return the derivatives of a step in parts, as expressions of (x, u, z, p, xn).

    Raises:
        ProblemError: a part depends on a state that is not its own.
    """
    middle, between, dx, nothing = step.middle, cs.SX.sym("between", state.nx), cs.SX.sym("dx", state.ndx), cs.SX(0, 1)
    end = step.finish(between)
    for part, expression, others in (
        ("begin", step.begin, cs.vertcat(middle, u, z)),
        ("residual and first", cs.vertcat(step.residual, step.first), x),
        ("finish", end, cs.vertcat(x, middle, u, z)),
    ):
        if cs.depends_on(expression, others):
            raise ProblemError(
                f"{where}: '{part}' of the step in parts depends on more than its own state - got an expression of "
                "another part's symbols, expected what ocp.SplitStep says of this part; move it to that part"
            )
    (begin,), _ = tangent_jacobians([state.minus_near(step.begin, middle)], state, x, dx, nothing, nothing)
    by_w, by_z = tangent_jacobians([step.residual, state.minus_near(step.first, between)], state, middle, dx, u, z)
    (finish,), _ = tangent_jacobians([state.minus(end, xn)], state, between, dx, nothing, nothing)
    chained = [cs.horzcat(part[:, : state.ndx] @ cs.sparsify(begin), part[:, state.ndx :]) for part in by_w]
    parts = cs.substitute([*chained, by_z[1], finish], [between], [step.first])
    return SplitJacobians(*map(cs.sparsify, cs.substitute(parts, [middle], [step.begin])))
