"""MuJoCo scenes of a robot, built from the numbers of its ``pinocchio.Model``: ``qpos`` and ``qvel`` are the state.

MuJoCo's own URDF reader is not used: it refuses valid merged inertias and may order joints differently. MuJoCo is
imported when a scene is made.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
import pinocchio
from numpy.typing import NDArray

from piaffe.errors import ModelError

from .robot import ROOT, Robot

Array = NDArray[np.float64]
Contacts = Literal["none", "feet", "all"]

FLOOR = "floor"
CAMERA = "track"
VISUAL_GROUP, FOOT_GROUP = 1, 3  # a viewer shows groups 0 to 2 unless told otherwise
_POINT = 1e-3  # [m], the ball of a foot of radius 0


def mujoco_spec(
    robot: Robot,
    *,
    contacts: Contacts = "feet",
    friction: float = 0.6,
    dt: float = 0.002,
    joint_limits: bool = True,
    visuals: bool = True,
    meshes: bool = True,
) -> Any:
    """Return an editable ``mujoco.MjSpec`` of the robot on a floor.

    The first body is the base with a free joint; hinges follow in state order, then torque actuators. ``qpos`` and
    ``qvel`` are the state x = (qpos, qvel) of every model. Feet are balls of ``robot.foot_radius``, at least 1 mm.

    MuJoCo accepts no inertia with A + B < C, which published robots have (Mini Cheetah's thigh): compiled by itself,
    the spec gives such a body the mean of its principal inertias. :func:`mujoco_model`, or :func:`restore_inertias`
    after an own compile, puts the exact ones back.

    Args:
        robot: the robot.
        contacts: what touches the floor: nothing, the feet, or all drawn shapes. Parts of the robot never touch.
        friction: sliding friction coefficient between feet and floor.
        dt: the simulator's time step [s].
        joint_limits: stop joints at their limits.
        visuals: draw the robot, with lights and a camera that follows it.
        meshes: draw meshes where the URDF has them; else capsules between the joints.
    """
    mujoco = _import_mujoco()
    spec = mujoco.MjSpec()
    spec.modelname = robot.name
    spec.compiler.degree = False
    spec.compiler.balanceinertia = True
    spec.option.timestep = dt
    spec.option.gravity = robot.model.gravity.linear
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    bodies = _add_bodies(mujoco, spec, robot, joint_limits)
    _add_floor(mujoco, spec, contacts, friction)
    _add_feet(mujoco, robot, bodies, contacts, friction)
    _add_actuators(mujoco, spec, robot)
    if visuals:
        draw(spec, bodies, robot, meshes=meshes, collide=contacts == "all")
        stage(spec, bodies[ROOT], size=_size(robot))
    return spec


def mujoco_model(robot: Robot, **options: Any) -> Any:
    """Return the compiled ``mujoco.MjModel`` of :func:`mujoco_spec`."""
    try:
        model = mujoco_spec(robot, **options).compile()
    except ValueError as error:
        raise ModelError(
            f"robot '{robot.name}': MuJoCo refuses it - got '{error}', expected a model that compiles; see what "
            "`piaffe doctor` says of its URDF"
        ) from error
    names = tuple(model.joint(i).name for i in range(1, model.njnt))
    if names != robot.joint_names:
        raise ModelError(
            f"robot '{robot.name}': MuJoCo orders joints differently - got {names}, expected {robot.joint_names}; "
            "list joints depth-first in the URDF"
        )
    restore_inertias(model, robot)
    return model


def restore_inertias(model: Any, robot: Robot) -> None:
    """Put the robot's exact inertias into a compiled ``mujoco.MjModel`` where the compiler balanced them."""
    mujoco = _import_mujoco()
    for name, inertia in zip(body_names(robot), list(robot.model.inertias)[ROOT:], strict=True):
        principal, axes = np.linalg.eigh(inertia.inertia)
        if principal[0] + principal[1] >= principal[2]:
            continue
        body = model.body(name)
        body.inertia[:] = principal
        body.iquat[:] = _quaternion(axes * np.sign(np.linalg.det(axes)))
    mujoco.mj_setConst(model, mujoco.MjData(model))


def body_names(robot: Robot) -> tuple[str, ...]:
    """Return the name of the link that each joint moves, the base's first."""
    names: dict[int, str] = {}
    for frame in robot.model.frames:
        if frame.type == pinocchio.FrameType.BODY and frame.parentJoint not in names:
            names[frame.parentJoint] = frame.name
    return tuple(names.get(j, robot.model.names[j]) for j in range(ROOT, robot.model.njoints))


def _import_mujoco() -> Any:
    try:
        import mujoco
    except ImportError as error:
        raise ModelError(
            "mujoco scene: MuJoCo is not installed - got no package 'mujoco', expected it; pip install mujoco"
        ) from error
    return mujoco


def _quaternion(rotation: Array) -> Array:
    """Return the quaternion, w first, of a rotation matrix."""
    x, y, z, w = pinocchio.Quaternion(rotation).coeffs()
    return np.array([w, x, y, z])


# ---- the mechanism


def _add_bodies(mujoco: Any, spec: Any, robot: Robot, joint_limits: bool) -> dict[int, Any]:
    """Add one body per joint and return them by the joint's index in the pinocchio model."""
    model = robot.model
    bodies: dict[int, Any] = {}
    names = body_names(robot)
    for j in range(ROOT, model.njoints):
        place, inertia = model.jointPlacements[j], model.inertias[j]
        parent = spec.worldbody if j == ROOT else bodies[model.parents[j]]
        body = parent.add_body(name=names[j - ROOT], pos=place.translation, quat=_quaternion(place.rotation))
        about_com = inertia.inertia
        body.explicitinertial = True
        body.mass = inertia.mass
        body.ipos = inertia.lever
        body.fullinertia = about_com[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
        bodies[j] = body
        if j == ROOT:
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
        )
        lower, upper = robot.joint_lower[i], robot.joint_upper[i]
        if joint_limits and (np.isfinite(lower) or np.isfinite(upper)):
            joint.limited = mujoco.mjtLimited.mjLIMITED_TRUE
            joint.range = (max(lower, -1e6), min(upper, 1e6))
    return bodies


def _add_actuators(mujoco: Any, spec: Any, robot: Robot) -> None:
    """Add a torque per joint, in state order."""
    for name, limit in zip(robot.joint_names, robot.torque_limit, strict=True):
        motor = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        motor.set_to_motor()
        if np.isfinite(limit):
            motor.ctrllimited = mujoco.mjtLimited.mjLIMITED_TRUE
            motor.ctrlrange = (-limit, limit)


def _add_feet(mujoco: Any, robot: Robot, bodies: dict[int, Any], contacts: Contacts, friction: float) -> None:
    """Add a ball and a site at every foot, both with the foot's name; the ball's friction is the contact's."""
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
            priority=1,
            friction=(friction, 0.005, 0.0001),
        )
        body.add_site(name=foot.name, pos=place, size=(radius,) * 3, group=FOOT_GROUP)


