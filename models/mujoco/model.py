"""MuJoCo as a model of the schedule: the quantities of the whole body, and a simulator in place of its derivatives."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import casadi as cs
import numpy as np
from numpy.typing import ArrayLike, NDArray

from piaffe.errors import ModelError
from piaffe.ocp import Block, Dynamics, Manifold, Node, Quantities, Quantity, Sample, rotation

from ..bindings import bind_motion, frame_points
from ..kinematics import Kinematics
from ..legged import POSE_BLOCKS, VELOCITY_BLOCKS, LeggedModel
from ..quantities import feet, joints
from ..recursions import Recursion
from ..robot import Robot, require_robot
from ..terrain import Flat, Terrain
from ..tree import Tree
from .action import Action, BoundAction, joint_targets, per_joint
from .contact import SoftContact, pair_up
from .payload import Payload
from .scene import compile_spec, mujoco_spec

Array = NDArray[np.float64]

ABSENT = {
    quantity.path: f"there is no {what} before the simulator's step; leave the term out with .without(...)"
    for quantity, what in ((feet.force, "contact force"), (joints.acceleration, "acceleration"))
}
"""Why the simulator cannot supply what the whole body can."""


@dataclass(frozen=True)
class Fall:
    """What counts as a fall.

    Args:
        tilt: angle of the base's z axis from the vertical above which it has fallen [rad].
        height: ``base.height`` below which it has fallen [m].
    """

    tilt: float = 0.5
    height: float = 0.15


class Mujoco(LeggedModel):
    """A robot in MuJoCo, which simulates its contacts; for sampling controllers, and as their plant.

    State, quantities and contact flags are those of :class:`~piaffe.models.WholeBody`, as expressions of (x, u); the
    flags are the motion's schedule, not what MuJoCo measures. Accelerations and contact forces are not known before a
    step is made and cannot be supplied. Solvers that need derivatives refuse the model.

    Args:
        robot: the robot.
        terrain: the ground, see :mod:`piaffe.models.terrain`.
        timestep: of the simulator [s].
        substeps: steps of the simulator per step of the schedule, whose ``dt`` is the product.
        contact: how contacts are solved; the default is made for planning.
        action: what a control is; joint targets by default.
        armature: inertia of the rotors as seen at the joints, a number, n of them or a mapping from labels that names
            every joint [kg m²]. By default the robot's, but with an explicit integrator at least kd h + kp h² for steps
            h, so that no step makes the PD law overshoot.
        payload: a mass on the base, see :func:`~piaffe.models.payload`.
        friction: sliding friction coefficient of the robot's surface.
        body_collisions: let base and knees touch the ground, not the feet alone, so that a fallen robot does not sink.
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
        self.terrain: Terrain = terrain if terrain is not None else Flat()
        self.timestep, self.substeps = _step(robot, timestep, substeps)
        self.contact, self.friction = contact or SoftContact(), float(friction)
        self.declared_action = action or joint_targets()
        self.action: BoundAction = self.declared_action.bind(robot)
        self.payload, self.body_collisions = payload, bool(body_collisions)
        loaded = robot if payload is None else payload.put_on(robot)
        self._armature = robot.armature if armature is None else per_joint(robot, "models.Mujoco, armature", armature)
        self.simulated = replace(loaded, armature=self._armature if armature is not None else self._steady(robot))
        nf = len(robot.feet)
        slots = {"contact": np.zeros(nf), "landing": np.zeros(nf), "lifting": np.zeros(nf)}
        positions = (*POSE_BLOCKS, Block(joints.position, robot.joint_names))
        velocities = (*VELOCITY_BLOCKS, Block(joints.velocity, robot.joint_names, rate_of=joints.position))
        control = Manifold((Block(self.action.quantity, robot.joint_names),))
        super().__init__(
            robot,
            name or f"{robot.name} in MuJoCo",
            (*positions, *velocities),
            control,
            slots=slots,
            cut_by_modes=False,
            terrain=self.terrain,
        )
        self.tree = Tree.from_pinocchio(loaded.model)
        self._points, self._legs = frame_points(robot), Kinematics(robot)
        self._compiled: dict[bool, Any] = {}

    # ---- what the compiler asks

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
        """The same: no other can be scheduled."""
        return self.dt

    def lands(self, node: Node) -> bool:
        """Return False: the simulator makes impacts itself."""
        return False

    def dynamics(self, key: str, x: cs.SX, u: cs.SX, z: cs.SX, p: Mapping[str, cs.SX]) -> Dynamics:
        """Return the quantities; there is no expression of the step."""
        nq, tree = self.tree.nv + 1, self.tree
        motion = Recursion(tree, x[:nq], x[nq:])
        links = {"link_mass": tree.mass, "link_com": tree.com, "link_inertia": tree.inertia}
        known = {name: cs.SX(np.ravel(value)) for name, value in links.items()}
        known["foot_radius"] = cs.SX(self.robot.foot_radius)
        make, names = (
            bind_motion(self.robot, self._points, motion, x, {**p, **known}, self.terrain),
            self.robot.joint_names,
        )
        if self.action.quantity == joints.target:
            make.supply(joints.target, names, lambda: u)
        make.supply(joints.torque, names, lambda: self.action.torque(u, x[7:nq], motion.v[6:]))
        return Dynamics(cs.SX(0, 1), cs.SX(0, 1), Quantities(self.name, make, ABSENT))

    def control_guess(self, sample: Sample) -> dict[Quantity, Array]:
        """Return the control that holds the joints where the path has them, within the action's range."""
        if self.action.quantity != joints.target or joints.position not in sample:
            return {self.action.quantity: self.action.centre}
        return {joints.target: np.clip(sample[joints.position], self.action.lower, self.action.upper)}

    # ---- the simulator

    def _steady(self, robot: Robot) -> Array:
        """Return the robot's armature, raised to what explicit steps of the PD law need, (n,) [kg m²]."""
        if self.contact.integrator != "euler":
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
        """Return the ``mujoco.MjModel``, made once; it is shared and must not be changed."""
        if visuals not in self._compiled:
            spec = self.spec(visuals=visuals)
            pair_up(spec)
            self._compiled[visuals] = compile_spec(spec, self.simulated)
        return self._compiled[visuals]

    def as_plant(self, timestep: float = 0.002, **changes: Any) -> Mujoco:
        """Return a model of the same robot, terrain and action that is simulated in finer steps, to convergence.

        Args:
            timestep: of its simulator [s]; the schedule's time step stays.
            changes: other arguments of the class, for what the planner does not know: ``payload``, ``friction``, …

        Raises:
            ModelError: the schedule's time step is not a whole number of these.
        """
        steps = round(self.dt / timestep)
        if steps < 1 or abs(steps * timestep - self.dt) > 1e-9:
            raise ModelError(
                f"plant of '{self.name}': timestep does not divide the schedule's step - got {timestep:g} s, expected "
                f"{self.dt:g} s over a whole number; choose one"
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
        """Return which of some states, (..., nx), are falls, (...,); states that are not finite are.

        Args:
            states: states.
            fall: what counts as one.
        """
        x, fall = np.asarray(states, dtype=float), fall or Fall()
        finite = np.all(np.isfinite(x), axis=-1)
        x = np.where(finite[..., None], x, 0.0)
        upright = rotation.np_matrix(x[..., 3:7])[..., 2, 2]
        with np.errstate(invalid="ignore"):
            return np.asarray(~finite | (upright < np.cos(fall.tilt)) | (self.height_above_terrain(x) < fall.height))


def _step(robot: Robot, timestep: float, substeps: int) -> tuple[float, int]:
    """Return the simulator's step [s] and how many make one of the schedule; raise ModelError if they make no sense."""
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
