"""Compare with Crocoddyl: a quadruped standing on four feet, the same robot, contacts, nodes, dt, costs and iterate.

First accelerations, contact forces, their derivatives and the costs are compared, tangents mapped to each other; then
both are timed in turns, one thread each. Both take Euler's steps; in the same turns Piaffe is also timed with midpoint
steps. Needs the environment of ``make bench`` (crocoddyl 3.2.1 with pin 4.0.0).
"""

from __future__ import annotations

import os

os.environ["OMP_NUM_THREADS"] = "1"  # before NumPy and Crocoddyl start their threads

import subprocess
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from statistics import median
from time import thread_time
from typing import Any, Literal

import crocoddyl
import numpy as np
import pinocchio
from common import arguments, begin, iteration, machine_at, middle, profile, solve, steps, surroundings, tell
from numpy.typing import NDArray

from piaffe import models, ocp
from piaffe.models import base, joints
from piaffe.ocp import rotation
from piaffe.solvers.ilqr.iterate import ProblemFunctions, solve_nodes
from piaffe.solvers.ilqr.native.library import Library, library_for
from piaffe.solvers.ilqr.native.memory import SolverMemory

Array = NDArray[np.float64]

NODES, DT, GAMMA = 100, 0.01, 20.0  # [s], [1/s]
POSITION, VELOCITY, TORQUE = 1.0, 0.1, 0.01  # weights
WIDTHS = (8, 4, 1)
STEPS: dict[str, Literal["euler", "midpoint"]] = {"": "euler", " midpoint": "midpoint"}
"""Integrators of ours, by the end of a result's name; theirs is Euler's."""
TOLERANCE = 1e-8
SOLVE_ITERATIONS = 5  # all taken in full by both
CALLS = 5  # of a part or a solve per turn: the least of them was not interrupted


# ---- one problem, stated twice


def our_problem(robot: models.Robot, integrator: Literal["euler", "midpoint"] = "euler") -> ocp.CompiledProblem:
    """Return the robot standing, asked to come 2 cm forward and 1 cm down."""
    body = models.WholeBody(robot, baumgarte=GAMMA, integrator=integrator)
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


def our_physics(ours: ocp.CompiledProblem, x: Array, u: Array, library: int | Library) -> Physics:
    """Return ours: acceleration and its derivative as the compiled solver has them, forces as the functions do."""
    phase, functions = ours.phases[0], ProblemFunctions(ours)
    nv, ndx = phase.mode.state.ndx // 2, phase.mode.state.ndx
    machine = machine_at(ours, library, [x], [u])
    D = machine.arrays[0]["D"].reshape(NODES, ndx, ndx + phase.mode.nu)
    x_next = machine.arrays[0]["x_next"].reshape(NODES, -1)
    a_w = D[:, nv:].copy()
    a_w[:, :, nv:ndx] -= np.eye(nv)
    value = functions.values(0, x, u)
    r_w = functions.call(phase.mode.functions["stage_d"], x[:-1], u, value.z, phase.p, x[1:])[0]
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


def random_iterate(ours: ocp.CompiledProblem) -> tuple[Array, Array]:
    """Return states about the guess and controls, the same each time."""
    rng, phase = np.random.default_rng(0), ours.phases[0]
    state = phase.mode.state
    x = state.np_plus(phase.guess_states, 0.3 * rng.standard_normal((NODES + 1, state.ndx)))
    return x, 3.0 * rng.standard_normal((NODES, phase.mode.nu))


def differences(
    robot: models.Robot,
    ours: ocp.CompiledProblem,
    theirs: crocoddyl.ShootingProblem,
    libraries: Mapping[str, int | Library],
) -> dict[str, float]:
    """Return the largest differences, each relative to the largest entry; raise if one is not small.

    Args:
        robot: the robot.
        ours: the problem.
        theirs: the same.
        libraries: those of ours by name, or their numbers of lanes.
    """
    x, u = random_iterate(ours)
    phase = ours.phases[0]
    out: dict[str, float] = {}
    there = their_physics(robot, theirs, x, u)
    for who, library in libraries.items():
        here = our_physics(ours, x, u, library)
        for name in ("a", "F", "a_w", "F_w"):
            out[f"{name} {who}"] = apart(getattr(here, name), getattr(there, name))
    # costs: positions are measured by another logarithm there, the same where the base is not turned
    x[:, 3:7] = phase.guess_states[:, 3:7]
    cost = ProblemFunctions(ours).values(0, x, u).residual
    mine = 0.5 * DT * np.sum(phase.weight * cost**2)
    out["cost"] = abs(mine / theirs.calc([to_theirs(state) for state in x], list(u)) - 1)
    require_small(out)
    return out


