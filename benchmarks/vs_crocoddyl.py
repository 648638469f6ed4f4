"""Compare with Crocoddyl: a quadruped standing on four feet, the same robot, contacts, nodes, dt, costs and iterate.

First accelerations, contact forces, their derivatives and the costs are compared, tangents mapped to each other; then both
are timed in turns, one thread each. Needs the environment of ``make bench`` (crocoddyl 3.2.1 with pin 4.0.0).
"""

from __future__ import annotations

import os

os.environ["OMP_NUM_THREADS"] = "1"  # before NumPy and Crocoddyl start their threads

import argparse
import subprocess
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from statistics import median
from time import perf_counter
from typing import Any

import crocoddyl
import numpy as np
import pinocchio
from common import iteration, machine_at, middle, profile, surroundings, tell
from numpy.typing import NDArray

from piaffe import models, ocp, solvers
from piaffe.models import base, joints
from piaffe.ocp import rotation
from piaffe.solvers.iterate import Evaluator, solve_nodes
from piaffe.solvers.native import library_for

Array = NDArray[np.float64]

NODES, DT, GAMMA = 100, 0.01, 20.0  # [s], [1/s]
POSITION, VELOCITY, TORQUE = 1.0, 0.1, 0.01  # weights
WIDTHS = (8, 4, 1)
TOLERANCE = 1e-8


# ---- one problem, stated twice


def our_problem(robot: models.Robot) -> ocp.CompiledProblem:
    """Return the robot standing, asked to come 2 cm forward and 1 cm down."""
    body = models.WholeBody(robot, baumgarte=GAMMA)
    target = ocp.Keyframe(position=(0.02, 0, robot.base_height("stand") - 0.01), joints="stand")
    motion = ocp.Motion(ocp.Phase("stand", models.stance(robot.foot_names), NODES * DT, target))
    objective = ocp.Objective(
        *(ocp.track(quantity, POSITION) for quantity in (base.position, base.orientation, joints.position)),
        *(ocp.track(quantity, VELOCITY) for quantity in (base.linear_velocity, base.angular_velocity, joints.velocity)),
        ocp.regularize(joints.torque, TORQUE),
    )
    problem = ocp.Problem(motion, body.until_end(DT), objective, initial=body.state(joints="stand"))
    return ocp.compile_problem(problem)


def to_theirs(x: Array) -> Array:
    """Return a state in Crocoddyl's layout: quaternion (x, y, z, w), linear velocity in body axes."""
    half = (len(x) + 1) // 2
    turned = rotation.np_matrix(x[3:7]).T @ x[half : half + 3]
    return np.concatenate([x[:3], x[[4, 5, 6, 3]], x[7:half], turned, x[half + 3 :]])


def their_problem(robot: models.Robot, ours: ocp.CompiledProblem) -> crocoddyl.ShootingProblem:
    """Return the same as a shooting problem; a node's target is the path's state there."""
    state = crocoddyl.StateMultibody(robot.model)
    actuation = crocoddyl.ActuationModelFloatingBase(state)
    contacts = crocoddyl.ContactModelMultiple(state, actuation.nu)
    world = pinocchio.LOCAL_WORLD_ALIGNED
    for foot in robot.feet:
        frame = robot.frame_id(foot.frame)
        contact = crocoddyl.ContactModel3D(state, frame, np.zeros(3), world, actuation.nu, np.array([0.0, GAMMA]))
        contacts.addContact(foot.name, contact)
    weights = crocoddyl.ActivationModelWeightedQuad(np.repeat([POSITION, VELOCITY], state.nv))
    targets = ours.phases[0].guess_states.copy()
    targets[0, robot.model.nq :] = targets[1, robot.model.nq :]  # the guess begins at rest, the path does not
    nodes = []
    for target in (to_theirs(x) for x in targets):
        costs = crocoddyl.CostModelSum(state, actuation.nu)
        tracked = crocoddyl.ResidualModelState(state, target, actuation.nu)
        costs.addCost("state", crocoddyl.CostModelResidual(state, weights, tracked), 1.0)
        effort = crocoddyl.CostModelResidual(state, crocoddyl.ResidualModelControl(state, actuation.nu))
        costs.addCost("torque", effort, TORQUE)
        # False: without derivatives of the forces, which no cost here needs
        dynamics = crocoddyl.DifferentialActionModelContactFwdDynamics(state, actuation, contacts, costs, 0.0, False)
        nodes.append(crocoddyl.IntegratedActionModelEuler(dynamics, DT))
    nothing = crocoddyl.CostModelSum(state, actuation.nu)
    dynamics = crocoddyl.DifferentialActionModelContactFwdDynamics(state, actuation, contacts, nothing, 0.0, False)
    end = crocoddyl.IntegratedActionModelEuler(dynamics, 0.0)
    problem = crocoddyl.ShootingProblem(to_theirs(ours.initial), nodes[:NODES], end)
    problem.nthreads = 1
    return problem


