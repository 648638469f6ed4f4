"""Mini Cheetah trots up three steps of 4 cm, or up a slope, on MuJoCo with a receding horizon."""

import sys

import numpy as np
import trot_mpc

from piaffe import models, ocp, simulation, solvers

robot, effort = trot_mpc.robot, trot_mpc.effort
grounds = {"stairs": models.terrain.stairs(rise=0.04, run=0.25, steps=3), "slope": models.terrain.incline(0.18)}
# The lag's gain is that of gaits_mpc.py: without it, the slope takes 4 % of the speed, on seeds 500 to 511.
trot = models.gaits.trot(speed=0.5, velocity_gain=0.02, lag_gain=1.0)  # [m/s], [s], [1/s]


def on(ground: str) -> ocp.Problem:
    """Return the trot on a ground: its footholds are where the robot really steps, whatever was declared."""
    terrain = grounds[ground]
    body, srb = models.WholeBody(robot, terrain=terrain), models.SingleRigidBody(robot, terrain=terrain)
    cascade = body.over(0.25, dt=0.01).without(effort) + srb.over(0.50, dt=0.05).without(trot_mpc.limits)
    start = body.state(joints="stand")
    return ocp.Problem(trot, cascade, trot_mpc.objective + effort, trot_mpc.limits, initial=start)


problem = on("stairs")
slope = on("slope")


def run(ground: str = "stairs", seconds: float = 6.0, initial: np.ndarray | None = None) -> simulation.OnlineEpisode:
    """Run the trot on a ground, from another state or the declared one, and return the episode."""
    mpc = solvers.RecedingHorizon(on(ground))
    low = solvers.Vwbc(mpc.plan(mpc.initial, 0.0), leave_out=("base.position x", "base.position y"))
    plant = simulation.Plant(robot, friction=0.7, terrain=grounds[ground])
    return simulation.run_online(mpc, low, plant, seconds=seconds, initial=initial)


def main(ground: str = "stairs") -> float:
    """Run the trot, and return the height that the base has gained [m]."""
    episode = run(ground)
    print(f"{episode.fault or 'upright'}, {episode.tracking(2.0).velocity[0]:.3f} m/s")
    return float(episode.last[2] - episode.states[0][2])


if __name__ == "__main__":
    print(f"{main(*sys.argv[1:]):.3f} m")
