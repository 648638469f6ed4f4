"""MuJoCo as a model of a problem's schedule: the quantities of the whole body, and steps of a simulator."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import casadi as cs
import numpy as np
from numpy.typing import ArrayLike, NDArray

from piaffe.errors import ModelError
from piaffe.ocp import Block, Dynamics, Manifold, Node, Quantities, Quantity, is_same_time, rotation

from ..bindings import absent_quantities, bind_motion, frame_points
from ..ground import Exact
from ..kinematics import Kinematics
from ..legged import LeggedModel, state_blocks
from ..per_joint import per_joint
from ..quantities import feet, joints
from ..recursions import Recursion
from ..robot import Robot, require_robot
from ..terrain import Terrain
from ..tree import Tree
from .action import Action, BoundAction, joint_targets
from .contact import SoftContact, declare_pairs
from .payload import Payload
from .scene import compile_spec, mujoco_spec

Array = NDArray[np.float64]

ABSENT = {
    quantity.path: f"there is no {what} before the simulator's step; remove the term with .without(...)"
    for quantity, what in (
        (feet.force, "contact force"),
        (feet.contact_force, "contact force"),
        (joints.acceleration, "acceleration"),
    )
}
"""Quantities of the whole body that the simulator does not have, by path, and the reason."""


@dataclass(frozen=True)
class Fall:
    """Definition of a fall.

    Args:
        tilt: the robot has fallen if its base's z axis is farther from the vertical than this angle [rad].
        height: the robot has fallen if ``base.height`` is below this [m].
    """

    tilt: float = 0.5
    height: float = 0.15


class Mujoco(LeggedModel):
    """A robot in MuJoCo, which simulates its contacts; for sampling controllers, and as their plant.

    State, quantities and contact flags are those of :class:`~piaffe.models.WholeBody`, as expressions of (x, u). The
    flags come from the motion's phases, not from MuJoCo's contacts. Accelerations and contact forces are not available,
    because they are unknown before a step. Solvers that need derivatives raise an error for this model.

    Args:
        robot: the robot; its joints have its damping and dry friction.
        terrain: the ground, see :mod:`piaffe.models.terrain`.
        timestep: of the simulator [s].
        substeps: steps of the simulator per step of the schedule; ``dt`` is the product of both.
        contact: options of the contacts; the default is for planning.
        action: the meaning of the controls; joint targets by default.
        armature: rotor inertia reflected to the joints: one number, n numbers or a mapping from labels that names every
            joint [kg m²]. By default the robot's. With an explicit integrator of step h it is at least kd h + kp h², so
            that the PD law does not overshoot within a step.
        payload: a mass on the base, see :func:`~piaffe.models.payload`.
        friction: sliding friction coefficient of the robot's surface.
        body_collisions: whether base and knees collide with the ground too, so that a fallen robot does not sink.
        name: name of the model.
    """

    def __init__(
        self,
        robot: Robot,
        *,
        terrain: Terrain | None = None,
        timestep: float = 0.02,
        substeps: int = 1,
        contact: SoftContact | None = None,
        action: Action | None = None,
        armature: Any = None,
        payload: Payload | None = None,
        friction: float = 1.0,
        body_collisions: bool = False,
        name: str | None = None,
    ) -> None:
        require_robot(robot, "models.Mujoco")
        for what, got, kind, maker in (
            ("terrain", terrain, Terrain, "models.terrain.stairs(...)"),
            ("payload", payload, Payload, "models.payload(mass)"),
            ("contact", contact, SoftContact, "models.SoftContact(...)"),
        ):
            if not (got is None or isinstance(got, kind)):
                raise ModelError(
                    f"models.Mujoco: {what} is unusable - got {got!r}, expected a {kind.__name__}; make one, as {maker}"
                )
        self.timestep, self.substeps = _step(robot, timestep, substeps)
        self.contact, self.friction = contact or SoftContact(), float(friction)
        self.declared_action = action or joint_targets()
        self.action: BoundAction = self.declared_action.bind(robot)
        self.payload, self.body_collisions = payload, bool(body_collisions)
        loaded = robot if payload is None else payload.put_on(robot)
        self._armature = robot.armature if armature is None else per_joint(robot, "models.Mujoco, armature", armature)
        stable = self._stable_armature(robot) if armature is None else self._armature
        self.simulated = replace(loaded, armature=stable)
        nf = len(robot.feet)
        slots = {"contact": np.zeros(nf), "landing": np.zeros(nf), "lifting": np.zeros(nf)}
        control = Manifold((Block(self.action.quantity, robot.motor_names),))
        super().__init__(
            robot,
            name or f"{robot.name} in MuJoCo",
            state_blocks(robot),
            control,
            slots=slots,
            cut_by_modes=False,
            terrain=terrain,
        )
        self.tree = Tree.from_pinocchio(loaded.model, fixed=robot.base == "fixed")
        self._points, self._legs = frame_points(robot), Kinematics(robot)
        self._compiled: dict[bool, Any] = {}

    # ---- used by the compiler of problems

    @property
    def has_derivatives(self) -> bool:
        """False: the model can only be simulated."""
        return False

    @property
    def dt(self) -> float:
        """Time step of the schedule, ``timestep * substeps`` [s]."""
        return self.timestep * self.substeps

    @property
    def own_step(self) -> float:
        """The same as ``dt``: the only time step that a schedule may use."""
        return self.dt

    def lands(self, node: Node) -> bool:
        """Return False: the simulator computes impacts itself."""
        return False

    def dynamics(self, key: str, x: cs.SX, u: cs.SX, z: cs.SX, p: Mapping[str, cs.SX]) -> Dynamics:
        """Return the quantities; the step itself is not an expression."""
        nq, tree = self.tree.nq, self.tree
        motion = Recursion(tree, x[:nq], x[nq:])
        links = {"link_mass": tree.mass, "link_com": tree.com, "link_inertia": tree.inertia}
        known = {name: cs.SX(np.ravel(value)) for name, value in links.items()}
        known["foot_radius"] = cs.SX(self.robot.foot_radius)
        make, names = (
            bind_motion(self.robot, self._points, motion, x, {**p, **known}, Exact(self.terrain)),
            self.robot.joint_names,
        )
        if self.action.quantity == joints.target:
            make.supply(joints.target, names, lambda: u)
        at = x[nq - len(names) : nq]
        make.supply(joints.torque, self.robot.motor_names, lambda: self.action.torque(u, at, motion.v[6:]))
        absent = {**ABSENT, **absent_quantities(self.robot)}
        return Dynamics(cs.SX(0, 1), cs.SX(0, 1), Quantities(self.name, make, absent))

    def control_guess(self, nodes: Sequence[Node], states: Array, p: Mapping[str, Array]) -> dict[Quantity, Array]:
        """Return the controls for the joint angles of the path, within the action's range, (N, n)."""
        guess = np.tile(self.action.centre, (len(nodes), 1))
        if self.action.quantity == joints.target:
            for row, node in zip(guess, nodes, strict=True):
                if joints.position in node.sample:
                    row[:] = np.clip(node.sample[joints.position], self.action.lower, self.action.upper)
        return {self.action.quantity: guess}

    # ---- the simulator

    def _stable_armature(self, robot: Robot) -> Array:
        """Return the robot's armature, or the larger one that explicit steps of the PD law need, (n,) [kg m²]."""
        if self.contact.integrator != "euler" or self.action.quantity != joints.target:
            return robot.armature
        h = self.timestep
        return np.maximum(robot.armature, self.action.kd * h + self.action.kp * h**2)

    def spec(self, *, visuals: bool = False) -> Any:
        """Return an editable ``mujoco.MjSpec`` of robot and terrain; controls are the action's.

        Args:
            visuals: draw the robot, with lights and a camera that follows it.
        """
        spec = mujoco_spec(
            self.simulated, friction=self.friction, dt=self.timestep, visuals=visuals, terrain=self.terrain,
            action=self.action, surface=self.contact.surface(self.friction), hull=self.body_collisions,
        )  # fmt: skip
        self.contact.apply_to(spec)
        return spec

    def compiled(self, *, visuals: bool = False) -> Any:
        """Return the ``mujoco.MjModel``; it is made once and shared, so do not change it."""
        if visuals not in self._compiled:
            spec = self.spec(visuals=visuals)
            declare_pairs(spec)
            self._compiled[visuals] = compile_spec(spec, self.simulated)
        return self._compiled[visuals]

    def as_plant(self, timestep: float = 0.002, **changes: Any) -> Mujoco:
        """Return a model of the same robot, terrain and action with smaller steps and contacts solved to convergence.

        Args:
            timestep: of its simulator [s]; the schedule's time step is the same.
            changes: other arguments of the class, for differences between planner and plant: ``payload``, ``friction``,
                …

        Raises:
            ModelError: the schedule's time step is not a whole multiple of ``timestep``.
        """
        steps = round(self.dt / timestep)
        if steps < 1 or not is_same_time(steps * timestep, self.dt):
            raise ModelError(
                f"plant of '{self.name}': timestep does not divide the schedule's step - got {timestep:g} s, expected "
                f"{self.dt:g} s divided by a whole number; choose one"
            )
        same = {
            "terrain": self.terrain, "action": self.declared_action, "contact": SoftContact.accurate(),
            "armature": self._armature, "payload": self.payload, "friction": self.friction,
            "body_collisions": self.body_collisions, "name": f"{self.name}, plant",
        }  # fmt: skip
        return Mujoco(self.robot, timestep=timestep, substeps=steps, **{**same, **changes})

    def control_to_ctrl(self, controls: Array) -> Array:
        """Return MuJoCo's ``ctrl`` for controls, (..., nu): the same, as the actuators apply the action."""
        return controls

    # ---- numbers

    def height_above_terrain(self, states: ArrayLike) -> Array:
        """Return ``base.height``, (...,) [m], of states (..., nx)."""
        x = np.asarray(states, dtype=float)
        places = self._legs.world_feet(x[..., :3], x[..., 3:7], x[..., 7 : self.tree.nv + 1])
        return np.asarray(x[..., 2] - np.mean(self.terrain.height(places[..., 0], places[..., 1]), axis=-1))

    def fallen(self, states: ArrayLike, fall: Fall | None = None) -> NDArray[np.bool_]:
        """Return which states are falls, (...,); states that are not finite are falls, too.

        Args:
            states: (..., nx).
            fall: the definition of a fall; ``Fall()`` by default.
        """
        x, fall = np.asarray(states, dtype=float), fall or Fall()
        finite = np.all(np.isfinite(x), axis=-1)
        x = np.where(finite[..., None], x, 0.0)
        upright = rotation.np_matrix(x[..., 3:7])[..., 2, 2]
        with np.errstate(invalid="ignore"):
            return np.asarray(~finite | (upright < np.cos(fall.tilt)) | (self.height_above_terrain(x) < fall.height))


def _step(robot: Robot, timestep: float, substeps: int) -> tuple[float, int]:
    """Return the simulator's step [s] and the number of substeps; raise ModelError if one is out of range."""
    for name, value, holds in (
        ("timestep", timestep, np.isfinite(timestep) and timestep > 0),
        ("substeps", substeps, substeps == int(substeps) and substeps >= 1),
    ):
        if not holds:
            raise ModelError(
                f"models.Mujoco of '{robot.name}': {name} is out of range - got {value!r}, expected "
                f"{'seconds > 0' if name == 'timestep' else 'a whole number ≥ 1'}; change it"
            )
    return float(timestep), int(substeps)
