"""The whole-body model: every link and joint; accelerations and contact forces are solved for together."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Literal

import casadi as cs
import numpy as np
from numpy.typing import NDArray

from piaffe.errors import ModelError
from piaffe.ocp import (
    Block,
    Bound,
    ContactPoint,
    Dynamics,
    Invariants,
    Manifold,
    Node,
    Quantities,
    Reset,
    SplitStep,
)

from ._numeric import NumericWholeBody
from .bindings import bind_motion, foot_points, frame_points, inertials
from .integrators import INTEGRATORS, Integrator, begun, checked_integrator, feet_follow_stance, finished, integrate
from .legged import POSE_BLOCKS, VELOCITY_BLOCKS
from .postures import foot_labels
from .quantities import feet, joints
from .recursions import Recursion
from .robot import Robot, require_robot
from .terrain import Flat
from .tree import Tree

Array = NDArray[np.float64]
Impact = Literal["contact", "landing"]

_GAMMA = 20.0  # Baumgarte's γ [1/s], as published
_ONLY_AT_IMPACTS = 'it exists for terms with at="phase_end", at the end of a phase whose next one lands feet'
_OF_STAGES = (feet.force.path, joints.torque.path, joints.acceleration.path)


class WholeBody(NumericWholeBody):
    """Whole-body dynamics with rigid contacts, as an implicit system in acceleration and contact force.

    With 0/1 flags S of the feet on the ground, z = (a, F) solves::

        M a + n − Jᵀ S F          = B u
        S (J a + J̇ v + γ J v + d F) + (I − S) F = 0

    where γ [1/s] (Baumgarte) reduces a foot's velocity to zero and d is the compliance ``contact_damping``.
    Acceleration and generalised force are in the state's layout: world linear, body angular, joints.

    Args:
        robot: the robot.
        baumgarte: γ [1/s]. By default 20, as published; in midpoint steps 2/dt, at most 200: a step then removes
            the velocity of a standing foot.
        integrator: how a step moves positions; velocities become v⁺ = v + a dt. ``"midpoint"``: ``(q ⊕ ½ v dt) ⊕ ½ v⁺
            dt``, with the dynamics in the middle and squares of velocities as products of v and v⁺; it is of second
            order. ``"euler"``: ``q ⊕ v dt``, as published. ``"semi_implicit"``: ``q ⊕ v⁺ dt``; standing feet drift as
            with Euler, and limits on positions are harder to keep.
        contact_damping: d [1/kg], needed if contact points are redundant; None for rigid contacts.
        impact: which feet take part in an impact. ``"contact"``: every foot of the following contact set, so that feet
            that stand before and after are held; ``"landing"``: only the feet that land, as published.
        name: name of the model; the robot's by default.

    Raises:
        ModelError: contact points are redundant, and there is no ``contact_damping``.
    """

    def __init__(
        self,
        robot: Robot,
        *,
        baumgarte: float | None = None,
        integrator: Integrator = "midpoint",
        contact_damping: float | None = None,
        impact: Impact = "contact",
        name: str | None = None,
    ) -> None:
        require_robot(robot, "models.WholeBody")
        chosen = checked_integrator(integrator, INTEGRATORS, f"whole body of '{robot.name}'")
        gamma = _GAMMA if baumgarte is None else baumgarte
        if not (isinstance(gamma, int | float | np.floating) and 0 <= gamma < np.inf):
            raise ModelError(
                f"whole body of '{robot.name}': baumgarte is out of range - got {baumgarte!r}, expected a finite "
                "number ≥ 0 [1/s]; change it"
            )
        if contact_damping is not None and not contact_damping > 0:
            raise ModelError(
                f"whole body of '{robot.name}': contact_damping is out of range - got {contact_damping}, expected a "
                "positive number [1/kg]; leave it out for rigid contacts"
            )
        if impact not in ("contact", "landing"):
            raise ModelError(
                f"whole body of '{robot.name}': impact is unknown - got {impact!r}, expected 'contact' or 'landing'; "
                "choose one"
            )
        tree, nf = Tree.from_pinocchio(robot.model), len(robot.feet)
        slots = {
            "contact": np.zeros(nf),
            "landing": np.zeros(nf),
            "lifting": np.zeros(nf),
            "impact": np.zeros(nf),
            "terrain": 0.0,
            "foot_radius": robot.foot_radius,
            "gamma": gamma,
            "contact_damping": contact_damping or 0.0,
            "gravity": robot.model.gravity.linear,
            "link_mass": tree.mass,
            "link_com": tree.com,
            "link_inertia": tree.inertia,
            "armature": robot.armature,
        }
        positions = (*POSE_BLOCKS, Block(joints.position, robot.joint_names))
        velocities = (*VELOCITY_BLOCKS, Block(joints.velocity, robot.joint_names, rate_of=joints.position))
        control = Manifold((Block(joints.torque, robot.joint_names),))
        super().__init__(robot, name or robot.name, (*positions, *velocities), control, slots=slots)
        self.integrator = chosen
        self.impact_rule: Impact = impact
        self._baumgarte = None if baumgarte is None and chosen == "midpoint" else gamma
        self.tree = tree
        self._points = frame_points(robot)
        self.contacts = foot_points(robot, self._points)
        if contact_damping is None:
            self._refuse_redundant_contacts()

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

    # ---- sizes

    @property
    def nq(self) -> int:
        """Number of stored positions; one more than ``nv``, because of the quaternion."""
        return self.tree.nv + 1

    @property
    def nv(self) -> int:
        """Number of velocities."""
        return self.tree.nv

    def implicit_size(self, key: str) -> int:
        """Return nv + 3 nf: acceleration and contact forces."""
        return self.nv + 3 * self.num_feet

    def reset_size(self, key: str) -> int:
        """Return nv + 3 nf: velocity after an impact, and its impulses."""
        return self.nv + 3 * self.num_feet

    def definite_size(self, key: str) -> int:
        """Return nv, the size of the mass matrix, which is positive definite."""
        return self.nv

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
        body, forces = inertials(p), [z[nv + 3 * i : nv + 3 * i + 3] for i in range(self.num_feet)]
        # the square of a velocity is linear in a if it is the product of the velocities before and after the step
        motion = Recursion(self.tree, q, v, a, dt if self.integrator == "midpoint" else None)
        acting = [p["contact"][i] * force for i, force in enumerate(forces)]
        effort = motion.inverse_dynamics(body, p["gravity"], list(zip(self.contacts, acting, strict=True)))
        effort += cs.vertcat(cs.SX(6, 1), p["armature"] * a[6:] - u)
        rows = []
        for i, (point, force) in enumerate(zip(self.contacts, forces, strict=True)):
            on = p["contact"][i]
            slip = motion.acceleration(point, p["gamma"]) + p["contact_damping"] * force
            rows.append(on * slip + (1 - on) * force)
        residual, v_next = cs.vertcat(effort, *rows), v + a * dt
        node = motion if at is x else Recursion(self.tree, x[:nq], x[nq:], a)
        absent = {feet.impulse.path: _ONLY_AT_IMPACTS}
        quantities = Quantities(self.name, self._makers(node, x, u, acting, p), absent)
        if at is x:
            return Dynamics(residual, cs.vertcat(integrate(q, v, dt), v_next), quantities, outputs=(feet.force,))
        step = self.integrator
        begin = begun(step, x, nv, dt)
        split = SplitStep(at, begin, residual, cs.vertcat(q, v_next), lambda w: finished(step, w, nv, dt))
        return split.dynamics(quantities, outputs=(feet.force,))

    def reset(self, key: str, x: cs.SX, z: cs.SX, p: Mapping[str, cs.SX]) -> Reset:
        """Return the inelastic impact at a phase's end; the configuration does not change.

        With 0/1 flags L of the feet that take part (see the class), z = (v⁺, Λ) solves::

            M (v⁺ − v) − Jᵀ L Λ          = 0
            L (J v⁺ + d Λ) + (I − L) Λ   = 0
        """
        nq, nv = self.nq, self.nv
        q, v, v_next = x[:nq], x[nq:], z[:nv]
        impulses = [z[nv + 3 * i : nv + 3 * i + 3] for i in range(self.num_feet)]
        acting = [p["impact"][i] * impulse for i, impulse in enumerate(impulses)]
        jump = Recursion(self.tree, q, None, v_next - v)
        effort = jump.inverse_dynamics(inertials(p), cs.SX(3, 1), list(zip(self.contacts, acting, strict=True)))
        effort += cs.vertcat(cs.SX(6, 1), p["armature"] * (v_next - v)[6:])
        after = Recursion(self.tree, q, v_next)
        rows = []
        for i, (point, impulse) in enumerate(zip(self.contacts, impulses, strict=True)):
            on = p["impact"][i]
            rows.append(on * (after.velocity(point) + p["contact_damping"] * impulse) + (1 - on) * impulse)
        makers = bind_motion(self.robot, self._points, Recursion(self.tree, q, v), x, p, Flat(p["terrain"]))
        lands = cs.vertcat(*(cs.repmat(p["landing"][i], 3, 1) for i in range(self.num_feet)))
        makers.supply(feet.impulse, foot_labels(self.robot), lambda: z[nv:], lands)
        absent = dict.fromkeys(_OF_STAGES, "there is no control at the end of a phase")
        quantities, outputs = Quantities(self.name, makers, absent), (feet.impulse, feet.landing)
        return Reset(cs.vertcat(effort, *rows), cs.vertcat(q, v_next), quantities, outputs)

    def switching(self, key: str, quantities: Quantities, p: Mapping[str, cs.SX]) -> Bound:
        """Return the heights of the feet, with the landing feet as mask."""
        height = quantities.bind(feet.height)
        return Bound(height.quantity, height.value, height.labels, mask=p["landing"])

    def invariants(self, key: str, quantities: Quantities, p: Mapping[str, cs.SX]) -> Invariants:
        """Return that feet on the ground do not move, and that the centre of mass falls freely if none is there."""
        place, height = (quantities.bind(each).value for each in (feet.position, feet.height))
        contacts = tuple(
            ContactPoint(name, p["contact"][i], place[3 * i : 3 * i + 3], height[i])
            for i, name in enumerate(self.robot.foot_names)
        )
        return Invariants(contacts, (self.ballistic_centre(quantities, p),))

    def _makers(
        self, motion: Recursion, x: cs.SX, u: cs.SX, forces: list[cs.SX], p: Mapping[str, cs.SX]
    ) -> dict[str, Callable[[], Bound]]:
        """Return the functions that make the quantities."""
        on_each = cs.vertcat(*(cs.repmat(p["contact"][i], 3, 1) for i in range(self.num_feet)))
        makers = bind_motion(self.robot, self._points, motion, x, p, Flat(p["terrain"]))
        makers.supply(joints.acceleration, self.robot.joint_names, lambda: motion.a[6:])
        makers.supply(joints.torque, self.robot.joint_names, lambda: u)
        makers.supply(feet.force, foot_labels(self.robot), lambda: cs.vertcat(*forces), on_each)
        return makers

    def _refuse_redundant_contacts(self) -> None:
        """Raise ModelError if the contact points of some feet are redundant in every posture."""
        rng = np.random.default_rng(0)
        stand = self.robot.pose("stand")
        postures = [self.state(joints=stand + 0.3 * rng.standard_normal(len(stand))) for _ in range(3)]
        jacobians = [self.contact_jacobian(x) for x in postures]
        kept: list[int] = []
        redundant = []
        for i, foot in enumerate(self.robot.feet):
            rows = [3 * k + axis for k in (*kept, i) for axis in range(3)]
            if max(np.linalg.matrix_rank(J[rows], tol=1e-6) for J in jacobians) == len(rows):
                kept.append(i)
            else:
                redundant.append(foot.name)
        if redundant:
            independent = ", ".join(self.robot.feet[i].name for i in kept)
            raise ModelError(
                f"whole body of '{self.robot.name}': redundant contact points - got {', '.join(redundant)} beside "
                f"{independent}, expected points that can be held independently; remove some, or set contact_damping "
                "(for example 1e-6 / kg)"
            )