def _add_floor(mujoco: Any, spec: Any, contacts: Contacts, friction: float) -> None:
    spec.worldbody.add_geom(
        name=FLOOR,
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=(0, 0, 0.05),
        contype=0 if contacts == "none" else 1,
        conaffinity=0,
        condim=3,
        friction=(friction, 0.005, 0.0001),
    )


# ---- how it looks


def draw(spec: Any, bodies: dict[int, Any], robot: Robot, *, meshes: bool, collide: bool) -> None:
    """Add what is seen of the robot: the URDF's shapes, or capsules between the joints."""
    mujoco = _import_mujoco()
    mark = {"group": VISUAL_GROUP, "contype": 0, "conaffinity": 1 if collide else 0}
    visual = robot.visual
    objects = [] if visual is None else list(visual.geometryObjects)
    if not objects or (not meshes and any(_is_mesh(item) for item in objects)):
        _draw_capsules(mujoco, bodies, robot, mark)
        return
    for item in objects:
        colour = np.asarray(item.meshColor)
        body = bodies[item.parentJoint]
        look = {"pos": item.placement.translation, "quat": _quaternion(item.placement.rotation), "rgba": colour, **mark}
        _draw_shape(mujoco, spec, body, item, look)


def _is_mesh(item: Any) -> bool:
    return type(item.geometry).__name__ not in ("Box", "Cylinder", "Sphere", "Capsule")


def _draw_shape(mujoco: Any, spec: Any, body: Any, item: Any, look: dict[str, Any]) -> None:
    shape, types = item.geometry, mujoco.mjtGeom
    match type(shape).__name__:
        case "Box":
            body.add_geom(type=types.mjGEOM_BOX, size=shape.halfSide, **look)
        case "Cylinder":
            body.add_geom(type=types.mjGEOM_CYLINDER, size=(shape.radius, shape.halfLength, 0), **look)
        case "Capsule":
            body.add_geom(type=types.mjGEOM_CAPSULE, size=(shape.radius, shape.halfLength, 0), **look)
        case "Sphere":
            body.add_geom(type=types.mjGEOM_SPHERE, size=(shape.radius, 0, 0), **look)
        case _:
            name = f"{item.meshPath} {np.asarray(item.meshScale).tolist()}"
            if name not in {mesh.name for mesh in spec.meshes}:
                mesh = spec.add_mesh(name=name, inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL)
                faces = np.array([[t[0], t[1], t[2]] for t in (shape.tri_indices(i) for i in range(shape.num_tris))])
                mesh.uservert, mesh.userface = np.asarray(shape.vertices()).ravel(), faces.ravel()
            body.add_geom(type=types.mjGEOM_MESH, meshname=name, **look)


