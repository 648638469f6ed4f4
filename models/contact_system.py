"""The linear systems of a whole body in contact: acceleration and forces, velocity after an impact and impulses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import casadi as cs

from .bindings import inertials
from .joint_losses import loss_torque
from .recursions import Recursion
from .tree import Point, Tree


def _on_contacts(z: cs.SX, nv: int, flags: cs.SX) -> tuple[list[cs.SX], list[cs.SX]]:
    """Return the forces (or impulses) in z = (a, F), (3, 1) per foot, and those that act, which flags multiply."""
    forces = [z[nv + 3 * i : nv + 3 * i + 3] for i in range(flags.numel())]
    return forces, [flags[i] * force for i, force in enumerate(forces)]


def _on_joints(tree: Tree, torque: cs.SX) -> cs.SX:
    """Return joint torques as a generalised force, (nv, 1)."""
    return torque if tree.fixed else cs.vertcat(cs.SX(6, 1), torque)


def contact_residual(
    motion: Recursion,
    contacts: Sequence[Point],
    u: cs.SX,
    z: cs.SX,
    dt: cs.SX,
    p: Mapping[str, cs.SX],
    inertia: float = 1.0,
) -> tuple[cs.SX, list[cs.SX]]:
    """Return the residual of the contact dynamics, (nv + 3 nf, 1), and the forces that act on the feet, (3, 1) each.

    The equations are those of :class:`~piaffe.models.WholeBody`.

    Args:
        motion: the recursion at the state and the acceleration a of z.
        contacts: the points of the feet.
        u: joint torques, (n, 1), zero for passive joints.
        z: acceleration and contact forces, (nv + 3 nf, 1).
        dt: time step [s]; 0 for the continuous dynamics.
        p: the slots of the whole body.
        inertia: natural size of an inertia [kg m²].
    """
    nv = motion.tree.nv
    forces, acting = _on_contacts(z, nv, p["contact"])
    effort = motion.inverse_dynamics(inertials(p), p["gravity"], list(zip(contacts, acting, strict=True)))
    own = motion.a[6:]
    losses = loss_torque(motion.v[6:], own, dt, p, inertia)
    effort += _on_joints(motion.tree, p["armature"] * own + losses - u)
    rows = []
    for i, (point, force) in enumerate(zip(contacts, forces, strict=True)):
        on = p["contact"][i]
        slip = motion.acceleration(point, p["gamma"]) + p["contact_damping"] * force
        rows.append(on * slip + (1 - on) * force)
    return cs.vertcat(effort, *rows), acting


def impact_residual(
    tree: Tree, contacts: Sequence[Point], q: cs.SX, v: cs.SX, z: cs.SX, p: Mapping[str, cs.SX]
) -> cs.SX:
    """Return the residual of an inelastic impact, (nv + 3 nf, 1); see :meth:`~piaffe.models.WholeBody.reset`.

    Damping and friction of the joints have no part in it: their torques are finite, and the impact takes no time.

    Args:
        tree: the tree.
        contacts: the points of the feet.
        q: configuration, (nq, 1).
        v: velocity before the impact, (nv, 1).
        z: velocity after it, and the impulses, (nv + 3 nf, 1).
        p: the slots of the whole body.
    """
    v_next = z[: tree.nv]
    impulses, acting = _on_contacts(z, tree.nv, p["impact"])
    jump = Recursion(tree, q, None, v_next - v)
    effort = jump.inverse_dynamics(inertials(p), cs.SX(3, 1), list(zip(contacts, acting, strict=True)))
    effort += _on_joints(tree, p["armature"] * jump.a[6:])
    after = Recursion(tree, q, v_next)
    rows = []
    for i, (point, impulse) in enumerate(zip(contacts, impulses, strict=True)):
        on = p["impact"][i]
        rows.append(on * (after.velocity(point) + p["contact_damping"] * impulse) + (1 - on) * impulse)
    return cs.vertcat(effort, *rows)
