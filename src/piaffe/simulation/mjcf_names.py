"""Joints, base and feet of a robot in a MuJoCo model, by name."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from piaffe.errors import ModelError, UnknownNameError
from piaffe.models import Robot, import_mujoco

Array = NDArray[np.float64]
Kind = Literal["joint", "geom", "site", "body"]

_ROOT = 1  # index of the base in a pinocchio.Model; joint j of the state is _ROOT + 1 + j


def _names(model: Any, kind: Kind) -> dict[str, int]:
    count = {"joint": model.njnt, "geom": model.ngeom, "site": model.nsite, "body": model.nbody}[kind]
    return {getattr(model, kind)(i).name: i for i in range(count) if getattr(model, kind)(i).name}


def joint_ids(model: Any, robot: Robot, joints: Mapping[str, str], where: str) -> NDArray[np.int_]:
    """Return the id of the file's joint for each joint of the robot (n,).

    Raises:
        ModelError: a joint is missing, or of another kind, or two are one.
        UnknownNameError: ``joints`` names a joint that the robot does not have.
    """
    names = _names(model, "joint")
    for name in joints:
        if name not in robot.joint_names:
            raise UnknownNameError(f"{where}, joints", "joint of the robot", name, robot.joint_names)
    wanted = [joints.get(name, name) for name in robot.joint_names]
    missing = [own for own, name in zip(robot.joint_names, wanted, strict=True) if name not in names]
    if missing:
        free = {name for name, j in names.items() if model.jnt_type[j] == import_mujoco().mjtJoint.mjJNT_FREE}
        others = ", ".join(sorted(set(names) - set(wanted) - free)) or "no other joints"
        absent = ", ".join(joints.get(name, name) for name in missing)
        raise ModelError(
            f"{where}: joints of robot '{robot.name}' are missing - got {others}, expected {absent}; give "
            f"joints={{'{missing[0]}': '...', ...}}, on the command line --joint {missing[0]}=... or --names"
        )
    ids = np.array([names[name] for name in wanted])
    for i, (name, joint) in enumerate(zip(robot.joint_names, ids, strict=True)):
        if joint in ids[:i]:
            raise ModelError(
                f"{where}: two joints of the robot are one of the file - got '{model.joint(joint).name}' for '{name}' "
                f"and '{robot.joint_names[list(ids).index(joint)]}', expected another for each; fix joints"
            )
        kinds = import_mujoco().mjtJoint
        turns = bool(np.linalg.norm(robot.joint_axis(_ROOT + 1 + i)[3:]) > 0.5)
        if model.jnt_type[joint] != (kinds.mjJNT_HINGE if turns else kinds.mjJNT_SLIDE):
            got, expected = kinds(model.jnt_type[joint]).name, "hinge" if turns else "slide"
            raise ModelError(
                f"{where}, joint '{model.joint(joint).name}': it is of another kind - got {got}, expected a {expected} "
                f"as '{name}'; change the file, or joints"
            )
    return ids


def base_body(model: Any, robot: Robot, ids: NDArray[np.int_], where: str) -> int:
    """Return the body of the free joint under which all joints are."""
    free = import_mujoco().mjtJoint.mjJNT_FREE
    roots = {int(model.body_rootid[model.jnt_bodyid[joint]]) for joint in ids}
    root = next(iter(roots)) if len(roots) == 1 else 0
    if not root or not model.body_jntnum[root] or model.jnt_type[model.body_jntadr[root]] != free:
        got = ", ".join(sorted(f"'{model.body(each).name}'" for each in roots))
        raise ModelError(
            f"{where}: robot '{robot.name}' has no free joint - got joints under {got}, expected one body with a "
            "<freejoint/> above all joints; add it to the file"
        )
    return root


def no_others(model: Any, robot: Robot, ids: NDArray[np.int_], base: int, where: str) -> None:
    """Raise if the file's robot has joints that the robot does not have."""
    under = [j for j in range(model.njnt) if model.body_rootid[model.jnt_bodyid[j]] == base]
    others = [model.joint(j).name for j in under if j not in ids and j != model.body_jntadr[base]]
    if others:
        raise ModelError(
            f"{where}: it has joints that robot '{robot.name}' does not have - got {', '.join(others)}, expected only "
            "the robot's; weld them in the file"
        )


def find_foot(
    model: Any, robot: Robot, name: str, frame: str, feet: Mapping[str, str], where: str
) -> tuple[list[int], tuple[int, Array]]:
    """Return the geoms of a foot, and its body and place in the body's frame."""
    for given in feet:
        if given not in robot.foot_names:
            raise UnknownNameError(f"{where}, feet", "foot of the robot", given, robot.foot_names)
    wanted = (feet[name],) if name in feet else (name, frame)
    meets = collides(model)
    for label in wanted:
        if label in (geoms := _names(model, "geom")):
            geom = geoms[label]
            own, place = [geom] if meets[geom] else [], (int(model.geom_bodyid[geom]), model.geom_pos[geom])
        elif label in (sites := _names(model, "site")):
            body, at = int(model.site_bodyid[sites[label]]), model.site_pos[sites[label]]
            near = [g for g in np.flatnonzero(model.geom_bodyid == body).tolist() if meets[g]]
            own = sorted(near, key=lambda g: float(np.linalg.norm(model.geom_pos[g] - at)))[:1]
            place = (body, at)
        elif label in (bodies := _names(model, "body")):
            body = bodies[label]
            own = [g for g in np.flatnonzero(model.geom_bodyid == body).tolist() if meets[g]]
            place = (body, model.geom_pos[own].mean(axis=0) if own else np.zeros(3))
        else:
            continue
        if not own and label != wanted[-1]:
            continue
        if not own:
            raise ModelError(
                f"{where}, foot '{name}': '{label}' does not collide - got no geom with contacts, expected one; give "
                "feet with geoms that collide"
            )
        return own, place
    known = [label for kind in ("geom", "site", "body") for label in _names(model, kind)]
    raise UnknownNameError(f"{where}, foot '{name}'", "geom, site or body", " or ".join(wanted), known)


def collides(model: Any) -> NDArray[np.bool_]:
    """Return which geoms collide, by their own options or in a pair."""
    own: NDArray[np.bool_] = (model.geom_contype | model.geom_conaffinity) != 0
    own[np.concatenate([model.pair_geom1, model.pair_geom2]).astype(int)] = True
    return own
