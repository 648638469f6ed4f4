"""Visual elements of a MuJoCo scene: shapes of the robot, floor, sky, lights, and a camera that follows the robot."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pinocchio
from numpy.typing import NDArray

from ..mujoco_import import import_mujoco
from ..robot import ROOT, Robot
from ..terrain import FLOOR

Array = NDArray[np.float64]

CAMERA = "track"
VISUAL_GROUP = 1


def quaternion(rotation: Array) -> Array:
    """Return the quaternion, w first, of a rotation matrix, (4,)."""
    x, y, z, w = pinocchio.Quaternion(rotation).coeffs()
    return np.array([w, x, y, z])


def add_shapes(spec: Any, bodies: dict[int, Any], robot: Robot, *, meshes: bool, collide: bool) -> None:
    """Add the robot's visual shapes from its URDF; without them its collision shapes; without these capsules."""
    mujoco = import_mujoco()
    mark = {"group": VISUAL_GROUP, "contype": 0, "conaffinity": 1 if collide else 0}
    shapes = next((s for s in (_shapes(robot.visual, meshes), _shapes(robot.collision, meshes)) if s), [])
    if not shapes:
        _draw_capsules(mujoco, bodies, robot, mark)
    for item in shapes:
        place, rotation = item.placement.translation, item.placement.rotation
        look = {"pos": place, "quat": quaternion(rotation), "rgba": np.asarray(item.meshColor), **mark}
        _draw_shape(mujoco, spec, bodies[item.parentJoint], item, look)


def _shapes(geometry: pinocchio.GeometryModel | None, meshes: bool) -> list[Any]:
    """Return the shapes of a geometry; an empty list if some of them cannot be drawn."""
    items = [] if geometry is None else list(geometry.geometryObjects)
    drawable = all(_mesh_is_whole(item.geometry) if _is_mesh(item) else True for item in items)
    return items if drawable and (meshes or not any(map(_is_mesh, items))) else []


def _mesh_is_whole(shape: Any) -> bool:
    """Return whether the triangles of a mesh use most of its vertices; parts of some files are not read."""
    return bool(shape.num_tris) and int(_faces(shape).max()) > 0.75 * shape.num_vertices


def _faces(shape: Any) -> NDArray[np.int64]:
    """Return the vertices of each triangle of a mesh, (n, 3).

    The reader of Collada files counts the vertices of every part of a file from zero. A part begins with (0, 1, 2).
    """
    faces = np.array([[t[0], t[1], t[2]] for t in (shape.tri_indices(i) for i in range(shape.num_tris))])
    parts = np.split(faces, np.flatnonzero((faces == (0, 1, 2)).all(axis=1)))
    sizes = [int(part.max()) + 1 if len(part) else 0 for part in parts]
    if sum(sizes) != shape.num_vertices:
        return faces
    return np.concatenate([part + start for part, start in zip(parts, np.cumsum([0, *sizes[:-1]]), strict=True)])


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
                mesh.uservert, mesh.userface = np.asarray(shape.vertices()).ravel(), _faces(shape).ravel()
            body.add_geom(type=types.mjGEOM_MESH, meshname=name, **look)


def _draw_capsules(mujoco: Any, bodies: dict[int, Any], robot: Robot, mark: dict[str, Any]) -> None:
    """Draw a box between the legs' first joints, a capsule from each joint to the next and a ball at each foot."""
    model, size = robot.model, scale(robot)
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


def add_surroundings(spec: Any, base: Any, size: float) -> None:
    """Add sky, floor pattern, lights and a camera that follows the base; ``size`` is the robot's length [m]."""
    mujoco = import_mujoco()
    textures = mujoco.mjtTexture
    spec.add_texture(
        name="sky", type=textures.mjTEXTURE_SKYBOX, builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=(0.86, 0.90, 0.95), rgb2=(0.55, 0.64, 0.75), width=256, height=256,
    )  # fmt: skip
    spec.add_texture(
        name="tiles", type=textures.mjTEXTURE_2D, builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER,
        rgb1=(0.93, 0.94, 0.96), rgb2=(0.85, 0.87, 0.90), mark=mujoco.mjtMark.mjMARK_EDGE, markrgb=(0.98, 0.98, 0.99),
        width=512, height=512,
    )  # fmt: skip
    tiles = spec.add_material(name="tiles", texuniform=True, texrepeat=(1 / size, 1 / size), reflectance=0.08)
    tiles.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "tiles"
    floor = spec.geom(FLOOR)
    if floor is not None:
        floor.material = "tiles"
    spec.visual.headlight.ambient = (0.30, 0.30, 0.32)
    spec.visual.headlight.diffuse = (0.20, 0.20, 0.20)
    spec.visual.headlight.specular = (0.1, 0.1, 0.1)
    spec.visual.rgba.haze = (0.86, 0.90, 0.95, 1)
    spec.visual.map.shadowclip = 4.0
    spec.visual.quality.shadowsize = 8192
    spec.visual.quality.offsamples = 8
    spec.visual.global_.offwidth, spec.visual.global_.offheight = 1920, 1080
    spec.stat.extent, spec.stat.center = 2.0 * size, (0, 0, 0.3 * size)
    light = mujoco.mjtLightType.mjLIGHT_DIRECTIONAL
    follow = mujoco.mjtCamLight.mjCAMLIGHT_TRACK
    base.add_light(
        name="sun", type=light, mode=follow, pos=(1 * size, -2 * size, 4 * size), dir=(-0.35, 0.45, -1),
        diffuse=(0.62, 0.60, 0.57), specular=(0.2, 0.2, 0.2), castshadow=True,
    )  # fmt: skip
    place = np.array([1.7, -3.3, 0.9]) * size  # in front of the robot, to its right; looks at a point below the base
    base.add_camera(name=CAMERA, mode=follow, pos=place, quat=_look_at((0, 0, -0.25 * size) - place), fovy=30)


def _look_at(direction: Sequence[float] | Array) -> Array:
    """Return the quaternion of a level camera that looks along a direction; its axes are −z forward, y up."""
    back = -np.asarray(direction, dtype=float) / np.linalg.norm(direction)
    right = np.cross((0.0, 0.0, 1.0), back)
    right /= np.linalg.norm(right)
    return quaternion(np.column_stack([right, np.cross(back, right), back]))


def scale(robot: Robot) -> float:
    """Return the largest distance between joints at the base [m], the length scale of the visual elements."""
    model = robot.model
    joints = range(ROOT + 1, model.njoints)
    hips = [model.jointPlacements[j].translation for j in joints if model.parents[j] == ROOT]
    return float(np.ptp(hips, axis=0).max()) if len(hips) > 1 else 0.5
