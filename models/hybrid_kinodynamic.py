"""The hybrid kinodynamic model: one body moved by contact forces, and massless legs moved by joint velocities."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from typing import Any

import casadi as cs
import numpy as np
from numpy.typing import ArrayLike, NDArray

from piaffe.ocp import Block, Bound, Dynamics, Invariants, Manifold, Node, Quantities, Quantity, rotation

from .bindings import bind_motion, foot_points, frame_points, in_contact_axes
from .ground import declared_ground, ground_slots
from .holding import holding_forces
from .integrators import Integrator, checked_integrator, integrate
from .leg_motion import leg_motions
from .legged import POSE_BLOCKS, VELOCITY_BLOCKS, LeggedModel, require_floating
from .one_body import body_numbers, moment_maps, next_velocity, refused_inertia, spin_momentum
from .postures import XYZ, foot_labels
from .quantities import com, feet, joints, momentum
from .recursions import Recursion
from .robot import Robot, require_robot
from .stance import Stance
from .terrain import Terrain, checked_terrain
from .tree import Tree

Array = NDArray[np.float64]


class HybridKinodynamic(LeggedModel):
    """One rigid body under gravity and contact forces, on legs without mass whose joints move at given velocities.

    The body is that of :class:`SingleRigidBody`: its centre of mass is the base's origin p, with orientation R, and the
    mass and inertia do not depend on the legs. The control is the forces f of the feet and the commanded velocities c
    of the joints q. With contact flags s and the places r of the feet, which follow from p, R and q::

        v̇ = Σ s f / m + g,        I ω̇ = Rᵀ Σ s (r − p) × f − ω × I ω
        q̇ = c                               in the air
        q̇ = −J⁺ (Rᵀ v + ω × Rᵀ(r − p))      on the ground, where the foot stands

    J is the derivative of a foot's place in base axes by the joints of its leg. In a step, two iterations of Newton's
    method move the joints so that the foot stays where it was; see :class:`~piaffe.models.leg_motion.LegMotion`.
    ``joints.velocity`` is q̇ in both cases; ``joints.commanded_velocity`` is c.

    Contact sets are phases, as for :class:`WholeBody`. A foot that lands is on the ground at the phase's end; it lands
    without an impact, because legs have no mass. Forces of feet in the air and commands of legs on the ground have no
    effect. Terms see them as they are, so costs on ``feet.force`` and ``joints.commanded_velocity`` keep them at zero.

    After the hybrid kinodynamic model of [Li2022Versatile]. There a leg on the ground stores the place of its foot in
    place of its joint angles; here the angles go on in both cases, so no reset changes them.

    Args:
        robot: the robot.
        mass: m [kg]; by default the mass of all links.
        inertia: I in body axes, (3, 3) or its xx, yy, zz, xy, xz, yz [kg m²]; by default the inertia of the robot in
            its ``"stand"`` pose, about its centre of mass.
        terrain: the ground, as for :class:`WholeBody`.
        integrator: ``"midpoint"`` or ``"euler"``: how the body moves, as for :class:`SingleRigidBody`.
        name: name of the model.

    Raises:
        ModelError: a number is out of range, the base is fixed, or two feet share a joint.
    """

    def __init__(
        self,
        robot: Robot,
        *,
        mass: float | None = None,
        inertia: ArrayLike | None = None,
        integrator: Integrator = "midpoint",
        terrain: Terrain | None = None,
        name: str | None = None,
    ) -> None:
        where = "models.HybridKinodynamic"
        require_robot(robot, where)
        require_floating(robot, where)
        body = body_numbers(robot, mass, inertia)
        chosen = checked_integrator(integrator, ("euler", "midpoint"), f"kinodynamic model of '{robot.name}'")
        nf, ground = len(robot.feet), checked_terrain(terrain, where)
        slots = {
            "contact": np.zeros(nf),
            "landing": np.zeros(nf),
            "lifting": np.zeros(nf),
            **ground_slots(ground, nf),
            "foot_radius": robot.foot_radius,
            **body,
        }
        control = Manifold((Block(feet.force, foot_labels(robot)), Block(joints.commanded_velocity, robot.joint_names)))
        state = (*POSE_BLOCKS, Block(joints.position, robot.joint_names), *VELOCITY_BLOCKS)
        super().__init__(
            robot, name or f"{robot.name} kinodynamic", state, control, slots=slots, positive=("mass",),
            checks={"inertia": refused_inertia}, terrain=ground,
        )  # fmt: skip
        self.integrator = chosen
        self.tree = Tree.from_pinocchio(robot.model)
        self._points = frame_points(robot)
        self._contacts = foot_points(robot, self._points)
        self._legs = leg_motions(self.kinematics, where)

    @property
    def nodes_after_liftoff(self) -> int:
        """1: the swing's first command moves the foot."""
        return 1

    def lands(self, node: Node) -> bool:
        """Return False: legs have no mass, so a landing changes no velocity."""
        return False

    def recipe(self) -> dict[str, object]:
        """Return the kind of model, the robot, and the integrator."""
        return {**super().recipe(), "integrator": self.integrator}

    def control_guess(self, nodes: Sequence[Node], states: Array, p: Mapping[str, Array]) -> dict[Quantity, Array]:
        """Return forces that hold the body at rest, (N, 3 nf) [N], and the velocities of the reference, (N, n)."""
        at, n = states[:-1], self.robot.num_joints
        arms = self.kinematics.world_feet(np.zeros((len(at), 3)), at[:, 3:7], at[:, 7 : 7 + n])
        weight = np.hstack([-p["mass"] * p["gravity"], np.zeros((len(at), 3))])
        still = np.zeros(n)
        told = np.array([np.asarray(node.sample.get(joints.velocity, still), dtype=float) for node in nodes])
        for motion in self._legs:
            told[:, list(motion.leg.joints)] *= 1 - p["contact"][:, [motion.leg.foot]]
        return {
            feet.force: holding_forces(moment_maps(arms), p["contact"], weight, self.sizes.length),
            joints.commanded_velocity: told,
        }

    def dynamics(self, key: str, x: cs.SX, u: cs.SX, z: cs.SX, p: Mapping[str, cs.SX]) -> Dynamics:
        """Return the dynamics, the same for every contact set; see the class."""
        n, dt, on = self.robot.num_joints, p["dt"], p["contact"]
        pose, angles, v = x[:7], x[7 : 7 + n], x[7 + n :]
        forces, commands = u[: 3 * self.num_feet], u[3 * self.num_feet :]
        rates, change = cs.SX(commands), commands * dt
        rest = Recursion(self.tree, x[: 7 + n])
        places = [rest.point(point) for point in self._contacts]
        middle = integrate(pose, v, dt / 2) if self.integrator == "midpoint" else pose
        force, torque = cs.SX.zeros(3), cs.SX.zeros(3)
        for i, place in enumerate(places):
            acting = on[i] * forces[3 * i : 3 * i + 3]
            force += acting
            torque += cs.cross(place - middle[:3], acting)
        v_next = next_velocity(middle[3:7], v, force, torque, dt, p, mean=self.integrator == "midpoint")
        moved = integrate(middle, v_next, dt / 2) if self.integrator == "midpoint" else integrate(pose, v, dt)
        to_base, to_moved = rotation.matrix(pose[3:7]).T, rotation.matrix(moved[3:7]).T
        for motion in self._legs:
            own, foot = list(motion.leg.joints), motion.leg.foot
            away = -(to_base @ v[:3] + cs.cross(v[3:], to_base @ (places[foot] - pose[:3])))
            standing = motion.rates(angles[own], commands[own], away)
            rates[own] = on[foot] * standing + (1 - on[foot]) * commands[own]
            stays = motion.moved(angles[own], change[own], to_moved @ (places[foot] - moved[:3])) - angles[own]
            change[own] = on[foot] * stays + (1 - on[foot]) * change[own]
        quantities = Quantities(self.name, self._makers(x, forces, commands, rates, p))
        outputs = (joints.velocity, *self._recorded)
        return Dynamics(cs.SX(0, 1), cs.vertcat(moved, angles + change, v_next), quantities, outputs=outputs)

    def switching(self, key: str, quantities: Quantities, p: Mapping[str, cs.SX]) -> Bound:
        """Return the heights of the feet, with the landing feet as mask."""
        return self.landing_heights(quantities, p)

    def invariants(self, key: str, quantities: Quantities, p: Mapping[str, cs.SX]) -> Invariants:
        """Return that feet on the ground do not move, and that the body falls freely if none is there."""
        return Invariants(self.standing_points(quantities, p), (self.ballistic_centre(quantities, p),))

    def step(self, x: ArrayLike, u: ArrayLike, feet: str | Stance, dt: float, **parameters: Any) -> Array:
        """Return the state one time step later, (nx,), with a unit quaternion.

        Args:
            x: state, (nx,).
            u: world forces of all feet [N], then commanded velocities of all joints [rad/s], (nu,).
            feet: the feet on the ground, ``"FL HR"``.
            dt: time step [s].
            parameters: other values of slots.
        """
        state, control = self.checked("x", x, self.state.nx), self.checked("u", u, self.control.nx)
        p = self.numbers(contact=self.flags(feet), **parameters)
        return self.state.np_normalise(self._step(state, control, dt, *p.values()).full().ravel())

    @cached_property
    def _step(self) -> cs.Function:
        x, u, p = cs.SX.sym("x", self.state.nx), cs.SX.sym("u", self.control.nx), self.symbols()
        dynamics = self.dynamics("contact", x, u, cs.SX(0, 1), p)
        return cs.Function("step", [x, u, p["dt"], *(p[slot.name] for slot in self.slots)], [dynamics.next_state])

    def _makers(
        self, x: cs.SX, forces: cs.SX, commands: cs.SX, rates: cs.SX, p: Mapping[str, cs.SX]
    ) -> dict[str, Callable[[], Bound]]:
        """Return the functions that make the quantities; the centre of mass is the base's origin."""
        n, each, ground = self.robot.num_joints, foot_labels(self.robot), declared_ground(self.terrain, p)
        v, omega = x[7 + n : 10 + n], x[10 + n :]
        motion = Recursion(self.tree, x[: 7 + n], cs.vertcat(v, omega, rates))
        makers = bind_motion(self.robot, self._points, motion, x, p, ground)
        makers.supply(joints.commanded_velocity, self.robot.joint_names, lambda: commands)
        makers.supply(feet.force, each, lambda: forces)
        makers.supply(feet.contact_force, each, lambda: in_contact_axes(ground, forces))
        makers.supply(com.position, XYZ, lambda: x[:3])
        makers.supply(com.velocity, XYZ, lambda: v)
        makers.supply(momentum, XYZ, lambda: spin_momentum(x[3:7], omega, p))
        return makers
