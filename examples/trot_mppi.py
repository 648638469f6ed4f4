"""Solo12 trots at 0.3 m/s: one declaration, optimised by MSiLQR and run by TD-CD-MPPI on MuJoCo roll-outs."""

from pathlib import Path

import casadi as cs

from piaffe import models, ocp, sampling, solvers
from piaffe.models import base, feet, joints

SPEED = 0.3  # [m/s]
HIP_LIMIT, HEIGHT_LIMIT = 0.08, 0.245  # [rad], [m]

robot = models.load("solo12", rotors=True)
body = models.WholeBody(robot)
trot = models.gaits.trot(SPEED, stance_time=0.25, swing_height=0.06, height=0.27)  # the height limit is active
objective = ocp.Objective(
    ocp.track(base.linear_velocity, weight=(2, 2, 0)),
    ocp.track(base.angular_velocity, weight=(0, 0, 0.2)),
    ocp.track(base.orientation, weight=(0, 0, 0.6)),
    ocp.track(base.ground_normal, weight=(1, 1, 0)),  # roll and pitch, against the slope of the ground
    ocp.track(feet.height, weight=80.0),
    # without this term, feet on the ground stay behind until the robot trips
    ocp.track(feet.reach, weight=30.0),
    ocp.track(joints.velocity, weight=1e-4),
    ocp.regularize(joints.torque, weight=1e-3),
)
limits = ocp.Constraints(
    models.joint_range("HAA", HIP_LIMIT, scale=HIP_LIMIT),
    models.base_height(maximum=HEIGHT_LIMIT, scale=HEIGHT_LIMIT),
)
friction = models.friction_cone(mu=0.6)  # the simulator has friction of its own
start = body.state(joints="stand")
problem = ocp.Problem(trot.cycles(3), body.until_end(dt=0.01), objective, limits + friction, initial=start)

tall = 2 * (0.0, 0.6, -1.2) + 2 * (0.0, -0.6, 1.2)
terrains = {
    "flat": models.terrain.flat(),
    "incline": models.terrain.incline(0.18),
    "stairs": models.terrain.stairs(rise=0.04, run=0.25, steps=3),
}
reward = sampling.Reward(scale=0.3)
options = sampling.Options(samples=512, sigma=0.5, p_max=0.1, discount=0.95)  # without the value p_max should be 0.5
value = "solo12_trot.value"  # learnt by train_value.py, on flat ground


@ocp.residual
def wide(s):
    """Return the violation of the hip limit, for a penalty [rad]."""
    return cs.fmax(cs.fabs(s.joints.position["HAA"]) - HIP_LIMIT, 0)


@ocp.residual
def high(s):
    """Return the violation of the height limit, for a penalty [m]."""
    return cs.fmax(s.base.height - HEIGHT_LIMIT, 0)


def sampled_problem(terrain: str = "flat", horizon: int = 8, penalties: float = 0.0) -> ocp.Problem:
    """Return the same trot on a terrain; ``horizon`` is in steps of 20 ms, ``penalties`` the weight of soft limits."""
    targets = models.joint_targets(centre=tall, half_range={"HAA": 0.4, "HFE": 0.5, "KFE": 0.7})
    plant = models.Mujoco(robot, terrain=terrains[terrain], action=targets)
    terms = objective
    if penalties:
        terms = objective + wide.weighted(80.0 * penalties) + high.weighted(1500.0 * penalties)
    return ocp.Problem(trot, plant.over(0.02 * horizon, dt=0.02), terms, limits, initial=start)


def main(steps: int = 400) -> float:
    """Solve the trot, then run it on MuJoCo; return the mean speed on MuJoCo [m/s]."""
    print(solvers.MSiLQR(problem).solve().raise_if_failed())
    controller = sampling.TDCDMPPI(sampled_problem(), options, reward=reward, value=Path(__file__).with_name(value))
    episode = sampling.run_episode(controller, steps=steps)
    for name, missed in episode.missed.items():
        print(f"{name}: mean violation {100 * missed:.2f} % of its limit")
    return episode.distance / float(episode.times[-1])


if __name__ == "__main__":
    print(f"{main():.2f} m/s")