def _draw_capsules(mujoco: Any, bodies: dict[int, Any], robot: Robot, mark: dict[str, Any]) -> None:
    """Draw a box between the legs' first joints, a capsule from each joint to the next and a ball at each foot."""
    model, size = robot.model, _size(robot)
    thick = 0.035 * size
    joints = range(ROOT + 1, model.njoints)
    ends: list[tuple[int, Array]] = [(model.parents[j], model.jointPlacements[j].translation) for j in joints]
    hips = [end for joint, end in ends if joint == ROOT]
    if hips:
        half = np.maximum(np.abs(hips).max(axis=0), 0.1 * size) * (1, 0.8, 1)
        bodies[ROOT].add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=half, rgba=(0.16, 0.17, 0.19, 1), **mark)
    for foot in robot.feet:
        frame = model.frames[robot.frame_id(foot.frame)]
        ends.append((frame.parentJoint, frame.placement.translation))
        bodies[frame.parentJoint].add_geom(
            type=mujoco.mjtGeom.mjGEOM_SPHERE, pos=frame.placement.translation,
            size=(max(robot.foot_radius, 0.8 * thick), 0, 0), rgba=(0.06, 0.06, 0.07, 1), **mark,
        )  # fmt: skip
    for joint, end in ends:
        if joint != ROOT and np.linalg.norm(end) > thick:
            bodies[joint].add_geom(
                type=mujoco.mjtGeom.mjGEOM_CAPSULE, fromto=(0, 0, 0, *end), size=(thick, 0, 0),
                rgba=(0.93, 0.60, 0.10, 1), **mark,
            )  # fmt: skip


def stage(spec: Any, base: Any, size: float) -> None:
    """Add sky, floor pattern, lights and a camera that follows the base; ``size`` is the robot's length [m]."""
    mujoco = _import_mujoco()
    textures = mujoco.mjtTexture
    spec.add_texture(
        name="sky", type=textures.mjTEXTURE_SKYBOX, builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=(0.86, 0.90, 0.95), rgb2=(0.55, 0.64, 0.75), width=256, height=256,
    )  # fmt: skip
    spec.add_texture(
        name="tiles", type=textures.mjTEXTURE_2D, builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER,
        rgb1=(0.80, 0.82, 0.84), rgb2=(0.74, 0.76, 0.79), mark=mujoco.mjtMark.mjMARK_EDGE, markrgb=(0.88, 0.89, 0.90),
        width=512, height=512,
    )  # fmt: skip
    tiles = spec.add_material(name="tiles", texuniform=True, texrepeat=(1 / size, 1 / size), reflectance=0.12)
    tiles.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "tiles"
    floor = spec.geom(FLOOR)
    if floor is not None:
        floor.material = "tiles"
    spec.visual.headlight.ambient = (0.35, 0.35, 0.37)
    spec.visual.headlight.diffuse = (0.25, 0.25, 0.25)
    spec.visual.headlight.specular = (0.1, 0.1, 0.1)
    spec.visual.rgba.haze = (0.86, 0.90, 0.95, 1)
    spec.visual.quality.shadowsize = 4096
    spec.visual.quality.offsamples = 8
    spec.visual.global_.offwidth, spec.visual.global_.offheight = 1920, 1080
    spec.stat.extent, spec.stat.center = 2.0 * size, (0, 0, 0.3 * size)
    light = mujoco.mjtLightType.mjLIGHT_DIRECTIONAL
    follow = mujoco.mjtCamLight.mjCAMLIGHT_TRACK
    base.add_light(
        name="sun", type=light, mode=follow, pos=(1 * size, -2 * size, 4 * size), dir=(-0.35, 0.45, -1),
        diffuse=(0.75, 0.73, 0.70), specular=(0.3, 0.3, 0.3), castshadow=True,
    )  # fmt: skip
    sideways = np.array([-1.6, -2.6, 0.9]) * size
    base.add_camera(name=CAMERA, mode=follow, pos=sideways, quat=_look_at(-sideways), fovy=32)


def _look_at(direction: Sequence[float] | Array) -> Array:
    """Return the quaternion of a camera (looks along −z, y up) that looks along a direction, level."""
    back = -np.asarray(direction, dtype=float) / np.linalg.norm(direction)
    right = np.cross((0.0, 0.0, 1.0), back)
    right /= np.linalg.norm(right)
    return _quaternion(np.column_stack([right, np.cross(back, right), back]))


def _size(robot: Robot) -> float:
    """Return the distance between the outermost joints at the base [m], a scale for what is drawn."""
    model = robot.model
    joints = range(ROOT + 1, model.njoints)
    hips = [model.jointPlacements[j].translation for j in joints if model.parents[j] == ROOT]
    return float(np.ptp(hips, axis=0).max()) if len(hips) > 1 else 0.5