def apart(a: Array, b: Array) -> float:
    """Return the largest difference of two arrays relative to the largest entry."""
    return float(np.max(np.abs(a - b)) / np.max(np.abs(b)))


def require_small(found: Mapping[str, float]) -> None:
    """Raise if a relative difference is not small."""
    worst = max(found, key=lambda name: found[name])
    if not found[worst] < TOLERANCE:
        got = f"{found[worst]:.1e}"
        raise SystemExit(f"not the same problem: {worst} differs by {got} relative, {TOLERANCE:.0e} allowed")


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
    """Time Crocoddyl's parts [s of this thread], the least of a few calls each."""
    sample = {}
    for name, part in parts.items():
        times = []
        for _ in range(CALLS):
            began = thread_time()
            part()
            times.append(thread_time() - began)
        sample[name] = min(times)
    in_turn = ("derivatives", "backward", "forward with evaluation")
    return {**sample, "whole iteration": sum(sample[name] for name in in_turn)}


def our_sample(machine: SolverMemory) -> dict[str, float]:
    """Time our parts [s on the clock], the least of a few calls each, under Crocoddyl's headings."""
    parts = profile(machine, CALLS)
    evaluation = parts["evaluation"] + parts["sums"]
    return {
        "evaluation": evaluation,
        "derivatives": parts["derivatives"],
        "backward": parts["backward"],
        "forward with evaluation": parts["forward"] + evaluation,
        "whole iteration": iteration(parts),
    }


def their_solve(solver: crocoddyl.SolverFDDP, x: Sequence[Array], u: Sequence[Array], iterations: int) -> float:
    """Return seconds of a solve by Crocoddyl, of this thread."""
    began = thread_time()
    solver.solve(x, u, iterations, False, 0.0)
    return thread_time() - began


def our_solve(machine: SolverMemory, iterations: int) -> float:
    """Return seconds of a solve by Piaffe, of this thread."""
    begin(machine)
    return solve(machine, iterations)


def each(solve: Callable[[int], float]) -> float:
    """Return seconds of an iteration: what later ones add to the first, which has the start and the end to do too.

    The first solve is not timed, so that the longer one begins with warm caches as the shorter one does.
    """
    solve(SOLVE_ITERATIONS)
    longer, shorter = (min(solve(iterations) for _ in range(CALLS)) for iterations in (SOLVE_ITERATIONS, 1))
    return (longer - shorter) / (SOLVE_ITERATIONS - 1)


def require_full_steps(
    fddp: crocoddyl.SolverFDDP, x: Sequence[Array], u: Sequence[Array], machine: SolverMemory
) -> None:
    """Raise unless both solvers take every iteration of the solve with one trial."""
    log = crocoddyl.CallbackLogger()
    fddp.setCallbacks([log])
    their_solve(fddp, x, u, SOLVE_ITERATIONS)
    fddp.setCallbacks([])
    our_solve(machine, SOLVE_ITERATIONS)
    taken = [float(step) for step in log.steps], steps(machine)
    if any(sizes != [1.0] * SOLVE_ITERATIONS for sizes in taken):
        raise SystemExit(f"not the same iterations: got steps {taken}, expected {SOLVE_ITERATIONS} of 1 each")


