"""What the benchmarks share: where and when they ran, machines at an iterate, and how their results are told."""

from __future__ import annotations

import argparse
import ctypes as ct
import json as json_format
import os
import platform
import subprocess
import time
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from functools import cache
from importlib import import_module
from importlib.metadata import version
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from statistics import median
from types import ModuleType
from typing import Any

import numpy as np

from piaffe import ocp, solvers
from piaffe.codegen.build import EXPRESSION_FLAGS, SOLVER_FLAGS, Built, build, load
from piaffe.codegen.cpu import Cpu, this_cpu
from piaffe.codegen.sources import LazySources, Sources
from piaffe.solvers.ilqr.native.library import KERNEL_FLAGS, Library, library_for
from piaffe.solvers.ilqr.native.memory import SolverMemory
from piaffe.solvers.ilqr.native.program import TEMPLATES, program, source_parts
from piaffe.solvers.ilqr.outer import Outer

RESULTS = Path(__file__).with_name("results")
PARTS = ("evaluation", "sums", "derivatives", "backward", "forward")
"""The parts of an iteration: dynamics and rows of a trial; its cost, merit and defects; the linear-quadratic model with
derivatives and contact solves; Riccati sweep; linear roll-out."""


class _Part(ct.Structure):
    """As in ``template/parts.h`` of the native backend."""

    _fields_ = (("name", ct.c_char_p), ("run", ct.c_void_p))


def surroundings(widest: Built | None = None) -> dict[str, Any]:
    """Return date, machine and versions, and how the native backend was built."""
    here: dict[str, Any] = {
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "processor": str(this_cpu()),
        "cores": os.cpu_count(),
        "load": [round(x, 2) for x in os.getloadavg()],
        "python": platform.python_version(),
        "casadi": version("casadi"),
        "numpy": np.__version__,
        "commit": _commit(),
    }
    if widest is not None:
        here |= {
            "compiler": widest.compiler, "native": this_cpu().native,
            "expression_flags": " ".join(EXPRESSION_FLAGS), "kernel_flags": " ".join(KERNEL_FLAGS),
        }  # fmt: skip
    return here


def _commit() -> str:
    told = subprocess.run(
        ["git", "describe", "--always", "--dirty"], capture_output=True, text=True, cwd=Path(ocp.__file__).parent,
        check=False,
    )  # fmt: skip
    return told.stdout.strip()


def machine_at(
    problem: ocp.CompiledProblem,
    library: int | Library | None = None,
    states: Sequence[np.ndarray] | None = None,
    controls: Sequence[np.ndarray] | None = None,
) -> SolverMemory:
    """Return a machine with model and sweep at an iterate, by default the initial guess.

    Args:
        problem: the compiled problem.
        library: the library that solves it, or the vector width of one compiled for this processor.
        states: states of the iterate, of each phase.
        controls: its controls, of each phase.
    """
    if not isinstance(library, Library):
        library = library_for(problem, width=library)[0]
    machine = SolverMemory(problem, library, solvers.Options())
    begin(machine, states, controls)
    solve(machine, 0)  # evaluate, accept, linearise, sweep, and no step
    return machine


def library_at(problem: ocp.CompiledProblem, width: int, target: str) -> Library:
    """Return a problem's library compiled for another processor than this one, which has to understand it all the same.

    Args:
        problem: the compiled problem.
        width: lanes.
        target: what ``-march`` takes.
    """
    modes = tuple(dict.fromkeys(phase.mode for phase in problem.phases))
    links = tuple(dict.fromkeys(phase.transition for phase in problem.phases if phase.transition is not None))
    expressions, kernels = (
        tuple(flag.replace("{native}", f"-march={target}") for flag in flags)
        for flags in (EXPRESSION_FLAGS, KERNEL_FLAGS)
    )

    def make() -> Sources:
        made = program(modes, links)
        return Sources([*made.expressions, *made.kernels], made.headers, {name: kernels for name, _ in made.kernels})

    parts = LazySources([*source_parts(modes, links), *kernels], make)
    built = build(parts, flags=expressions, width=width, label=f"benchmark, {target}")
    return Library(load(built), built, modes, links)


class _Avx2(Cpu):
    """A processor with AVX2, and no wider vectors."""

    @property
    def native(self) -> str:
        return "-march=x86-64-v3"

    @property
    def fingerprint(self) -> str:
        return super().fingerprint[:-2] + "v3"


