"""The single-rigid-body model: one body and massless legs, with contact forces at given footholds."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cached_property, partial
from typing import Any

import casadi as cs
import numpy as np
from numpy.typing import ArrayLike, NDArray

from piaffe.ocp import (
    Block,
    Bound,
    Dynamics,
    Invariants,
    Manifold,
    Node,
    Quantities,
    Quantity,
    Sample,
    SplitStep,
    rotation,
)

from .bindings import ground_normal, in_contact_axes
from .ground import declared_ground, ground_slots
from .holding import holding_forces
from .integrators import Integrator, begun, checked_integrator, finished, integrate
from .legged import POSE_BLOCKS, VELOCITY_BLOCKS, LeggedModel, require_floating
from .one_body import body_numbers, moment_maps, next_velocity, refused_inertia, spin_momentum
from .postures import HEIGHT, XYZ, foot_labels, place_feet
from .quantities import base, com, feet, momentum
from .robot import Robot, require_robot
from .stance import Stance
from .terrain import Terrain, checked_terrain

Array = NDArray[np.float64]


class SingleRigidBody(LeggedModel):
    """One rigid body under gravity and the contact forces of the feet, at footholds fixed in the world.

    The centre of mass is the base's origin, at position p. With contact flags s, forces f (the control) and footholds
    r::

        v̇ = Σ s f / m + g,        I ω̇ = Rᵀ Σ s (r − p) × f − ω × I ω

    A change of contacts does not begin a new phase: flags and footholds are parameters of each stage, those at its
    middle. Forces of feet in
    the air have no effect on the dynamics. Terms see these forces unmasked, so a cost on ``feet.force`` keeps them at
    zero.

    Args:
        robot: the robot.
        mass: m [kg]; by default the mass of all links.
        inertia: I in body axes, (3, 3) or its xx, yy, zz, xy, xz, yz [kg m²]; by default the inertia of the robot in
            its ``"stand"`` pose, about its centre of mass.
        terrain: the ground, as for :class:`WholeBody`.
        integrator: ``"midpoint"`` or ``"euler"``, see :class:`WholeBody`; midpoint steps are exact in the position.
        name: name of the model.
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
        require_robot(robot, "models.SingleRigidBody")
        body = body_numbers(robot, mass, inertia)
        chosen = checked_integrator(integrator, ("euler", "midpoint"), f"rigid body of '{robot.name}'")
        nf, ground = len(robot.feet), checked_terrain(terrain, "models.SingleRigidBody")
        slots = {
            "contact": np.zeros(nf),
            "footholds": np.zeros(3 * nf),
            **ground_slots(ground, nf),
            **body,
        }
        control = Manifold((Block(feet.force, foot_labels(robot)),))
        require_floating(robot, "models.SingleRigidBody")
        state = (*POSE_BLOCKS, *VELOCITY_BLOCKS)
        super().__init__(
            robot, name or f"{robot.name} rigid body", state, control, slots=slots, cut_by_modes=False,
            positive=("mass",), checks={"inertia": refused_inertia},
            terrain=ground,
        )  # fmt: skip
        self.integrator = chosen

    def recipe(self) -> dict[str, object]:
        """Return the kind of model, the robot, and the integrator."""
        return {**super().recipe(), "integrator": self.integrator}

    @property
    def slots_from_motion(self) -> Mapping[str, Quantity]:
        """The footholds are the feet of the reference, the planes below them those of the terrain there."""
        return {"footholds": feet.position, **self.slots_of_ground}

    @property
    def acting(self) -> frozenset[Quantity]:
        """Contacts, footholds and forces act during a whole stage: a stage takes them at its middle."""
        return frozenset({feet.contact, feet.position, feet.force, *self.slots_of_ground.values()})

    def node_parameters(self, node: Node) -> dict[str, Array]:
        """Return the contact flags and the footholds of a node."""
        values = {"contact": self.flags(node.mode), "footholds": self._footholds(node.sample)}
        return values | {slot: np.asarray(node.sample[quantity]) for slot, quantity in self.slots_of_ground.items()}

    def control_guess(self, nodes: Sequence[Node], states: Array, p: Mapping[str, Array]) -> dict[Quantity, Array]:
        """Return the smallest forces that hold the body at rest, (N, 3 nf) [N]; see :func:`holding_forces`."""
        arms = p["footholds"].reshape(len(nodes), -1, 3) - states[:-1, None, :3]
        weight = np.hstack([-p["mass"] * p["gravity"], np.zeros((len(nodes), 3))])
        return {feet.force: holding_forces(moment_maps(arms), p["contact"], weight, self.sizes.length)}

    def dynamics(self, key: str, x: cs.SX, u: cs.SX, z: cs.SX, p: Mapping[str, cs.SX]) -> Dynamics:
        """Return the dynamics, the same for every contact set; see the class."""
        dt = p["dt"]
        at = x if self.integrator == "euler" else cs.SX.sym("m", self.state.nx)
        force, torque = cs.SX.zeros(3), cs.SX.zeros(3)
        for i in range(self.num_feet):
            acting = p["contact"][i] * u[3 * i : 3 * i + 3]
            force += acting
            torque += cs.cross(p["footholds"][3 * i : 3 * i + 3] - at[:3], acting)
        v_next = next_velocity(at[3:7], at[7:13], force, torque, dt, p, mean=self.integrator == "midpoint")
        quantities = Quantities(self.name, self._makers(x, u, spin_momentum(x[3:7], x[10:13], p), p))
        if at is x:
            next_state = cs.vertcat(integrate(x[:7], x[7:13], dt), v_next)
            return Dynamics(cs.SX(0, 1), next_state, quantities, outputs=(feet.force, *self._recorded))
        step, first = self.integrator, cs.vertcat(at[:7], v_next)
        split = SplitStep(at, begun(step, x, 6, dt), cs.SX(0, 1), first, lambda w: finished(step, w, 6, dt))
        return split.dynamics(quantities, outputs=(feet.force, *self._recorded))

    def invariants(self, key: str, quantities: Quantities, p: Mapping[str, cs.SX]) -> Invariants:
        """Return that the base falls freely if no foot is on the ground; the footholds are given, not integrated."""
        return Invariants(ballistic=(self.ballistic_centre(quantities, p),))

    def step(
        self, x: ArrayLike, u: ArrayLike, feet: str | Stance, footholds: ArrayLike, dt: float, **parameters: Any
    ) -> Array:
        """Return the state one time step later, (13,), with a unit quaternion.

        Args:
            x: state, (13,).
            u: world forces of all feet, (nf, 3) or (3 nf,) [N].
            feet: the feet on the ground, ``"FL HR"``.
            footholds: world positions of all feet, (nf, 3) or (3 nf,) [m].
            dt: time step [s].
            parameters: other values of slots.
        """
        state, control = self.checked("x", x, self.state.nx), self.checked("u", u, self.control.nx)
        p = self.numbers(contact=self.flags(feet), footholds=footholds, **parameters)
        return self.state.np_normalise(self._step(state, control, dt, *p.values()).full().ravel())

    @cached_property
    def _step(self) -> cs.Function:
        x, u, p = cs.SX.sym("x", self.state.nx), cs.SX.sym("u", self.control.nx), self.symbols()
        dynamics = self.dynamics("contact", x, u, cs.SX(0, 1), p)
        return cs.Function("step", [x, u, p["dt"], *(p[slot.name] for slot in self.slots)], [dynamics.next_state])

    def _makers(self, x: cs.SX, u: cs.SX, spin: cs.SX, p: Mapping[str, cs.SX]) -> dict[str, Callable[[], Bound]]:
        """Return the functions that make the quantities; the centre of mass is the base's origin."""
        stacked, names = foot_labels(self.robot), self.robot.foot_names
        ground = declared_ground(self.terrain, p)
        places = cs.vertsplit(p["footholds"], 3) if names else []
        planes = [Bound(feet.normal, p["normals"][: 3 * len(names)], stacked)] if self.slots_of_ground else []
        bound = [
            Bound(base.position, x[:3], XYZ),
            Bound(base.orientation, x[3:7], XYZ),
            Bound(base.linear_velocity, x[7:10], XYZ),
            Bound(base.angular_velocity, x[10:13], XYZ),
            Bound(base.height, x[2] - ground.mean_height(places), HEIGHT),
            Bound(base.ground_normal, ground_normal(x[3:7], ground.slope(places)), XYZ),
            Bound(feet.force, u, stacked),
            Bound(feet.contact_force, in_contact_axes(ground, u), stacked),
            *planes,
            Bound(feet.position, p["footholds"], stacked),
            Bound(feet.contact, p["contact"], names),
            Bound(com.position, x[:3], XYZ),
            Bound(com.velocity, x[7:10], XYZ),
            Bound(momentum, spin, XYZ),
        ]
        return {each.quantity.path: partial(_same, each) for each in bound}

    def _footholds(self, sample: Sample) -> Array:
        """Return the feet of the reference, (3 nf,) [m]; without one, the feet of the standing robot below the base."""
        if feet.position in sample:
            return np.asarray(sample[feet.position], dtype=float)
        x, y, yaw = self.planar_frame(sample)
        level = rotation.np_from_rpy(np.array([0.0, 0.0, yaw]))
        placed = place_feet(self.robot, np.array([x, y, 0.0]), level, self.robot.pose("stand"))
        return self.reference_ground.standing(placed[:, :2], self.robot.foot_radius).ravel()


def _same(bound: Bound) -> Bound:
    return bound