def compare(name: str, repeats: int) -> tuple[dict[str, Any], SolverMemory]:
    """Return all that is to say of one robot, and a machine."""
    robot = models.load(name)
    ours = our_problem(robot)
    theirs = their_problem(robot, ours)
    both = {end: our_problem(robot, integrator) for end, integrator in STEPS.items()}
    found = differences(robot, ours, theirs, {f"W={width}": width for width in WIDTHS})
    result: dict[str, Any] = {"differences": found}
    x, u = [to_theirs(state) for state in ours.phases[0].guess_states], list(ours.phases[0].guess_controls)
    fddp = crocoddyl.SolverFDDP(theirs)
    fddp.th_stop = 1e-30
    parts = their_parts(crocoddyl.SolverFDDP(their_problem(robot, ours)), x, u)
    machines = {f"W={width}{end}": machine_at(both[end], width) for end in both for width in WIDTHS}
    for machine in machines.values():
        machine.c.options.cost_tolerance = 1e-30
    for end in both:
        require_full_steps(fddp, x, u, machines[f"W=8{end}"])
    samples: dict[str, list[dict[str, float]]] = {"crocoddyl": [], **{who: [] for who in machines}}
    for _ in range(repeats):  # in turns, so that whatever else the machine does disturbs all alike
        solved = each(lambda n: their_solve(fddp, x, u, n))
        samples["crocoddyl"].append({**their_sample(parts), "iteration of a solve": solved})
        for who, machine in machines.items():
            solved = each(partial(our_solve, machine))
            samples[who].append({**our_sample(machine), "iteration of a solve": solved})
    result["us_per_node"] = {who: middle(taken, 1e6 / NODES) for who, taken in samples.items()}
    result["times_faster"] = {who: ratios(samples["crocoddyl"], samples[who]) for who in machines}
    return result, machines["W=8"]


def ratios(theirs: list[dict[str, float]], ours: list[dict[str, float]]) -> dict[str, dict[str, float]]:
    """Return how many times less ours is: the median over pairs taken in one turn, and that of the least times."""
    pairs = list(zip(theirs, ours, strict=True))
    return {
        part: {
            "median": round(median(a[part] / b[part] for a, b in pairs), 2),
            "least": round(min(a[part] for a in theirs) / min(b[part] for b in ours), 2),
        }
        for part in theirs[0]
    }


def their_build() -> dict[str, Any]:
    """Return what is known of how Crocoddyl was built: the wheel tells no flags, its code which vectors it uses."""
    library = next(Path(crocoddyl.__file__).parents[3].glob("libcrocoddyl.so"))
    found: dict[str, Any] = {"crocoddyl": crocoddyl.__version__, "pin": pinocchio.__version__, "library": library.name}
    try:
        text = subprocess.run(["objdump", "-d", library], capture_output=True, text=True, check=True).stdout
    except (OSError, subprocess.CalledProcessError):
        return found
    return {**found, "instructions_with": {kind: text.count(f"%{kind}") for kind in ("xmm", "ymm", "zmm")}}


def main(robots: list[str], repeats: int = 60, json: bool = False, save: bool = False) -> dict[str, Any]:
    """Print and return differences, times per node and ratios."""
    results: dict[str, Any] = {"benchmark": "vs_crocoddyl", "nodes": NODES, "dt": DT, "repeats": repeats, "robots": {}}
    for name in robots:
        results["robots"][name], machine = compare(name, repeats)
    results |= {"their_build": their_build(), **surroundings(library_for(machine.problem)[0].built)}
    lines = []
    for name, result in results["robots"].items():
        worst = max(result["differences"].values())
        lines.append(
            f"{name}, {NODES} nodes; largest relative difference {worst:.1e}; µs per node (times faster), medians"
        )
        names = list(result["times_faster"])
        lines.append(f"{'':26}{'Crocoddyl':>10}" + "".join(f"{who:>18}" for who in names))
        for part, took in result["us_per_node"]["crocoddyl"].items():
            row = f"  {part:24}{took['median']:10.2f}"
            for who in names:
                ratio = result["times_faster"][who][part]["median"]
                row += f"{result['us_per_node'][who][part]['median']:10.2f} ({ratio:5.1f})"
            lines.append(row)
    tell(results, lines, json=json, save=save)
    return results


if __name__ == "__main__":
    parser = arguments(__doc__, repeats=60)
    parser.add_argument("robots", nargs="*", default=["solo12", "go2"])
    main(**vars(parser.parse_args()))
