"""Compare with Crocoddyl like for like: both compiled for the same processor by one compiler, in turns, one thread.

The problem is that of ``vs_crocoddyl.py``. Crocoddyl is compiled from its source distribution for each target, and
its wheel is timed beside it, all by one C++ program; Piaffe is compiled for the same targets. Needs the environment of
``make bench-native``. Compiling Crocoddyl takes some minutes, the first time.
"""

from __future__ import annotations

import os

os.environ["OMP_NUM_THREADS"] = "1"  # before NumPy and Crocoddyl start their threads

from contextlib import ExitStack
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import crocoddyl
import numpy as np
import vs_crocoddyl as vs
from common import arguments, library_at, machine_at, middle, steps, surroundings, tell
from native_crocoddyl import build
from native_crocoddyl.problem_file import write_problem
from native_crocoddyl.program import Program

from piaffe import models
from piaffe.codegen.cpu import this_cpu
from piaffe.solvers.ilqr.native.library import library_for
from piaffe.solvers.ilqr.native.memory import SolverMemory

WHEEL, NATIVE = build.WHEEL, "native"
LEVELS = {"x86-64-v3": (4, {"avx2", "fma", "bmi2"}), "x86-64": (2, set())}
"""Levels of x86-64: lanes that Piaffe takes on a processor of no more, and what the processor has to have."""


def targets() -> dict[str, int]:
    """Return what ``-march`` takes for each comparison on this processor, and lanes of Piaffe."""
    cpu = this_cpu()
    levels = LEVELS if cpu.machine == "x86_64" else {}
    return {NATIVE: cpu.vector_width} | {
        name: width for name, (width, needed) in levels.items() if needed <= cpu.features
    }


def write(path: Path, robot: models.Robot, theirs: crocoddyl.ShootingProblem, x: np.ndarray, u: np.ndarray) -> Path:
    """Write the problem with an iterate of ours; return the file."""
    settings = (vs.DT, vs.GAMMA, vs.POSITION, vs.VELOCITY, vs.TORQUE)
    write_problem(path, robot.model, theirs, settings, [vs.to_theirs(state) for state in x], list(u))
    return path


def their_differences(
    program: Program, theirs: crocoddyl.ShootingProblem, x: np.ndarray, u: np.ndarray
) -> dict[str, float]:
    """Return how far cost, next states and derivatives of a program are from those of the wheel in Python."""
    states, controls = [vs.to_theirs(state) for state in x], list(u)
    answer = program.ask("physics")
    found = {f"cost {program.target}": abs(answer["cost"] / theirs.calc(states, controls) - 1)}
    theirs.calcDiff(states, controls)
    for name in ("xnext", "Fx", "Fu"):
        expected = np.array([np.array(getattr(data, name)) for data in theirs.runningDatas])
        found[f"{name} {program.target}"] = vs.apart(np.reshape(answer[name], expected.shape), expected)
    return found


def require_full_steps(programs: list[Program], machines: dict[str, SolverMemory]) -> None:
    """Raise unless all take every iteration of the solve with one trial."""
    taken = {
        f"Crocoddyl, {program.target}": program.ask(f"steps {vs.SOLVE_ITERATIONS}")["steps"] for program in programs
    }
    for target, machine in machines.items():
        vs.our_solve(machine, vs.SOLVE_ITERATIONS)
        taken[f"Piaffe, {target}"] = steps(machine)
    for who, sizes in taken.items():
        if sizes != [1.0] * vs.SOLVE_ITERATIONS:
            expected = f"{vs.SOLVE_ITERATIONS} of 1 each"
            raise SystemExit(f"not the same iterations: {who} - got steps {sizes}, expected {expected}")


def compare(name: str, repeats: int) -> dict[str, Any]:
    """Return all that is to say of one robot."""
    robot, wanted = models.load(name), targets()
    ours = vs.our_problem(robot)
    theirs = vs.their_problem(robot, ours)
    built = {target: library_at(ours, width, target) for target, width in wanted.items() if target != NATIVE}
    libraries = {NATIVE: library_for(ours)[0], **built}
    found = vs.differences(robot, ours, theirs, libraries)
    phase, (x, u) = ours.phases[0], vs.random_iterate(ours)
    with TemporaryDirectory() as folder:
        at_random = write(Path(folder, "random"), robot, theirs, x, u)
        at_guess = write(Path(folder, "guess"), robot, theirs, phase.guess_states, phase.guess_controls)
        for target in (WHEEL, *wanted):
            with Program(target, at_random) as program:
                found |= their_differences(program, theirs, x, u)
        vs.require_small(found)
        machines = {target: machine_at(ours, library) for target, library in libraries.items()}
        with ExitStack() as stack:
            programs = [stack.enter_context(Program(target, at_guess)) for target in (WHEEL, *wanted)]
            times = in_turns(programs, machines, repeats)
    return {"differences": found, **summary(times, wanted)}