# ---- agreement


@dataclass(frozen=True)
class Physics:
    """Acceleration and contact forces of stages, and their derivatives by (δx, u), in our coordinates."""

    a: Array
    F: Array
    a_w: Array
    F_w: Array


def our_physics(ours: ocp.CompiledProblem, x: Array, u: Array, width: int) -> Physics:
    """Return ours: acceleration and its derivative as the compiled solver has them, forces as the functions do."""
    phase, evaluator = ours.phases[0], Evaluator(ours)
    nv, ndx = phase.mode.state.ndx // 2, phase.mode.state.ndx
    machine = machine_at(ours, width, [x], [u])
    D = machine.arrays[0]["D"].reshape(NODES, ndx, ndx + phase.mode.nu)
    x_next = machine.arrays[0]["x_next"].reshape(NODES, -1)
    a_w = D[:, nv:].copy()
    a_w[:, :, nv:ndx] -= np.eye(nv)
    value = evaluator.values(0, x, u)
    r_w = evaluator.call(phase.mode.functions["stage_d"], x[:-1], u, value.z, phase.p, x[1:])[0]
    z_w = -solve_nodes(value.K, r_w)
    return Physics((x_next[:, nv + 1 :] - x[:-1, nv + 1 :]) / DT, value.z[:, nv:], a_w / DT, z_w[:, nv:])


def their_physics(robot: models.Robot, theirs: crocoddyl.ShootingProblem, x: Array, u: Array) -> Physics:
    """Return Crocoddyl's, mapped: v̇ = R (a + ω × v), δp = R δp', δv = R (δv' − v' × δθ')."""
    nv, nu, nf = robot.model.nv, u.shape[1], len(robot.feet)
    order = np.argsort([foot.name for foot in robot.feet])  # Crocoddyl sorts contacts by name
    stacks: list[list[Array]] = [[], [], [], []]
    for k in range(NODES):
        model = theirs.runningModels[k].differential
        model = crocoddyl.DifferentialActionModelContactFwdDynamics(
            model.state, model.actuation, model.contacts, model.costs, 0.0, True
        )
        data, there = model.createData(), to_theirs(x[k])
        model.calc(data, there, u[k])
        model.calcDiff(data, there, u[k])
        R, v, omega = rotation.np_matrix(x[k, 3:7]), there[nv + 1 : nv + 4], there[nv + 4 : nv + 7]
        tangent = np.eye(2 * nv + nu)  # from our (δx, u) to theirs
        tangent[:3, :3] = R.T
        tangent[nv : nv + 3, nv : nv + 3] = R.T
        tangent[nv : nv + 3, 3:6] = _skew(v)
        a, a_w = np.array(data.xout), np.hstack([data.Fx, data.Fu]) @ tangent
        local, local_w = a[:3] + np.cross(omega, v), a_w[:3].copy()
        local_w += _skew(omega) @ tangent[nv : nv + 3] - _skew(v) @ tangent[nv + 3 : nv + 6]
        by_turning = np.zeros((3, 2 * nv + nu))
        by_turning[:, 3:6] = -R @ _skew(local)
        a_w[:3] = R @ local_w + by_turning
        a[:3] = R @ local
        F, F_w = np.zeros((nf, 3)), np.zeros((nf, 3, 2 * nv + nu))
        by = np.hstack([data.df_dx, data.df_du]) @ tangent
        for place, foot in enumerate(order):
            F[foot] = data.pinocchio.lambda_c[3 * place : 3 * place + 3]
            F_w[foot] = by[3 * place : 3 * place + 3]
        for stack, value in zip(stacks, (a, F.ravel(), a_w, F_w.reshape(3 * nf, -1)), strict=True):
            stack.append(value)
    return Physics(*(np.array(stack) for stack in stacks))


