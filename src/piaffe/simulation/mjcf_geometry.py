"""Whether the geometry of a MuJoCo model is that of a robot, and the torque limits that it has."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from piaffe.errors import ModelError
from piaffe.models import Robot, import_mujoco

Array = NDArray[np.float64]

_ROOT = 1  # index of the base in a pinocchio.Model; joint j of the state is _ROOT + 1 + j
_BEND = 0.4  # [rad]
_PARALLEL = 0.999  # least cosine between axes that count as the same


def compare(
    model: Any, robot: Robot, ids: NDArray[np.int_], base: int, feet: Mapping[str, tuple[int, Array]], tolerance: float,
    where: str,
) -> None:  # fmt: skip
    """Raise unless axes and places of joints, and places of feet, are those of the robot in a bent pose."""
    mujoco, angles = import_mujoco(), robot.pose("stand")
    angles += _BEND * np.sin(1.0 + 2.0 * np.arange(robot.num_joints))  # other angles in each leg: legs may be mixed up
    data, own = mujoco.MjData(model), robot.model.createData()
    q = pin.neutral(robot.model)
    q[7:] = angles
    data.qpos[model.jnt_qposadr[ids]] = angles
    mujoco.mj_kinematics(model, data)
    pin.framesForwardKinematics(robot.model, own, q)
    origin, to_base = data.xpos[base], data.xmat[base].reshape(3, 3).T
    for i, (name, joint) in enumerate(zip(robot.joint_names, ids, strict=True)):
        placement, motion = own.oMi[_ROOT + 1 + i], robot.joint_axis(_ROOT + 1 + i)
        turns = bool(np.linalg.norm(motion[3:]) > 0.5)
        expected = placement.rotation @ (motion[3:] if turns else motion[:3])
        got, label = to_base @ data.xaxis[joint], model.joint(joint).name
        if got @ expected < _PARALLEL:
            raise ModelError(
                f"{where}, joint '{label}': its axis is not that of '{name}' - got {_text(got)} in the base, expected "
                f"{_text(expected)} in the compared pose; turn the axis in the file, or fix joints"
            )
        off = to_base @ (data.xanchor[joint] - origin) - placement.translation
        distance = float(np.linalg.norm(off - (off @ expected) * expected))
        if turns and distance > tolerance:
            raise ModelError(
                f"{where}, joint '{label}': it is not where '{name}' is - got {1e3 * distance:.1f} mm between their "
                f"axes in the compared pose, expected at most {1e3 * tolerance:g} mm; compare zero angles and lengths"
            )
    for name, (body, place) in feet.items():
        got = to_base @ (data.xpos[body] + data.xmat[body].reshape(3, 3) @ place - origin)
        expected = own.oMf[robot.frame_id(robot.foot(name).frame)].translation
        if (distance := float(np.linalg.norm(got - expected))) > tolerance:
            raise ModelError(
                f"{where}, foot '{name}': it is not where the robot's is - got {_text(got)} m in the base, expected "
                f"{_text(expected)} m in the compared pose, {1e3 * distance:.1f} mm away; fix feet, or zero angles"
            )


def torque_limits(model: Any, robot: Robot, ids: NDArray[np.int_]) -> Array:
    """Return the smallest limit that the file has for each joint, by joint or actuator; else the robot's."""
    mujoco = import_mujoco()
    limits = np.array(robot.torque_limit, dtype=float)
    for i, joint in enumerate(ids):
        found = [model.jnt_actfrcrange[joint]] if model.jnt_actfrclimited[joint] else []
        for a in range(model.nu):
            if model.actuator_trntype[a] != mujoco.mjtTrn.mjTRN_JOINT or model.actuator_trnid[a, 0] != joint:
                continue
            gear, motor = (
                abs(float(model.actuator_gear[a, 0])),
                model.actuator_biastype[a] == mujoco.mjtBias.mjBIAS_NONE,
            )
            if model.actuator_forcelimited[a]:
                found.append(gear * model.actuator_forcerange[a])
            if model.actuator_ctrllimited[a] and motor:
                found.append(gear * abs(float(model.actuator_gainprm[a, 0])) * model.actuator_ctrlrange[a])
        if found:
            limits[i] = min(float(np.min(np.abs(each))) for each in found)
    return limits


def _text(place: Array) -> str:
    return "(" + ", ".join(f"{value:.3f}" for value in place) + ")"
