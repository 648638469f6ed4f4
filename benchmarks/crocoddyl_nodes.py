"""Time one iteration per node against Crocoddyl: Solo12 standing on four feet, same costs, one thread.

Needs the extra ``bench``. Crocoddyl's figure is the sum of its calc, calcDiff, backward and forward pass.
"""

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")  # before NumPy and Crocoddyl start their threads

from itertools import pairwise
from time import perf_counter

import crocoddyl
import numpy as np
import pinocchio

from piaffe import models, ocp, solvers
from piaffe.models import base, joints, stance

NODES, DT = 50, 0.01


def piaffe_time(robot: models.Robot, iterations: int = 10) -> float:
    """Return the time of Piaffe's NumPy solver per iteration and node, the fastest [s]."""
    body = models.WholeBody(robot)
    feet = stance(robot.foot_names)
    motion = ocp.Motion(ocp.Phase("stand", feet, NODES * DT, ocp.Keyframe(position=(0.02, 0, 0.2))))
    objective = ocp.Objective(
        *(ocp.track(quantity) for quantity in (base.position, base.orientation, joints.position)),
        *(ocp.track(quantity, 0.1) for quantity in (base.linear_velocity, base.angular_velocity, joints.velocity)),
        ocp.regularize(joints.torque, 0.01),
    )
    problem = ocp.Problem(motion, body.until_end(DT), objective, initial=body.state(joints="stand"))
    solver = solvers.MSiLQR(problem, solvers.Options(max_iterations=iterations, cost_tolerance=1e-30))
    stamps: list[float] = [perf_counter()]
    solver.solve(progress=lambda record: stamps.append(perf_counter()))
    return min(after - before for before, after in pairwise(stamps)) / NODES


def crocoddyl_time(robot: models.Robot, repeats: int = 50) -> float:
    """Return Crocoddyl's time per iteration and node, the fastest of each part [s]."""
    state = crocoddyl.StateMultibody(robot.model)
    actuation = crocoddyl.ActuationModelFloatingBase(state)
    contacts = crocoddyl.ContactModelMultiple(state, actuation.nu)
    for foot in robot.feet:
        frame = robot.frame_id(foot.frame)
        world = pinocchio.LOCAL_WORLD_ALIGNED
        contact = crocoddyl.ContactModel3D(state, frame, np.zeros(3), world, actuation.nu, np.array([0.0, 20.0]))
        contacts.addContact(foot.name, contact)
    stand = np.concatenate([pinocchio.neutral(robot.model)[:7], robot.pose("stand"), np.zeros(robot.model.nv)])
    costs = crocoddyl.CostModelSum(state, actuation.nu)
    weights = crocoddyl.ActivationModelWeightedQuad(np.repeat([1.0, 0.1], state.nv))
    tracking = crocoddyl.CostModelResidual(state, weights, crocoddyl.ResidualModelState(state, stand, actuation.nu))
    costs.addCost("track", tracking, 1.0)
    effort = crocoddyl.CostModelResidual(state, crocoddyl.ResidualModelControl(state, actuation.nu))
    costs.addCost("torque", effort, 0.01)
    dynamics = crocoddyl.DifferentialActionModelContactFwdDynamics(state, actuation, contacts, costs, 0.0, True)
    node = crocoddyl.IntegratedActionModelEuler(dynamics, DT)
    end = crocoddyl.IntegratedActionModelEuler(dynamics, 0.0)
    problem = crocoddyl.ShootingProblem(stand, [node] * NODES, end)
    solver = crocoddyl.SolverFDDP(problem)
    states = [stand] * (NODES + 1)
    controls = [np.zeros(actuation.nu)] * NODES
    solver.setCandidate(states, controls, False)
    solver.computeDirection(True)
    parts = {
        "calc": lambda: problem.calc(states, controls),
        "calcDiff": lambda: problem.calcDiff(states, controls),
        "backward": solver.backwardPass,
        "forward": lambda: solver.forwardPass(1.0),
    }
    return sum(_fastest(part, repeats) for part in parts.values()) / NODES


def _fastest(call, repeats: int) -> float:
    times = []
    for _ in range(repeats):
        began = perf_counter()
        call()
        times.append(perf_counter() - began)
    return min(times)


def main() -> float:
    """Print both and return how many times Crocoddyl's time Piaffe takes."""
    robot = models.load("solo12")
    ours, theirs = piaffe_time(robot), crocoddyl_time(robot)
    print(f"per iteration and node: Piaffe (NumPy) {1e6 * ours:.0f} µs, Crocoddyl {1e6 * theirs:.0f} µs")
    return ours / theirs


if __name__ == "__main__":
    main()