def _skew(v: Array) -> Array:
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


def differences(robot: models.Robot, ours: ocp.CompiledProblem, theirs: crocoddyl.ShootingProblem) -> dict[str, float]:
    """Return the largest differences, each relative to the largest entry; raise if one is not small."""
    rng = np.random.default_rng(0)
    state, phase = ours.phases[0].mode.state, ours.phases[0]
    x = state.np_plus(phase.guess_states, 0.3 * rng.standard_normal((NODES + 1, state.ndx)))
    u = 3.0 * rng.standard_normal((NODES, phase.mode.nu))
    out: dict[str, float] = {}
    there = their_physics(robot, theirs, x, u)
    for width in WIDTHS:
        here = our_physics(ours, x, u, width)
        for name in ("a", "F", "a_w", "F_w"):
            a, b = getattr(here, name), getattr(there, name)
            out[f"{name} W={width}"] = float(np.max(np.abs(a - b)) / np.max(np.abs(b)))
    # costs: positions are measured by another logarithm there, the same where the base is not turned
    x[:, 3:7] = phase.guess_states[:, 3:7]
    cost = Evaluator(ours).values(0, x, u).residual
    mine = 0.5 * DT * np.sum(phase.weight * cost**2)
    out["cost"] = abs(mine / theirs.calc([to_theirs(each) for each in x], list(u)) - 1)
    worst = max(out, key=lambda name: out[name])
    if not out[worst] < TOLERANCE:
        raise SystemExit(f"not the same problem: {worst} differs by {out[worst]:.1e} relative, {TOLERANCE:.0e} allowed")
    return out


# ---- times


def their_parts(solver: crocoddyl.SolverFDDP, x: Sequence[Array], u: Sequence[Array]) -> dict[str, Callable[[], Any]]:
    """Return the parts of an FDDP iteration; its forward pass evaluates the nodes."""
    problem = solver.problem
    solver.setCandidate(x, u, False)
    solver.computeDirection(True)
    return {
        "evaluation": lambda: problem.calc(x, u),
        "derivatives": lambda: problem.calcDiff(x, u),
        "backward": solver.backwardPass,
        "forward with evaluation": lambda: solver.forwardPass(1.0),
    }


def their_sample(parts: dict[str, Callable[[], Any]]) -> dict[str, float]:
    """Time Crocoddyl's parts once [s]."""
    sample = {}
    for name, part in parts.items():
        began = perf_counter()
        part()
        sample[name] = perf_counter() - began
    in_turn = ("derivatives", "backward", "forward with evaluation")
    return {**sample, "whole iteration": sum(sample[name] for name in in_turn)}


def our_sample(machine: Any) -> dict[str, float]:
    """Time our parts once [s], under Crocoddyl's headings."""
    parts = profile(machine)
    evaluation = parts["evaluation"] + parts["sums"]
    return {
        "evaluation": evaluation,
        "derivatives": parts["derivatives"],
        "backward": parts["backward"],
        "forward with evaluation": parts["forward"] + evaluation,
        "whole iteration": iteration(parts),
    }


def their_solve(solver: crocoddyl.SolverFDDP, x: Sequence[Array], u: Sequence[Array]) -> tuple[float, list[float]]:
    """Return seconds per iteration of a whole solve by Crocoddyl, and the steps it took."""
    log = crocoddyl.CallbackLogger()
    solver.setCallbacks([log])
    solver.solve(x, u, SOLVE_ITERATIONS, False, 0.0)
    steps = [float(step) for step in log.steps]
    solver.setCallbacks([])
    began = perf_counter()
    solver.solve(x, u, SOLVE_ITERATIONS, False, 0.0)
    return (perf_counter() - began) / len(steps), steps


def our_solve(solver: solvers.MSiLQR) -> tuple[float, list[float]]:
    """Return seconds per iteration of ours, as its log says: from the second, where the first has the start's too."""
    history = solver.solve().history
    times = [after.wall_s - before.wall_s for before, after in pairwise(history)]
    return median(times), [record.step_size for record in history]


SOLVE_ITERATIONS = 5


