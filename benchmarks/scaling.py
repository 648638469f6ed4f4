"""Time an iteration against the number of nodes, lanes and threads, and a batch against threads: Mini Cheetah trotting.

Two threads are two solves at once from two Python threads, as ctypes lets go of the interpreter. Their gain is how much
more is solved in the same time, which wants a machine with two cores to spare: whether it had them tells the gain of
hashing, measured beside it. A batch is ``solve_batch`` of instances with random masses and friction, from the solution
of the nominal one, whole: checks, numbers and results included.
"""

from __future__ import annotations

import os

os.environ["OMP_NUM_THREADS"] = "1"

import hashlib
import threading
from statistics import median
from time import perf_counter
from typing import Any

import numpy as np
from common import arguments, begin, busy_iteration, machine_at, middle, profile, solve, surroundings, tell

from piaffe import models, ocp, solvers
from piaffe.models import base, feet, joints
from piaffe.solvers.ilqr.native.library import library_for
from piaffe.solvers.ilqr.native.memory import SolverMemory

NODES = (25, 50, 100, 200, 500, 1000, 2000)
LANES = (1, 4, 8)
THREADS = (1, 2)
DT = 0.01  # [s]
THREADED_NODES = (25, 100, 500)
BATCH_NODES, INSTANCES = 50, 64
ITERATIONS = 10  # of a threaded solve
HASHED = bytes(20_000_000)
CALLS = 3  # of the parts per turn: the least of them was not interrupted


def swing(s):
    """1 for feet in the air."""
    return 1 - s.feet.contact


def problems() -> dict[int, ocp.CompiledProblem]:
    """Return the trot over every number of nodes."""
    robot = models.load("mini_cheetah")
    body = models.WholeBody(robot)
    walking = ocp.Objective(
        ocp.track(base.position, weight=(0, 0, 50)),
        ocp.track(base.orientation, weight=2.0),
        ocp.track(base.linear_velocity, weight=2.0),
        ocp.track(base.angular_velocity, weight=2.0),
        ocp.track(joints.position, weight=1.0),
        ocp.track(joints.velocity, weight=0.01),
        ocp.track(feet.position, weight=10.0, mask=swing),
        ocp.regularize(joints.torque, weight=0.02),
    )
    limits = ocp.Constraints(models.friction_cone(mu=0.6), models.torque_limits(), models.joint_limits())
    made = {}
    for nodes in NODES:
        schedule = body.over(nodes * DT, dt=DT)
        problem = ocp.Problem(
            models.gaits.trot(0.5), schedule, walking, limits, initial=body.state(joints="stand")
        )  # fmt: skip
        made[nodes] = ocp.compile_problem(problem)
    return made


def at_once(machines: list[SolverMemory]) -> tuple[float, float]:
    """Return seconds on the clock in which all machines solve, a thread each, and the mean of the threads' own."""
    for machine in machines:
        begin(machine)
    busy: list[float] = []
    threads = [threading.Thread(target=lambda m=machine: busy.append(solve(m, ITERATIONS))) for machine in machines]
    began = perf_counter()
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return perf_counter() - began, sum(busy) / len(busy)


def hashing(threads: int) -> float:
    """Return seconds on the clock in which as many threads hash some data each, which needs neither lock nor memory."""
    workers = [threading.Thread(target=hashlib.sha256, args=(HASHED,)) for _ in range(threads)]
    began = perf_counter()
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
    return perf_counter() - began


def batch_of(problem: ocp.CompiledProblem) -> dict[str, Any]:
    """Return the arguments of a batch with random payloads and frictions."""
    random = np.random.default_rng(0)
    masses = np.tile(problem.parameters["mini_cheetah.link_mass"], (INSTANCES, 1))
    masses[:, 0] += random.uniform(0.0, 3.0, INSTANCES)
    numbers = {"mini_cheetah.link_mass": masses, "friction cone.mu": random.uniform(0.5, 0.9, INSTANCES)}
    nominal = solvers.MSiLQR(problem).solve().raise_if_failed()
    return {"problem": problem, "parameters": numbers, "warm_start": nominal}