def compile_for_avx2() -> None:
    """Let all that is compiled from now on in this process be for processors with AVX2, with vectors of four."""
    cpu = this_cpu()
    features = frozenset(name for name in cpu.features if not name.startswith("avx512"))
    reduced = _Avx2(cpu.machine, cpu.name, cpu.identity, features, cpu.libc)
    for name in ("build", "compilers"):
        vars(import_module(f"piaffe.codegen.{name}"))["this_cpu"] = lambda: reduced


def begin(
    machine: SolverMemory, states: Sequence[np.ndarray] | None = None, controls: Sequence[np.ndarray] | None = None
) -> None:
    """Lay an iterate (by default the initial guess) and fresh multipliers into a machine."""
    problem = machine.problem
    duals = Outer(problem, solvers.Options()).duals
    for name in ("relaxation", "shift", "multiplier", "penalty"):
        machine.write_rows(name, "stage", [getattr(d, name) for d in duals])
        machine.write_rows(name, "end", [getattr(d, f"end_{name}") for d in duals])
    for i, phase in enumerate(problem.phases):
        machine.trial(i, "x")[:] = (phase.guess_states if states is None else states[i]).ravel()
        machine.trial(i, "u")[:] = (phase.guess_controls if controls is None else controls[i]).ravel()


def solve(machine: SolverMemory, iterations: int) -> float:
    """Solve from what was laid in; return seconds of this thread, none of them spent waiting for a processor."""
    machine.c.options.max_iterations = iterations
    machine.c.cancel = 0
    began = time.thread_time()
    machine.library.piaffe_solve(ct.byref(machine.c), 0)
    return time.thread_time() - began


def steps(machine: SolverMemory) -> list[float]:
    """Return the step of each iteration of the last solve; 0 where none was accepted."""
    return [machine.history[j].step_size for j in range(machine.c.num_records)]


@cache
def _profiler() -> Any:
    """Return the timing program, compiled: it runs parts of any machine."""
    text = Path(__file__).with_name("profile.c").read_text(encoding="utf-8")
    headers = {"parts.h": TEMPLATES["parts.h"]}
    function = load(build([("profile", text)], headers=headers, flags=SOLVER_FLAGS, label="profile")).profile
    function.restype = None
    return function


def profile(machine: SolverMemory, repetitions: int = 1) -> dict[str, float]:
    """Return the least seconds of each part of an iteration."""
    parts = (_Part * len(PARTS)).in_dll(machine.library, "piaffe_parts")
    seconds = (ct.c_double * len(PARTS))()
    _profiler()(parts, len(PARTS), ct.byref(machine.c), repetitions, seconds)
    by_name = {part.name.decode(): value for part, value in zip(parts, seconds, strict=True)}
    return {name: by_name[name] for name in PARTS}


def iteration(parts: Mapping[str, float]) -> float:
    """Return an iteration with one trial: the model there, sweep, roll-out, and the trial's evaluation."""
    return sum(parts[name] for name in PARTS)


def busy_iteration(machine: SolverMemory, calls: int) -> float:
    """Return seconds of this thread that an iteration takes, without those spent waiting for a processor."""
    spent = []
    for repetitions in (1, 1 + calls):
        began = time.thread_time()
        profile(machine, repetitions)
        spent.append(time.thread_time() - began)
    return (spent[1] - spent[0]) / calls


def middle(samples: Sequence[Mapping[str, float]], scale: float, digits: int = 3) -> dict[str, dict[str, float]]:
    """Return median and least value of each entry over samples, times a scale."""
    return {
        name: {
            "median": round(scale * median(s[name] for s in samples), digits),
            "least": round(scale * min(s[name] for s in samples), digits),
        }
        for name in samples[0]
    }


def example(name: str) -> ModuleType:
    """Return a file of ``examples/`` as a module."""
    spec = spec_from_file_location(name, Path(__file__).parents[1] / "examples" / f"{name}.py")
    assert spec is not None  # the file is there
    assert spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def tell(results: Mapping[str, Any], lines: Sequence[str], *, json: bool, save: bool) -> None:
    """Print results as a table or as JSON, and keep them for the pictures if asked to."""
    text = json_format.dumps(results, indent=1)
    if save:
        RESULTS.mkdir(exist_ok=True)
        RESULTS.joinpath(f"{results['benchmark']}.json").write_text(text + "\n", encoding="utf-8")
    print(text if json else "\n".join(lines))


def arguments(description: str, repeats: int) -> argparse.ArgumentParser:
    """Return the command line that all benchmarks share."""
    parser = argparse.ArgumentParser(description=description.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=repeats, help="turns; medians are over these")
    parser.add_argument("--json", action="store_true", help="print all as JSON")
    parser.add_argument("--save", action="store_true", help="write benchmarks/results/, which the pictures are of")
    return parser