def in_turns(
    programs: list[Program], machines: dict[str, SolverMemory], repeats: int
) -> dict[tuple[str, str], list[dict[str, float]]]:
    """Return times [s] of every turn, by who and target; whatever else the computer does disturbs all alike."""
    for machine in machines.values():
        machine.c.options.cost_tolerance = 1e-30
    require_full_steps(programs, machines)
    times: dict[tuple[str, str], list[dict[str, float]]] = {("crocoddyl", p.target): [] for p in programs}
    times |= {("piaffe", target): [] for target in machines}
    for _ in range(repeats):
        for program in programs:
            took = program.ask(f"time {vs.CALLS} {vs.SOLVE_ITERATIONS}")
            times["crocoddyl", program.target].append({name: vs.NODES * 1e-6 * us for name, us in took.items()})
            if program.target in machines:
                machine = machines[program.target]
                solved = vs.each(partial(vs.our_solve, machine))
                times["piaffe", program.target].append({**vs.our_sample(machine), "iteration of a solve": solved})
    return times


def summary(times: dict[tuple[str, str], list[dict[str, float]]], wanted: dict[str, int]) -> dict[str, Any]:
    """Return times per node and ratios: like for like, and that of the wheel to Piaffe on this processor."""
    took = {f"{who} {target}": middle(samples, 1e6 / vs.NODES) for (who, target), samples in times.items()}
    pairs = {target: (target, target) for target in wanted} | {WHEEL: (WHEEL, NATIVE)}
    faster = {
        name: vs.ratios(times["crocoddyl", theirs], times["piaffe", ours]) for name, (theirs, ours) in pairs.items()
    }
    return {"us_per_node": took, "times_faster": faster}


def lines_of(name: str, result: dict[str, Any], wanted: dict[str, int]) -> list[str]:
    """Return a robot's results as text."""
    worst = max(result["differences"].values())
    lines = [f"{name}, {vs.NODES} nodes; largest relative difference {worst:.1e}; µs per node, medians (least)"]
    for target in (*wanted, WHEEL):
        width = wanted.get(target, wanted[NATIVE])
        ours = target if target in wanted else NATIVE
        how = "its wheel, built for any x86-64" if target == WHEEL else " ".join(build.flags_of(target))
        head = (f"{target}; Crocoddyl: {how}", f"Piaffe W={width}")
        lines.append(f"\n{head[0]}\n{'':44}{'Crocoddyl':>16}{head[1]:>16}{'times faster':>16}")
        faster = result["times_faster"][target]
        for part in faster:
            a, b = (result["us_per_node"][who][part] for who in (f"crocoddyl {target}", f"piaffe {ours}"))
            cells = [f"{x['median']:.2f} ({x['least']:.2f})" for x in (a, b, faster[part])]
            lines.append(f"  {part:42}" + "".join(f"{cell:>16}" for cell in cells))
    return lines


def main(robots: list[str], repeats: int, json: bool = False, save: bool = False) -> dict[str, Any]:
    """Print and return differences, times per node and ratios."""
    wanted = targets()
    results: dict[str, Any] = {"benchmark": "like_for_like", "nodes": vs.NODES, "dt": vs.DT, "repeats": repeats}
    flags = {target: " ".join(build.flags_of(target)) for target in wanted}
    results["their_build"] = {"compiler": build.compiler(), "flags": flags, **build.SDISTS}
    results["lanes"] = wanted
    results["robots"] = {name: compare(name, repeats) for name in robots}
    results |= surroundings(library_for(vs.our_problem(models.load(robots[0])))[0].built)
    lines = [line for name in robots for line in lines_of(name, results["robots"][name], wanted)]
    tell(results, lines, json=json, save=save)
    return results


if __name__ == "__main__":
    parser = arguments(__doc__, repeats=60)
    parser.add_argument("robots", nargs="*", default=["solo12"])
    main(**vars(parser.parse_args()))