def compare(name: str, repeats: int) -> tuple[dict[str, Any], Any]:
    """Return all that is to say of one robot."""
    robot = models.load(name)
    ours = our_problem(robot)
    theirs = their_problem(robot, ours)
    result: dict[str, Any] = {"differences": differences(robot, ours, theirs)}
    guess = ours.phases[0]
    x, u = [to_theirs(each) for each in guess.guess_states], list(guess.guess_controls)
    fddp = crocoddyl.SolverFDDP(theirs)
    fddp.th_stop = 1e-30
    parts = their_parts(fddp, x, u)
    machines = {width: machine_at(ours, width) for width in WIDTHS}
    samples: dict[str, list[dict[str, float]]] = {"crocoddyl": [], **{f"W={width}": [] for width in WIDTHS}}
    for _ in range(repeats):  # in turns, so that whatever else the machine does disturbs all alike
        samples["crocoddyl"].append(their_sample(parts))
        for width, machine in machines.items():
            samples[f"W={width}"].append(our_sample(machine))
    result["us_per_node"] = {who: middle(s, 1e6 / NODES) for who, s in samples.items()}
    result["times_faster"] = {
        f"W={width}": {
            part: round(median(a[part] / b[part] for a, b in zip(samples["crocoddyl"], samples[f"W={width}"], strict=True)), 2)
            for part in samples["crocoddyl"][0]
        }
        for width in WIDTHS
    }  # fmt: skip
    solver = solvers.MSiLQR(ours, solvers.Options(max_iterations=SOLVE_ITERATIONS, cost_tolerance=1e-30))
    runs = [(their_solve(fddp, x, u), our_solve(solver)) for _ in range(max(repeats // 4, 3))]
    result["solve"] = {
        "us_per_node_and_iteration": {
            "crocoddyl": round(1e6 / NODES * median(a[0] for a, _ in runs), 2),
            "piaffe": round(1e6 / NODES * median(b[0] for _, b in runs), 2),
        },
        "times_faster": round(median(a[0] / b[0] for a, b in runs), 2),
        "steps": {"crocoddyl": runs[-1][0][1], "piaffe": runs[-1][1][1]},
    }
    return result, solver.machine


def their_build() -> dict[str, Any]:
    """Return what is known of how Crocoddyl was built: the wheel says no flags, its code tells the vectors that it uses."""
    library = next(Path(crocoddyl.__file__).parents[3].glob("libcrocoddyl.so"))
    found: dict[str, Any] = {"crocoddyl": crocoddyl.__version__, "pin": pinocchio.__version__, "library": library.name}
    try:
        text = subprocess.run(["objdump", "-d", library], capture_output=True, text=True, check=True).stdout
    except (OSError, subprocess.CalledProcessError):
        return found
    return {**found, "instructions_with": {kind: text.count(f"%{kind}") for kind in ("xmm", "ymm", "zmm")}}


def main(robots: list[str], repeats: int = 60, json: bool = False) -> dict[str, Any]:
    """Print and return differences, times per node and ratios."""
    results: dict[str, Any] = {"benchmark": "vs_crocoddyl", "nodes": NODES, "dt": DT, "repeats": repeats, "robots": {}}
    for name in robots:
        results["robots"][name], machine = compare(name, repeats)
    results |= {"their_build": their_build(), **surroundings(library_for(machine.problem)[0].built)}
    lines = []
    for name, result in results["robots"].items():
        worst = max(result["differences"].values())
        lines.append(
            f"{name}: {NODES} nodes, largest relative difference {worst:.1e}; median µs per node (times faster)"
        )
        lines.append(f"{'':26}{'Crocoddyl':>10}" + "".join(f"{f'W={w}':>18}" for w in WIDTHS))
        for part, time in result["us_per_node"]["crocoddyl"].items():
            row = f"  {part:24}{time['median']:10.2f}"
            for w in (f"W={width}" for width in WIDTHS):
                row += f"{result['us_per_node'][w][part]['median']:10.2f} ({result['times_faster'][w][part]:4.1f})"
            lines.append(row)
        solve = result["solve"]
        times = solve["us_per_node_and_iteration"]
        lines.append(
            f"  {'in a solve':24}{times['crocoddyl']:10.2f}{times['piaffe']:10.2f} ({solve['times_faster']:4.1f})"
        )
    tell(results, json, lines)
    return results


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("robots", nargs="*", default=["solo12", "go2"])
    parser.add_argument("--repeats", type=int, default=60)
    parser.add_argument("--json", action="store_true", help="print all as JSON")
    main(**vars(parser.parse_args()))
