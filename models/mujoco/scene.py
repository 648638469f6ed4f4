"""MuJoCo scenes of a robot, built from the numbers of its ``pinocchio.Model``: ``qpos`` and ``qvel`` are the state.

MuJoCo's URDF reader is not used, because it rejects valid merged inertias and may order joints differently. MuJoCo is
imported when a scene is made.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

import numpy as np
import pinocchio
from numpy.typing import NDArray

from piaffe.errors import ModelError

from ..links import body_names as body_names
from ..mujoco_import import import_mujoco
from ..robot import ROOT, Robot
from ..terrain import Flat, Terrain
from .action import BoundAction
from .hull import add_hull
from .look import add_shapes, add_surroundings, quaternion, scale

Array = NDArray[np.float64]
Contacts = Literal["none", "feet", "all"]

FOOT_GROUP = 3  # by default a viewer shows groups 0 to 2
_POINT = 1e-3  # [m], radius of the ball of a foot with radius 0


def mujoco_spec(
    robot: Robot,
    *,
    contacts: Contacts = "feet",
    friction: float = 0.6,
    dt: float = 0.002,
    joint_limits: bool = True,
    visuals: bool = True,
    meshes: bool = True,
    terrain: Terrain | None = None,
    action: BoundAction | None = None,
    surface: Mapping[str, Any] | None = None,
    hull: bool = False,
) -> Any:
    """Return an editable ``mujoco.MjSpec`` of the robot on a floor.

    The first body is the base with a free joint; hinges follow in state order, then torque actuators. ``qpos`` and
    ``qvel`` are the state x = (qpos, qvel) of every model. Feet are balls of ``robot.foot_radius``, at least 1 mm.

    MuJoCo does not accept principal inertias with A + B < C, which some published robots have (Mini Cheetah's thigh).
    MuJoCo's compiler replaces the inertias of such a body by their mean. :func:`mujoco_model` restores the exact ones;
    if you compile the spec yourself, call :func:`restore_inertias` afterwards.

    Args:
        robot: the robot.
        contacts: what collides with the floor: nothing, the feet, or all drawn shapes. Parts of the robot do not
            collide with each other.
        friction: sliding friction coefficient between feet and floor.
        dt: the simulator's time step [s].
        joint_limits: stop joints at their limits.
        visuals: draw the robot, with lights and a camera that follows it.
        meshes: draw the meshes of the URDF; False draws capsules between the joints in their place.
        terrain: the ground; level at z = 0 by default.
        action: the action that the actuators' controls are; torques by default.
        surface: contact options of the robot's geoms in place of ``friction``.
        hull: add a box for the base and balls at the knees, which collide with the ground.
    """
    mujoco = import_mujoco()
    spec = mujoco.MjSpec()
    spec.modelname = robot.name
    spec.compiler.degree = False
    spec.compiler.balanceinertia = True
    spec.option.timestep = dt
    spec.option.gravity = robot.model.gravity.linear
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    bodies = _add_bodies(mujoco, spec, robot, joint_limits)
    _add_floor(spec, contacts, friction, terrain or Flat())
    surface = surface or {"priority": 1, "friction": _slide(friction)}
    _add_feet(mujoco, robot, bodies, contacts, surface)
    if hull:
        add_hull(robot, bodies, surface)
    if action is None:
        _add_motors(mujoco, spec, robot)
    else:
        action.add_to(spec, robot)
    if visuals:
        add_shapes(spec, bodies, robot, meshes=meshes, collide=contacts == "all")
        add_surroundings(spec, bodies[ROOT], size=scale(robot))
    return spec


def mujoco_model(robot: Robot, **options: Any) -> Any:
    """Return the compiled ``mujoco.MjModel`` of :func:`mujoco_spec`."""
    return compile_spec(mujoco_spec(robot, **options), robot)


def compile_spec(spec: Any, robot: Robot) -> Any:
    """Return the compiled ``mujoco.MjModel`` of a spec, with the robot's exact inertias.

    Raises:
        ModelError: MuJoCo does not compile the spec, or orders the joints differently.
    """
    try:
        model = spec.compile()
    except ValueError as error:
        raise ModelError(
            f"robot '{robot.name}': MuJoCo does not compile it - got '{error}', expected a model that compiles; run "
            "`piaffe doctor` on its URDF"
        ) from error
    names = tuple(model.joint(i).name for i in range(1 if robot.base == "free" else 0, model.njnt))
    if names != robot.joint_names:
        raise ModelError(
            f"robot '{robot.name}': MuJoCo orders joints differently - got {names}, expected {robot.joint_names}; "
            "list joints depth-first in the URDF"
        )
    restore_inertias(model, robot)
    return model


def restore_inertias(model: Any, robot: Robot) -> None:
    """Write the robot's exact inertias into a compiled ``mujoco.MjModel`` where the compiler has changed them."""
    mujoco = import_mujoco()
    for name, inertia in zip(body_names(robot), list(robot.model.inertias)[ROOT:], strict=True):
        principal, axes = np.linalg.eigh(inertia.inertia)
        if principal[0] + principal[1] >= principal[2]:
            continue
        body = model.body(name)
        body.inertia[:] = principal
        body.iquat[:] = quaternion(axes * np.sign(np.linalg.det(axes)))
    mujoco.mj_setConst(model, mujoco.MjData(model))


# ---- the mechanism


def _add_bodies(mujoco: Any, spec: Any, robot: Robot, joint_limits: bool) -> dict[int, Any]:
    """Add one body per joint and return them by the joint's index in the pinocchio model."""
    model = robot.model
    bodies: dict[int, Any] = {}
    names = body_names(robot)
    for j in range(ROOT, model.njoints):
        place, inertia = model.jointPlacements[j], model.inertias[j]
        if j == ROOT and robot.base == "fixed":
            place = pinocchio.SE3.Identity()
        parent = spec.worldbody if j == ROOT else bodies[model.parents[j]]
        body = parent.add_body(name=names[j - ROOT], pos=place.translation, quat=quaternion(place.rotation))
        about_com = inertia.inertia
        body.explicitinertial = True
        body.mass = inertia.mass
        body.ipos = inertia.lever
        body.fullinertia = about_com[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
        bodies[j] = body
        if j == ROOT:
            if robot.base == "free":
                body.add_freejoint(name=model.names[j])
            continue
        i = j - ROOT - 1
        subspace = robot.joint_axis(j)
        turns = bool(np.linalg.norm(subspace[3:]) > 0.5)
        joint = body.add_joint(
            name=model.names[j],
            type=mujoco.mjtJoint.mjJNT_HINGE if turns else mujoco.mjtJoint.mjJNT_SLIDE,
            axis=subspace[3:] if turns else subspace[:3],
            armature=robot.armature[i],
            frictionloss=robot.joint_friction[i],
        )
        joint.damping[0] = robot.joint_damping[i]
        lower, upper = robot.joint_lower[i], robot.joint_upper[i]
        if joint_limits and (np.isfinite(lower) or np.isfinite(upper)):
            joint.limited = mujoco.mjtLimited.mjLIMITED_TRUE
            joint.range = (max(lower, -1e6), min(upper, 1e6))
    return bodies


def _add_motors(mujoco: Any, spec: Any, robot: Robot) -> None:
    """Add a torque actuator for each joint, in state order."""
    for name, limit in zip(robot.motor_names, robot.torque_limit[list(robot.motors)], strict=True):
        motor = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        motor.set_to_motor()
        if np.isfinite(limit):
            motor.ctrllimited = mujoco.mjtLimited.mjLIMITED_TRUE
            motor.ctrlrange = (-limit, limit)


def _add_feet(
    mujoco: Any, robot: Robot, bodies: dict[int, Any], contacts: Contacts, surface: Mapping[str, Any]
) -> None:
    """Add a ball and a site at every foot, both with the foot's name; ``surface`` are the ball's contact options."""
    for foot in robot.feet:
        frame = robot.model.frames[robot.frame_id(foot.frame)]
        body = bodies[frame.parentJoint]
        radius = max(robot.foot_radius, _POINT)
        place = frame.placement.translation
        body.add_geom(
            name=foot.name,
            type=mujoco.mjtGeom.mjGEOM_SPHERE,
            pos=place,
            size=(radius, 0, 0),
            group=FOOT_GROUP,
            rgba=(0.06, 0.06, 0.07, 1),
            contype=0,
            conaffinity=0 if contacts == "none" else 1,
            **surface,
        )
        body.add_site(name=foot.name, pos=place, size=(radius,) * 3, group=FOOT_GROUP)


def _add_floor(spec: Any, contacts: Contacts, friction: float, terrain: Terrain) -> None:
    terrain.add_to(spec, contype=0 if contacts == "none" else 1, conaffinity=0, condim=3, friction=_slide(friction))


def _slide(friction: float) -> tuple[float, float, float]:
    """Return MuJoCo's three coefficients for sliding friction."""
    return (friction, 0.005, 0.0001)
