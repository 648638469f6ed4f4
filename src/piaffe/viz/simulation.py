"""Playing a solution's policy u = ū + K (x ⊖ x̄) in MuJoCo, which simulates the contacts instead of prescribing them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piaffe.errors import ModelError

from .curves import friction
from .playback import Playback, Snapshot, node_before

Array = NDArray[np.float64]

LOST_M, LOST_RAD = 0.3, 1.0  # further from the plan than this it is no longer followed


@dataclass(frozen=True)
class Run:
    """What a simulation did.

    Args:
        snapshots: one per control step.
        lost_at: when the plan was lost [s], None if it was followed to its end.
        duration: of the plan [s].
        position: error of the base at every control step [m]. orientation: likewise [rad].
        saturated: share of the control steps at which some torque was at its limit.
    """

    snapshots: tuple[Snapshot, ...]
    lost_at: float | None
    duration: float
    position: Array
    orientation: Array
    saturated: float

    def __str__(self) -> str:
        if self.lost_at is None:
            how = f"followed the plan to its end, {self.duration:.2f} s"
        else:
            how = f"lost the plan at {self.lost_at:.2f} s of {self.duration:.2f} s"
        return (
            f"simulation {how}; base off by at most {self.position.max():.3f} m and {self.orientation.max():.3f} rad, "
            f"at last {self.position[-1]:.3f} m and {self.orientation[-1]:.3f} rad; torque limits reached in "
            f"{100 * self.saturated:.0f} % of the steps"
        )


def simulate(playback: Playback, *, dt: float = 1e-3, mu: float | None = None) -> Run:
    """Play the policy of a solution in MuJoCo.

    Args:
        playback: the solution. Phases from the first one that is not of a whole body are left out.
        dt: step of the simulator and of the policy [s].
        mu: friction coefficient of the feet; by default that of the declared friction cone, else 0.6.

    Raises:
        ModelError: the solution does not begin with a whole body.
    """
    import mujoco

    model = _model(playback, dt, friction(playback.solution) if mu is None else mu)
    parts = playback.trajectory.phases
    n = next((i for i, part in enumerate(parts) if part.states.shape[1] != model.nq + model.nv), len(parts))
    if n == 0:
        raise ModelError(
            f"simulation: the solution does not begin with a whole body - got model '{parts[0].model}' with "
            f"{parts[0].states.shape[1]} states, expected {model.nq + model.nv}; film it without --simulate"
        )
    data = mujoco.MjData(model)
    end = float(parts[n - 1].times[-1])
    x = parts[0].states[0]
    data.qpos[:], data.qvel[:] = x[: model.nq], x[model.nq :]
    mujoco.mj_forward(model, data)
    feet = [model.geom(name).id for name in playback.feet]
    snapshots, errors, lost, full = [], [], None, 0
    limits = model.actuator_ctrlrange[:, 1]
    limited = model.actuator_ctrllimited.astype(bool)
    steps = round((end - playback.start) / dt)
    for step in range(steps + 1):
        t = playback.start + step * dt
        i = min(playback.phase_index(t), n - 1)
        part, policy = parts[i], playback.solution.phases[i]
        k, _ = node_before(part, t)
        planned = playback.interpolate(part, part.states, t)
        x = np.concatenate([data.qpos, data.qvel])
        off = part.state.np_minus(x, planned)
        errors.append((float(np.linalg.norm(off[:3])), float(np.linalg.norm(off[3:6]))))
        forces = foot_forces(mujoco, model, data, feet)
        contact = tuple(bool(force[2] > 1e-3) for force in forces)
        snapshots.append(Snapshot(t, np.array(data.qpos), forces, part.name, contact, playback.pose(part, planned, i)))
        if not np.all(np.isfinite(x)) or errors[-1][0] > LOST_M or errors[-1][1] > LOST_RAD:
            lost = t
            break
        u = part.controls[k] + policy.feedback[k] @ off
        full += bool(np.any(limited & (np.abs(u) >= limits)))
        data.ctrl[:] = u
        mujoco.mj_step(model, data)
    table = np.array(errors)
    return Run(tuple(snapshots), lost, end - playback.start, table[:, 0], table[:, 1], full / len(errors))


def _model(playback: Playback, dt: float, mu: float | None) -> Any:
    """Return the simulated robot: as it is drawn, with feet that give less than MuJoCo's default."""
    from piaffe.models import mujoco_spec, restore_inertias

    robot = playback.robot
    spec = mujoco_spec(robot, contacts="feet", friction=0.6 if mu is None else mu, dt=dt)
    spec.option.impratio = 10.0
    for foot in robot.feet:
        geom = spec.geom(foot.name)
        geom.solref = (max(4 * dt, 2e-3), 1.0)
        geom.solimp = (0.95, 0.99, 0.001, 0.5, 2.0)
    model = spec.compile()
    restore_inertias(model, robot)
    return model


def foot_forces(mujoco: Any, model: Any, data: Any, feet: list[int]) -> Array:
    """Return the world force on each foot, (nf, 3) [N]."""
    total = np.zeros((len(feet), 3))
    wrench = np.zeros(6)
    for c in range(data.ncon):
        contact = data.contact[c]
        for side, sign in ((contact.geom1, -1.0), (contact.geom2, 1.0)):
            if side in feet:
                mujoco.mj_contactForce(model, data, c, wrench)
                total[feet.index(side)] += sign * contact.frame.reshape(3, 3).T @ wrench[:3]
    return total
