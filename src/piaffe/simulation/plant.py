"""A plant: a robot in MuJoCo with actuators and sensors, which may differ from the model of a plan."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from piaffe.errors import ModelError, ShapeError
from piaffe.models import Payload, Robot
from piaffe.models.terrain import Terrain

from .actuators import Actuators, Drive
from .adjust import add_payload, finish, named_bodies, scale_masses, set_joints
from .mjcf import scene_of_file
from .numbers import finite_number
from .policy_run import torque_plant
from .scene import Scene, forbid, scene_of
from .sensors import SensorNoise, Sensors
from .simulation import Simulation

Array = NDArray[np.float64]

FRICTION = 0.6
"""Sliding friction coefficient of a plant's feet by default."""


class Plant:
    """A robot to simulate: what a controller acts on in :func:`run_online`. Controls are torques on the joints.

    Feet, base and knees collide with the ground.

    Args:
        robot: the robot; its torque limits and armature are the plant's, unless ``actuators`` has others.
        timestep: of the simulator [s], at most 2 ms.
        friction: sliding friction coefficient of the robot's surface.
        terrain: the ground; level at z = 0 by default.
        payload: a mass on the base, see ``models.payload``.
        mass_scale: factor of masses and inertias, or one for each named link, as ``{"trunk": 1.05}``.
        actuators: damping, friction, limits and delay of the joints.
        noise: standard deviations of the sensors; none by default.

    Raises:
        ModelError: a number is out of range.
        UnknownNameError: a mapping has an unknown name.
    """

    def __init__(
        self,
        robot: Robot,
        *,
        timestep: float = 1e-3,
        friction: float = FRICTION,
        terrain: Terrain | None = None,
        payload: Payload | None = None,
        mass_scale: float | Mapping[str, float] = 1.0,
        actuators: Actuators | None = None,
        noise: SensorNoise | None = None,
    ) -> None:
        check(timestep, friction)
        model = torque_plant(robot, timestep=timestep, friction=friction, ground=terrain)
        self._finish(scene_of(model), robot.torque_limit, payload, mass_scale, actuators, noise)

    @classmethod
    def from_mjcf(
        cls,
        path: str | Path,
        robot: Robot,
        *,
        joints: Mapping[str, str] | None = None,
        feet: Mapping[str, str] | None = None,
        timestep: float = 1e-3,
        friction: float | None = None,
        terrain: Terrain | None = None,
        payload: Payload | None = None,
        mass_scale: float | Mapping[str, float] = 1.0,
        actuators: Actuators | None = None,
        noise: SensorNoise | None = None,
        tolerance: float = 0.02,
    ) -> Plant:
        """Return a plant from a MuJoCo model of the same robot with numbers of its own.

        The file's joints may have another order and other names, its robot needs a free joint. Torques act on the
        joints directly: the file's actuators do not act, but their limits of force hold, and those of its joints. What
        the file has of masses, armature, damping, dry friction, contacts and solver counts, unless it is given here.

        Args:
            path: the file.
            robot: the robot for which plans are made.
            joints: from the robot's joints to those of the file, as ``{"FL_hip_joint": "fl.hx"}``; joints that are left
                out have the same name.
            feet: from the robot's feet to geoms, sites or bodies of the file; a foot that is left out has its name or
                that of its frame. For a site, the geom of its body that collides and is nearest to it counts.
            timestep: of the simulator [s], at most 2 ms.
            friction: sliding friction coefficient of all geoms; by default the file's.
            terrain: the ground, for a file without one; level at z = 0 by default.
            payload: a mass on the base.
            mass_scale: factor of masses and inertias, or one for each named body of the file.
            actuators: numbers of the joints in place of the file's.
            noise: standard deviations of the sensors.
            tolerance: largest distance between joints and feet of the file and those of the robot [m].

        Raises:
            ModelError: the file cannot be read, joints are missing or are not where the robot's are, or a number is out
                of range.
            UnknownNameError: there is no such joint, foot or body.
        """
        check(timestep, 0.0 if friction is None else friction)
        scene, limit = scene_of_file(
            path, robot, joints=joints, feet=feet, timestep=timestep, friction=friction, terrain=terrain,
            tolerance=tolerance,
        )  # fmt: skip
        plant = cls.__new__(cls)
        plant._finish(scene, limit, payload, mass_scale, actuators, noise)
        return plant

    def _finish(
        self,
        scene: Scene,
        torque_limit: Array,
        payload: Payload | None,
        mass_scale: float | Mapping[str, float],
        actuators: Actuators | None,
        noise: SensorNoise | None,
    ) -> None:
        """Set the attributes: a scene with direct torques and with the changes that were asked for."""
        _require_legs(scene.robot)
        self.robot, self.actuators = scene.robot, actuators or Actuators()
        self.noise = noise or SensorNoise()
        self.scene = Scene(**{**vars(scene), "direct": True})
        self.model = torque_plant(scene.robot)
        """The robot without the plant's changes, for random starts: ``Perturbation().around(plant.model, x, seed)``."""
        self.space = self.model.state
        forbid(self.scene.compiled, "ACTUATION")
        scale_masses(self.scene, mass_scale)
        if payload is not None:
            add_payload(self.scene, payload)
        set_joints(self.scene, self.actuators)
        finish(self.scene)
        self._limit = torque_limit
        self.torque_limit = self._drive().torque_limit
        """Largest torques (n,) [Nm]."""

    @property
    def timestep(self) -> float:
        """Time step of the simulator [s]."""
        return float(self.scene.compiled.opt.timestep)

    @property
    def links(self) -> tuple[str, ...]:
        """Names of the bodies for ``mass_scale``, the base first."""
        return tuple(named_bodies(self.scene))

    def _drive(self) -> Drive:
        return Drive.of(self.actuators, self.robot, self._limit, self.timestep)

    def simulate(self, x: ArrayLike) -> Simulation:
        """Return a simulation that begins in a state (nx,).

        Raises:
            ShapeError: the state has another size.
            ModelError: the state is not finite.
        """
        state = np.array(x, dtype=float)
        if state.shape != (self.space.nx,):
            raise ShapeError(
                f"plant of '{self.robot.name}': state has the wrong size - got shape {state.shape}, expected "
                f"({self.space.nx},); give a state of this robot"
            )
        if not np.all(np.isfinite(state)):
            raise ModelError(
                f"plant of '{self.robot.name}': state is not finite - got {state!r}, expected finite numbers; fix it"
            )
        return Simulation(self.scene, state, self._drive())

    def sensors(self, seed: int) -> Sensors:
        """Return its sensors, whose noise follows from a seed."""
        return Sensors(self.noise, self.space, np.array(self.scene.compiled.opt.gravity), seed)

    def __repr__(self) -> str:
        mass = float(self.scene.compiled.body_subtreemass[self.scene.base])
        return f"Plant('{self.robot.name}', {mass:.3f} kg, {1e3 * self.timestep:g} ms)"


def check(timestep: float, friction: float) -> None:
    """Raise ModelError unless time step and friction are in range."""
    if not 0 < finite_number("plant", "timestep", timestep) <= 2e-3:
        raise ModelError(
            f"plant: timestep is out of range - got {timestep!r}, expected 0 to 0.002 s; contacts need small steps"
        )
    if finite_number("plant", "friction", friction) < 0:
        raise ModelError(f"plant: friction is out of range - got {friction!r}, expected a number ≥ 0; change it")


def _require_legs(robot: Robot) -> None:
    """Raise ModelError unless the base floats and every joint has a motor."""
    passive = [name for name in robot.joint_names if name not in robot.motor_names]
    if robot.base == "fixed" or passive:
        got = "a fixed base" if robot.base == "fixed" else f"joints without a motor, {passive}"
        raise ModelError(
            f"plant: robot '{robot.name}' is not supported - got {got}, expected a floating base and a motor at every "
            "joint; use simulation.execute, as `piaffe verify --simulate` does"
        )