def main(repeats: int = 15, json: bool = False, save: bool = False) -> dict[str, Any]:
    """Print and return medians of an iteration's time and of the gain by a second thread."""
    made = problems()
    cases = [(lanes, nodes) for lanes in LANES for nodes in NODES]
    machines = {(lanes, nodes): machine_at(made[nodes], lanes) for lanes, nodes in cases}
    samples: dict[Any, list[dict[str, float]]] = {case: [] for case in cases}
    pairs = {nodes: [machine_at(made[nodes]) for _ in range(max(THREADS))] for nodes in THREADED_NODES}
    threaded: dict[Any, list[tuple[float, float]]] = {(nodes, n): [] for nodes in THREADED_NODES for n in THREADS}
    control: list[float] = []
    batch = batch_of(made[BATCH_NODES])
    batches: dict[int, list[solvers.BatchSolution]] = {n: [] for n in THREADS}
    for _ in range(repeats):  # in turns, so that whatever else the machine does disturbs all alike
        for case in cases:
            samples[case].append({"iteration": busy_iteration(machines[case], CALLS), **profile(machines[case], CALLS)})
        for nodes, n in threaded:
            threaded[nodes, n].append(at_once(pairs[nodes][:n]))
        for n in THREADS:
            batches[n].append(solvers.solve_batch(**batch, threads=n))
        control.append(2 * hashing(1) / hashing(2))
    rows = [
        {"lanes": lanes, "nodes": nodes, "us_per_node": middle(samples[lanes, nodes], 1e6 / nodes)}
        for lanes, nodes in cases
    ]
    gains = []
    for nodes in THREADED_NODES:
        (one, busy_one), (two, busy_two) = (zip(*threaded[nodes, n], strict=True) for n in THREADS)
        gains.append({
            "nodes": nodes, "ms_alone": round(1e3 * median(one), 3), "ms_two_at_once": round(1e3 * median(two), 3),
            "gain": round(median(2 * a / b for a, b in zip(one, two, strict=True)), 3),
            "gain_of_least": round(2 * min(one) / min(two), 3),
            "processor_time": round(median(b / a for a, b in zip(busy_one, busy_two, strict=True)), 3),
        })  # fmt: skip
    rates = [
        {
            "threads": n, "nodes": BATCH_NODES, "instances": INSTANCES,
            "per_second": round(median(INSTANCES / done.wall_s for done in batches[n]), 2),
            "best_per_second": round(max(INSTANCES / done.wall_s for done in batches[n]), 2),
            "converged": int(batches[n][0].converged.sum()), "iterations": int(batches[n][0].iterations.sum()),
        }
        for n in THREADS
    ]  # fmt: skip
    results: dict[str, Any] = {
        "benchmark": "scaling", "repeats": repeats, "dt": DT, "sizes": rows, "threads": gains, "batch": rates,
        "gain_of_hashing": round(median(control), 3),
        **surroundings(library_for(made[NODES[0]])[0].built),
    }  # fmt: skip
    lines = ["median µs per node and iteration", f"{'nodes':>8}" + "".join(f"{f'W={w}':>10}" for w in LANES)]
    for nodes in NODES:
        times = [row["us_per_node"]["iteration"]["median"] for row in rows if row["nodes"] == nodes]
        lines.append(f"{nodes:8d}" + "".join(f"{value:10.2f}" for value in times))
    lines.append("two solves in two threads: gain (median, of least times), processor time of each against alone")
    lines += [
        f"{row['nodes']:8d}{row['gain']:10.2f}{row['gain_of_least']:10.2f}{row['processor_time']:10.2f}"
        for row in gains
    ]
    lines.append(f"instances a second of a batch of {INSTANCES} with {BATCH_NODES} nodes (median, best)")
    lines += [
        f"{row['threads']:8d} threads{row['per_second']:10.1f}{row['best_per_second']:10.1f}"
        f"{row['iterations'] / INSTANCES:10.1f} iterations each, {row['converged']} converged"
        for row in rates
    ]
    lines.append(f"gain of hashing {median(control):.2f}")
    tell(results, lines, json=json, save=save)
    return results


if __name__ == "__main__":
    main(**vars(arguments(__doc__, repeats=15).parse_args()))
