"""What a plan was made from, found again without the controller: MuJoCo stepped by hand, and controls from plans."""

import mujoco
import numpy as np


def stepped(model, x0, controls):
    """Return the states of one roll-out, (S + 1, nx): each control is held over the model's steps of the simulator."""
    compiled = model.compiled()
    data, states = mujoco.MjData(compiled), [x0]
    data.qpos[:], data.qvel[:] = x0[: compiled.nq], x0[compiled.nq :]
    for control in controls:
        data.ctrl[:] = control
        for _ in range(model.substeps):
            mujoco.mj_step(compiled, data)
        states.append(np.r_[data.qpos, data.qvel])
    return np.array(states)


def rolled_out(controller, plan, before=None):
    """Return the controls of the two roll-outs of a plan with one sample and one stage, (2, H + 1, nu).

    There are to be as many knots as steps, so that nodes of the spline are controls. The second roll-out is the plan
    before, seen from now on and continued by the centre of the range; the first plan of all holds the joints. Their
    mean by weight is the new plan, which gives the first one.

    Args:
        controller: whose plan it is.
        plan: the plan.
        before: the plan before; None if there was none.
    """
    if before is None:
        nominal = np.tile(plan.states[0, 0, 7:19], (len(plan.controls), 1))
    else:
        count = round((plan.time - before.time) / controller.dt)
        nominal = np.vstack([before.controls[count:], np.tile(controller.model.action.centre, (count, 1))])
    return np.array([(plan.controls - plan.weights[1] * nominal) / plan.weights[0], nominal])
