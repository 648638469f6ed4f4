"""A Solo12 to roll out, for tests that need a simulator and no model of the language."""

from types import SimpleNamespace

import mujoco
import numpy as np

from piaffe import models
from piaffe.models.mujoco.scene import mujoco_spec, restore_inertias

CROUCH = np.tile([0.0, 0.6, -1.0], 4)  # [rad]
RANGE = np.tile([0.3, 0.4, 0.4], 4)  # [rad]
STANDING = np.r_[0, 0, 0.29, 1, 0, 0, 0, CROUCH, np.zeros(18)]


def simulated(substeps=1, dt=0.02, **options):
    """What engines simulate: a robot whose control is 12 joint targets."""
    robot = models.load("solo12")
    spec = mujoco_spec(robot, visuals=False, joint_limits=False, friction=1.0, dt=dt)
    spec.option.cone = mujoco.mjtCone.mjCONE_PYRAMIDAL
    spec.option.iterations, spec.option.ls_iterations = 10, 5
    spec.option.disableflags = int(mujoco.mjtDisableBit.mjDSBL_EULERDAMP)
    for name, value in options.items():
        setattr(spec.option, name, value)
    for joint in spec.joints:
        if joint.type == mujoco.mjtJoint.mjJNT_HINGE:
            joint.armature = 0.01
    for actuator in spec.actuators:
        actuator.set_to_position(kp=4.0, kv=0.2)
        actuator.ctrllimited = mujoco.mjtLimited.mjLIMITED_FALSE
        actuator.forcelimited = mujoco.mjtLimited.mjLIMITED_TRUE
        actuator.forcerange = (-4.0, 4.0)
    model = spec.compile()
    restore_inertias(model, robot)
    return SimpleNamespace(compiled=lambda: model, substeps=substeps)


def controls(n, steps, seed=0):
    """Joint targets spread over their range, (n, steps, 12)."""
    return CROUCH + RANGE * np.random.default_rng(seed).uniform(-1, 1, (n, steps, 12))
