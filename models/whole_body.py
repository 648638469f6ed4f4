"""The whole-body model: every link and joint; accelerations and contact forces are solved for together."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Literal

import casadi as cs
import numpy as np
from numpy.typing import NDArray

from piaffe.errors import ModelError
from piaffe.ocp import Block, Bound, Dynamics, Manifold, Node, Promises, Quantities, Reset, Resting

from ._numeric import NumericWholeBody
from .bindings import bind_motion, foot_points, frame_points, inertials
from .legged import POSE_BLOCKS, VELOCITY_BLOCKS, integrate
from .postures import foot_labels
from .quantities import feet, joints
from .recursions import Recursion
from .robot import Robot, require_robot
from .terrain import Flat
from .tree import Tree

Array = NDArray[np.float64]
Integrator = Literal["euler", "semi_implicit"]

_GAMMA = 20.0  # [1/s], in numerical calls


class WholeBody(NumericWholeBody):
    """Whole-body dynamics with rigid contacts, as an implicit system in acceleration and contact force.

    With 0/1 flags S of the feet on the ground, z = (a, F) solves::

        M a + n − Jᵀ S F          = B u
        S (J a + J̇ v + γ J v + d F) + (I − S) F = 0

    where γ [1/s] (Baumgarte) reduces a foot's velocity to zero and d is the compliance ``contact_damping``. By default
    γ is 1/dt in a compiled problem: the velocity that a step leaves a standing foot is gone after the next one. It is
    20 1/s in numerical calls.
    Acceleration and generalised force are in the state's layout: world linear, body angular, joints.

    Args:
        robot: the robot.
        baumgarte: γ [1/s], in place of the one that follows from the time step.
        integrator: ``"euler"``: ``q ⊕ v dt``, ``v + a dt``; ``"semi_implicit"``: the same with the new v in q.
        contact_damping: d [1/kg], needed if contact points are redundant; None for rigid contacts.
        name: name of the model; the robot's by default.

    Raises:
        ModelError: contact points are redundant, and there is no ``contact_damping``.
    """

    def __init__(
        self,
        robot: Robot,
        *,
        baumgarte: float | None = None,
        integrator: Integrator = "euler",
        contact_damping: float | None = None,
        name: str | None = None,
    ) -> None:
        require_robot(robot, "models.WholeBody")
        if integrator not in ("euler", "semi_implicit"):
            raise ModelError(
                f"whole body of '{robot.name}': unknown integrator - got {integrator!r}, expected 'euler' or "
                "'semi_implicit'; choose one"
            )
        if baumgarte is not None and not (isinstance(baumgarte, int | float | np.floating) and 0 <= baumgarte < np.inf):
            raise ModelError(
                f"whole body of '{robot.name}': baumgarte is out of range - got {baumgarte!r}, expected a finite "
                "number ≥ 0 [1/s]; change it"
            )
        if contact_damping is not None and not contact_damping > 0:
            raise ModelError(
                f"whole body of '{robot.name}': contact_damping is out of range - got {contact_damping}, expected a "
                "positive number [1/kg]; leave it out for rigid contacts"
            )
        tree, nf = Tree.from_pinocchio(robot.model), len(robot.feet)
        slots = {
            "contact": np.zeros(nf),
            "landing": np.zeros(nf),
            "lifting": np.zeros(nf),
            "terrain": 0.0,
            "foot_radius": robot.foot_radius,
            "gamma": _GAMMA if baumgarte is None else baumgarte,
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
        self.integrator: Integrator = integrator
        self._gamma_follows = baumgarte is None
        self.tree = tree
        self._points = frame_points(robot)
        self.contacts = foot_points(robot, self._points)
        if contact_damping is None:
            self._refuse_redundant_contacts()

    def node_parameters(self, node: Node) -> dict[str, Array]:
        """Return the slots of a legged model, and ``gamma`` if it follows from the time step."""
        follows = self._gamma_follows and node.dt > 0
        return {**super().node_parameters(node), **({"gamma": np.array([1.0 / node.dt])} if follows else {})}

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

    # ---- expressions

    def dynamics(self, key: str, x: cs.SX, u: cs.SX, z: cs.SX, p: Mapping[str, cs.SX]) -> Dynamics:
        """Return the contact dynamics, the same for every contact set; see the class."""
        nq, nv = self.nq, self.nv
        q, v, a = x[:nq], x[nq:], z[:nv]
        body, forces = inertials(p), [z[nv + 3 * i : nv + 3 * i + 3] for i in range(self.num_feet)]
        motion = Recursion(self.tree, q, v, a)
        acting = [p["contact"][i] * force for i, force in enumerate(forces)]
        effort = motion.inverse_dynamics(body, p["gravity"], list(zip(self.contacts, acting, strict=True)))
        effort += cs.vertcat(cs.SX(6, 1), p["armature"] * a[6:] - u)
        rows = []
        for i, (point, force) in enumerate(zip(self.contacts, forces, strict=True)):
            on = p["contact"][i]
            slip = motion.acceleration(point, p["gamma"]) + p["contact_damping"] * force
            rows.append(on * slip + (1 - on) * force)
        v_next = v + a * p["dt"]
        q_next = integrate(q, v_next if self.integrator == "semi_implicit" else v, p["dt"])
        quantities = Quantities(self.name, self._makers(motion, x, u, acting, p))
        return Dynamics(cs.vertcat(effort, *rows), cs.vertcat(q_next, v_next), quantities, outputs=(feet.force,))

    def reset(self, key: str, x: cs.SX, z: cs.SX, p: Mapping[str, cs.SX]) -> Reset:
        """Return the inelastic impact of the landing feet; the configuration does not change.

        With 0/1 flags L of the landing feet, z = (v⁺, Λ) solves::

            M (v⁺ − v) − Jᵀ L Λ          = 0
            L (J v⁺ + d Λ) + (I − L) Λ   = 0
        """
        nq, nv = self.nq, self.nv
        q, v, v_next = x[:nq], x[nq:], z[:nv]
        impulses = [z[nv + 3 * i : nv + 3 * i + 3] for i in range(self.num_feet)]
        acting = [p["landing"][i] * impulse for i, impulse in enumerate(impulses)]
        jump = Recursion(self.tree, q, None, v_next - v)
        effort = jump.inverse_dynamics(inertials(p), cs.SX(3, 1), list(zip(self.contacts, acting, strict=True)))
        effort += cs.vertcat(cs.SX(6, 1), p["armature"] * (v_next - v)[6:])
        after = Recursion(self.tree, q, v_next)
        rows = []
        for i, (point, impulse) in enumerate(zip(self.contacts, impulses, strict=True)):
            lands = p["landing"][i]
            rows.append(lands * (after.velocity(point) + p["contact_damping"] * impulse) + (1 - lands) * impulse)
        return Reset(cs.vertcat(effort, *rows), cs.vertcat(q, v_next))

    def switching(self, key: str, quantities: Quantities, p: Mapping[str, cs.SX]) -> Bound:
        """Return the heights of the feet, with the landing feet as mask."""
        height = quantities.bind(feet.height)
        return Bound(height.quantity, height.value, height.labels, mask=p["landing"])

    def promises(self, key: str, quantities: Quantities, p: Mapping[str, cs.SX]) -> Promises:
        """Return that feet on the ground rest, and that the centre of mass falls freely if none is."""
        place, height = (quantities.bind(each).value for each in (feet.position, feet.height))
        resting = tuple(
            Resting(name, p["contact"][i], place[3 * i : 3 * i + 3], height[i])
            for i, name in enumerate(self.robot.foot_names)
        )
        return Promises(resting, (self.falling_centre(quantities, p),))

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
