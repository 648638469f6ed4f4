"""The whole-body model: every link and joint; accelerations and contact forces are solved for together."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Literal

import casadi as cs
import numpy as np
from numpy.typing import NDArray

from piaffe.ocp import (
    Block,
    Bound,
    Dynamics,
    Invariants,
    Manifold,
    Node,
    Quantities,
    Reset,
    SplitStep,
)

from . import natural
from ._numeric import NumericWholeBody
from .bindings import absent_quantities, bind_motion, foot_points, frame_points, in_contact_axes, stacked
from .contact_system import contact_residual, impact_residual
from .ground import declared_ground, ground_slots
from .integrators import INTEGRATORS, Integrator, begun, checked_integrator, feet_follow_stance, finished, integrate
from .joint_losses import FRICTION_SPEED
from .legged import state_blocks
from .postures import foot_labels
from .quantities import feet, joints
from .recursions import Recursion
from .redundant_contacts import refuse_redundant_contacts
from .robot import Robot, require_robot
from .terrain import Terrain, checked_terrain
from .tree import Tree
from .whole_body_checks import SLOT_CHECKS, check_numbers, require_motors

Array = NDArray[np.float64]
Impact = Literal["contact", "landing"]

_GAMMA = 20.0  # Baumgarte's γ [1/s], as published
_ONLY_AT_IMPACTS = 'it exists for terms with at="phase_end", at the end of a phase whose next one lands feet'
_OF_RESETS = (feet.impulse.path, feet.contact_impulse.path)
_OF_STAGES = (feet.force.path, feet.contact_force.path, joints.torque.path, joints.acceleration.path)


class WholeBody(NumericWholeBody):
    """Whole-body dynamics with rigid contacts, as an implicit system in acceleration and contact force.

    With 0/1 flags S of the feet on the ground, z = (a, F) solves::

        M a + n + B τ(q̇) − Jᵀ S F = B u
        S (J a + J̇ v + γ J v + d F) + (I − S) F = 0

    where γ [1/s] (Baumgarte) reduces a foot's velocity to zero and d is the compliance ``contact_damping``.
    With a fixed base q and v are those of the joints alone. Passive joints have no entry in u.
    M holds the rotors' inertia, τ is the torque of damping and dry friction of the joints, at the mean velocity of a
    step, see :func:`~piaffe.models.joint_losses.loss_torque`.
    Acceleration and generalised force are in the state's layout: world linear, body angular, joints.

    Args:
        robot: the robot.
        baumgarte: γ [1/s]. By default 20, as published; in midpoint steps 2/dt, at most 200: a step then removes
            the velocity of a standing foot. 20 and 200 are divided by the robot's natural time, see
            ``sizes``: 1 for robots of 1.4 to 49 kg.
        integrator: how a step moves positions; velocities become v⁺ = v + a dt. ``"midpoint"``: ``(q ⊕ ½ v dt) ⊕ ½ v⁺
            dt``, with the dynamics in the middle and squares of velocities as products of v and v⁺; it is of second
            order. ``"euler"``: ``q ⊕ v dt``, as published. ``"semi_implicit"``: ``q ⊕ v⁺ dt``; standing feet drift as
            with Euler, and limits on positions are harder to keep.
        contact_damping: d [1/kg], needed if contact points are redundant; None for rigid contacts.
        impact: which feet take part in an impact. ``"contact"``: every foot of the following contact set, so that feet
            that stand before and after are held; ``"landing"``: only the feet that land, as published.
        terrain: the ground, see :mod:`piaffe.models.terrain`; level at z = 0 by default. Where a foot stands, and on
            which plane, follows from the reference of the motion; see :class:`~piaffe.models.footing.Footing`.
        friction_speed: speed v₀ over which dry friction of the joints changes its sign, q̇ / √(q̇² + v₀²) [rad/s]; None:
            0.3 rad/s, divided by the natural time.
        name: name of the model; the robot's by default.

    Raises:
        ModelError: a number is out of range, or contact points are redundant, and there is no ``contact_damping``.
    """

    def __init__(
        self,
        robot: Robot,
        *,
        baumgarte: float | None = None,
        integrator: Integrator = "midpoint",
        contact_damping: float | None = None,
        impact: Impact = "contact",
        friction_speed: float | None = None,
        terrain: Terrain | None = None,
        name: str | None = None,
    ) -> None:
        require_robot(robot, "models.WholeBody")
        chosen = checked_integrator(integrator, INTEGRATORS, f"whole body of '{robot.name}'")
        time = natural.sizes(robot).time
        gamma = _GAMMA / time if baumgarte is None else baumgarte
        friction_speed = FRICTION_SPEED / time if friction_speed is None else friction_speed
        check_numbers(robot, baumgarte, contact_damping, impact, friction_speed)
        require_motors(robot)
        tree, nf = Tree.from_pinocchio(robot.model, fixed=robot.base == "fixed"), len(robot.feet)
        ground = checked_terrain(terrain, "models.WholeBody")
        slots = {
            "contact": np.zeros(nf),
            "landing": np.zeros(nf),
            "lifting": np.zeros(nf),
            "impact": np.zeros(nf),
            **ground_slots(ground, nf),
            "foot_radius": robot.foot_radius,
            "gamma": gamma,
            "contact_damping": contact_damping or 0.0,
            "gravity": robot.model.gravity.linear,
            "link_mass": tree.mass,
            "link_com": tree.com,
            "link_inertia": tree.inertia,
            "armature": robot.armature,
            "joint_damping": robot.joint_damping,
            "joint_friction": robot.joint_friction,
            "friction_speed": friction_speed,
        }
        control, blocks = Manifold((Block(joints.torque, robot.motor_names),)), state_blocks(robot)
        super().__init__(
            robot, name or robot.name, blocks, control, slots=slots, positive=("friction_speed",), checks=SLOT_CHECKS,
            terrain=ground,
        )  # fmt: skip
        self.integrator = chosen
        self.impact_rule: Impact = impact
        self._baumgarte = None if baumgarte is None and chosen == "midpoint" else gamma
        self.tree = tree
        self._points = frame_points(robot)
        self.contacts = foot_points(robot, self._points)
        if contact_damping is None and robot.feet:
            rng, stand = np.random.default_rng(0), robot.pose("stand")
            postures = [self.state(joints=stand + 0.3 * rng.standard_normal(len(stand))) for _ in range(3)]
            refuse_redundant_contacts(robot, [self.contact_jacobian(x) for x in postures])

    def node_parameters(self, node: Node) -> dict[str, Array]:
        """Return the slots of a legged model, ``gamma`` if it follows the time step, and ``impact``.

        ``impact`` is 1 for the feet of the impact at this phase end, (nf,).
        """
        values = super().node_parameters(node)
        landing = values["landing"]
        holds = self.impact_rule == "contact" and landing.any()
        values["impact"] = self._standing(node.next_mode) if holds else landing
        if self._baumgarte is None and node.dt > 0:
            values["gamma"] = np.array([self.gamma(node.dt)])
        return values

    @property
    def nodes_after_liftoff(self) -> int:
        """2 with Euler's step, 1 with the others: they use the swing's first velocity."""
        return feet_follow_stance(self.integrator)

    def recipe(self) -> dict[str, object]:
        """Return the kind of model, the robot, and the integrator."""
        return {**super().recipe(), "integrator": self.integrator}

    # ---- expressions

    def dynamics(self, key: str, x: cs.SX, u: cs.SX, z: cs.SX, p: Mapping[str, cs.SX]) -> Dynamics:
        """Return the contact dynamics, the same for every contact set; see the class."""
        nq, nv, dt = self.nq, self.nv, p["dt"]
        at = x if self.integrator == "euler" else cs.SX.sym("m", self.state.nx)
        q, v, a = at[:nq], at[nq:], z[:nv]
        # the square of a velocity is linear in a if it is the product of the velocities before and after the step
        motion = Recursion(self.tree, q, v, a, dt if self.integrator == "midpoint" else None)
        residual, acting = contact_residual(
            motion, self.contacts, self.joint_torques(u), z, dt, p, self.sizes.of("kg m^2")
        )
        v_next = v + a * dt
        node = motion if at is x else Recursion(self.tree, x[:nq], x[nq:], a)
        absent = {**dict.fromkeys(_OF_RESETS, _ONLY_AT_IMPACTS), **absent_quantities(self.robot)}
        quantities = Quantities(self.name, self._makers(node, x, u, acting, p), absent)
        if at is x:
            return Dynamics(
                residual, cs.vertcat(integrate(q, v, dt), v_next), quantities, outputs=(feet.force, *self._recorded)
            )
        step = self.integrator
        begin = begun(step, x, nv, dt)
        split = SplitStep(at, begin, residual, cs.vertcat(q, v_next), lambda w: finished(step, w, nv, dt))
        return split.dynamics(quantities, outputs=(feet.force, *self._recorded))

    def reset(self, key: str, x: cs.SX, z: cs.SX, p: Mapping[str, cs.SX]) -> Reset:
        """Return the inelastic impact at a phase's end; the configuration does not change.

        With 0/1 flags L of the feet that take part (see the class), z = (v⁺, Λ) solves::

            M (v⁺ − v) − Jᵀ L Λ          = 0
            L (J v⁺ + d Λ) + (I − L) Λ   = 0
        """
        nq, nv = self.nq, self.nv
        q, v, v_next = x[:nq], x[nq:], z[:nv]
        residual = impact_residual(self.tree, self.contacts, q, v, z, p)
        ground = declared_ground(self.terrain, p)
        makers = bind_motion(self.robot, self._points, Recursion(self.tree, q, v), x, p, ground)
        lands = stacked([cs.repmat(p["landing"][i], 3, 1) for i in range(self.num_feet)])
        makers.supply(feet.impulse, foot_labels(self.robot), lambda: z[nv:], lands)
        makers.supply(feet.contact_impulse, foot_labels(self.robot), lambda: in_contact_axes(ground, z[nv:]), lands)
        absent = dict.fromkeys(_OF_STAGES, "there is no control at the end of a phase")
        absent |= absent_quantities(self.robot)
        quantities = Quantities(self.name, makers, absent)
        return Reset(residual, cs.vertcat(q, v_next), quantities, (feet.impulse, feet.landing, *self._recorded))

    def switching(self, key: str, quantities: Quantities, p: Mapping[str, cs.SX]) -> Bound:
        """Return the heights of the feet, with the landing feet as mask."""
        return self.landing_heights(quantities, p)

    def invariants(self, key: str, quantities: Quantities, p: Mapping[str, cs.SX]) -> Invariants:
        """Return that feet on the ground do not move, and that the centre of mass falls freely if none is there."""
        falls = () if self.tree.fixed else (self.ballistic_centre(quantities, p),)
        return Invariants(self.standing_points(quantities, p), falls)

    def _makers(
        self, motion: Recursion, x: cs.SX, u: cs.SX, forces: list[cs.SX], p: Mapping[str, cs.SX]
    ) -> dict[str, Callable[[], Bound]]:
        """Return the functions that make the quantities."""
        on_each = stacked([cs.repmat(p["contact"][i], 3, 1) for i in range(self.num_feet)])
        ground = declared_ground(self.terrain, p)
        makers = bind_motion(self.robot, self._points, motion, x, p, ground)
        makers.supply(joints.acceleration, self.robot.joint_names, lambda: motion.a[6:])
        makers.supply(joints.torque, self.robot.motor_names, lambda: u)
        makers.supply(feet.force, foot_labels(self.robot), lambda: stacked(forces), on_each)
        makers.supply(
            feet.contact_force, foot_labels(self.robot), lambda: in_contact_axes(ground, stacked(forces)), on_each
        )
        return makers
