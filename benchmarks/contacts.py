"""What a planner's simulation may cost: solvers of MuJoCo's contacts by time per step, error and steadiness.

Solo12 with its rotors, PD gains 4 and 0.2, follows random joint targets about its stand over 9 steps of 20 ms. The
error is what is left, after them, between a planner's simulation and that of the plant: steps of 2 ms, solved to
convergence, with the rotors' true inertia. Standing is holding the pose for 5 s. Times are of one thread, without those
spent waiting for a processor.
"""

from __future__ import annotations

import time
from typing import Any

import mujoco
import mujoco.rollout
import numpy as np
from common import arguments, surroundings, tell

from piaffe import models
from piaffe.models import Mujoco, SoftContact

SAMPLES, STEPS = 512, 9
DROP = 0.004  # [m], how far below its stand the robot starts, so that all feet touch
HOLD = 5.0  # [s] of standing
DEFAULT = SoftContact()
CANDIDATES: dict[str, tuple[SoftContact, float | None]] = {
    "default": (DEFAULT, None),
    "true rotors": (DEFAULT, 5.3e-6 * 81),
    "true rotors, implicitfast": (SoftContact(integrator="implicitfast"), None),
    "rotors of 0.002": (DEFAULT, 0.002),
    "rotors of 0.01": (DEFAULT, 0.01),
    "3 iterations": (SoftContact(iterations=3), None),
    "6 iterations": (SoftContact(iterations=6), None),
    "pyramidal cone": (SoftContact(cone="pyramidal", stick=1.0), None),
    "friction as soft as contacts": (SoftContact(stick=1.0), None),
    "no warm start": (SoftContact(warm_start=False), None),
    "harder contacts": (SoftContact(solimp=(0.95, 0.99, 0.001, 0.5, 2.0)), None),
    "newton, 1 iteration": (SoftContact(solver="newton", iterations=1, cone="pyramidal", stick=1.0), None),
    "newton, 2 iterations": (SoftContact(solver="newton", iterations=2, cone="pyramidal", stick=1.0), None),
    "newton, 4 iterations": (SoftContact(solver="newton", iterations=4, cone="pyramidal", stick=1.0), None),
    "newton, 4, implicitfast": (SoftContact(solver="newton", iterations=4, integrator="implicitfast"), 0.0056),
}


class Trial:
    """One model under the same controls."""

    def __init__(self, robot: models.Robot, plant: Mujoco, controls: np.ndarray) -> None:
        self.robot, self.plant, self.controls = robot, plant, np.repeat(controls, plant.substeps, axis=1)
        self.start = plant.state(joints="stand")
        self.start[2] -= DROP
        self.data = [mujoco.MjData(plant.compiled())]
        self.engine = mujoco.rollout.Rollout(nthread=0)
        self.seconds: list[float] = []

    def roll(self) -> np.ndarray:
        """Return the last states of all samples, (samples, nx), and keep the time."""
        first = np.tile(np.concatenate([[0.0], self.start]), (SAMPLES, 1))
        began = time.thread_time()
        states, _ = self.engine.rollout([self.plant.compiled()] * SAMPLES, self.data, first, self.controls)
        self.seconds.append(time.thread_time() - began)
        return np.asarray(states[:, -1, 1:])

    def stand(self) -> dict[str, Any]:
        """Return where holding the pose ends."""
        model, data = self.plant.compiled(), self.data[0]
        mujoco.mj_resetData(model, data)
        data.qpos[:], data.qvel[:] = self.start[: model.nq], self.start[model.nq :]
        data.ctrl[:] = self.plant.action.centre
        for _ in range(round(HOLD / model.opt.timestep)):
            mujoco.mj_step(model, data)
        x = np.concatenate([data.qpos, data.qvel])
        return {
            "stands": not bool(self.plant.fallen(x)),
            "height_m": round(float(x[2]), 4),
            "drift_mm": round(1e3 * float(np.hypot(x[0], x[1])), 1),
        }


def main() -> None:
    """Run everything."""
    given = arguments(__doc__ or "", repeats=15).parse_args()
    robot = models.load("solo12", rotors=True)
    rng, centre = np.random.default_rng(0), robot.pose("stand")
    wanted = centre + 0.2 * rng.standard_normal((SAMPLES, 1, 12)) + 0.1 * rng.standard_normal((SAMPLES, STEPS, 12))
    controls = np.clip(wanted, centre - 0.4, centre + 0.4)
    truth = Trial(robot, Mujoco(robot).as_plant(), controls)
    trials = {
        name: Trial(robot, Mujoco(robot, contact=contact, armature=armature), controls)
        for name, (contact, armature) in CANDIDATES.items()
    }
    true = truth.roll()
    rows = {"plant": {"us_per_step": round(1e6 * truth.seconds[0] / SAMPLES / STEPS, 2), **truth.stand()}}
    for _ in range(given.repeats):
        for trial in trials.values():
            trial.roll()
    for name, trial in trials.items():
        last = trial.roll()
        good = np.all(np.isfinite(last), axis=1) & (np.abs(last).max(axis=1) < 200)
        off = np.abs(last - true)[good]
        rows[name] = {
            "us_per_step": round(1e6 * min(trial.seconds) / SAMPLES / STEPS, 2),
            "lost": int(SAMPLES - good.sum()),
            "base_error_mm": round(1e3 * float(np.median(np.linalg.norm(off[:, :3], axis=1))), 1),
            "joint_speed_error": round(float(np.median(off[:, 25:])), 2),
            **trial.stand(),
        }
    lines = [
        f"{name:30s} {row['us_per_step']:6.2f} us/step  lost {row.get('lost', 0):3d}  base off "
        f"{row.get('base_error_mm', 0.0):5.1f} mm  joints off {row.get('joint_speed_error', 0.0):5.2f} rad/s  "
        f"{'stands' if row['stands'] else 'FALLS'} at {row['height_m']:.4f} m, {row['drift_mm']:.1f} mm away"
        for name, row in rows.items()
    ]
    tell({"benchmark": "contacts", **surroundings(), "results": rows}, lines, json=given.json, save=given.save)


if __name__ == "__main__":
    main()
