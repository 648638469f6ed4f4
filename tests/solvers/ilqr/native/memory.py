"""Run the compiled solver, without Python, where errors of memory show: ``make sanitize``, ``make valgrind``.

A program is made of the generated C and ``replay.c``; it solves from a cold and from a warm start. AddressSanitizer and
UndefinedBehaviorSanitizer see what is read or written past an end, or is not defined in C; memcheck sees what is read
before it is written, as far as a result depends on it. Histories must be those of the NumPy backend. Arguments name
problems of the tests, examples (``barrel_roll``) or what stands in one (``gaits:pace``); by default all.
"""

import argparse
import atexit
import importlib.util
import os
import platform
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np

from piaffe import ocp
from piaffe.codegen.compilers import working
from piaffe.codegen.cpu import this_cpu
from piaffe.ocp import CompiledProblem, compile_problem
from piaffe.solvers import MSiLQR, Options, Solution
from piaffe.solvers.ilqr.native.backend import STATUS, write
from piaffe.solvers.ilqr.native.library import library_for
from piaffe.solvers.ilqr.native.program import program
from piaffe.solvers.ilqr.outer import Outer
from piaffe.solvers.ilqr.rollout import Flags
from piaffe.solvers.ilqr.warm_start import WarmStart, first_iterate

from .image import ImageMemory, table_names
from .test_solver import ALL

EXAMPLES = Path(__file__).resolve().parents[4] / "examples"
OF_EXAMPLES = (
    "barrel_roll", "biped", "cascade", "gaits:bound", "gaits:pace", "gaits:flying_trot", "gaits:pronk",
    "own_dynamics", "own_terms", "randomised_mass", "run_roll_run", "trot_mppi",
)  # fmt: skip
SMALL = tuple(name for name in ALL if name != "landing")
STRAIGHT = ("-O0",)  # expressions have no branches to optimise, and take minutes with sanitizers and -O1
COMMON = ("-std=gnu11", "-w", "-O1", "-g", "-fno-omit-frame-pointer", "-fno-math-errno", "-ffp-contract=fast")
SANITIZE = ("-fsanitize=address,undefined", "-fno-sanitize-recover=all")
MEMCHECK = ("valgrind", "--quiet", "--error-exitcode=9", "--leak-check=full", "--track-origins=yes")


Case = tuple[int, str]
"""Lanes, and the flag for the processor."""


@dataclass(frozen=True)
class Tool:
    """A way to find errors of memory.

    Args:
        flags: for compiler and linker.
        command: what runs the program.
        cases: lanes to try, and the flag for the processor of each.
        example: those of an example.
    """

    flags: tuple[str, ...]
    command: tuple[str, ...]
    cases: tuple[Case, ...]
    example: Case


X86 = platform.machine() == "x86_64"
NATIVE = this_cpu().native
PLAIN = "-march=x86-64" if X86 else NATIVE  # registers of two numbers
WITHOUT_AVX512 = "-march=x86-64-v3" if X86 else NATIVE

TOOLS = {
    "sanitizers": Tool(
        SANITIZE, (), ((1, NATIVE), (4, NATIVE), (8, NATIVE), (2, PLAIN)), (this_cpu().vector_width, NATIVE)
    ),
    "valgrind": Tool(  # which does not know AVX-512
        ("-DUNDEFINED",), MEMCHECK, ((4, WITHOUT_AVX512), (1, WITHOUT_AVX512), (2, PLAIN)), (4, WITHOUT_AVX512)
    ),
}


@cache
def missing(name: str) -> str:
    """Return what is missing to use a tool here, in words; empty if nothing is."""
    if name == "valgrind" and shutil.which("valgrind") is None:
        return "valgrind is not installed"
    tool = TOOLS[name]
    with tempfile.TemporaryDirectory() as folder:
        source, trial = Path(folder, "trial.c"), Path(folder, "trial")
        source.write_text("int main(void) { return 0; }\n")
        made = subprocess.run(
            [*working().command, tool.example[1], *tool.flags, str(source), "-o", str(trial)],
            capture_output=True, text=True, check=False,
        )  # fmt: skip
        if made.returncode:
            return f"the compiler has no {name}: {made.stderr[:300]}"
        ran = subprocess.run([*tool.command, str(trial)], capture_output=True, text=True, check=False)
        return "" if ran.returncode == 0 else f"{name} do not run here: {ran.stderr[:300]}"


def check(
    problem: CompiledProblem,
    tool: Tool,
    case: Case,
    options: Options | None = None,
    spoil: Callable[[ImageMemory], None] = lambda memory: None,
    shooting: bool | Sequence[Flags] = True,
) -> list[Solution]:
    """Solve under a tool, cold and warm, and compare with NumPy.

    Args:
        problem: the problem.
        tool: the tool.
        case: lanes, and the flag for the processor.
        options: of the solver.
        spoil: does something to the memory before it is run, for tests of the tool.
        shooting: which nodes are shooting nodes.

    Raises:
        AssertionError: something is found.
    """
    options = options or Options(barrier_gap=1e-5)
    solver = MSiLQR(problem, options, backend="numpy")
    cold = solver.solve(shooting=shooting)
    first = replace(options, max_iterations=max(cold.iterations // 2, 1))
    half = MSiLQR(problem, first, backend="numpy").solve(shooting=shooting)
    expected = [cold, solver.solve(half, shooting=shooting)]
    program_file, scaled = _program(problem, tool, case), solver.scaled_options()
    with tempfile.TemporaryDirectory() as folder:
        images = []
        library, _ = library_for(problem, width=case[0])
        for k, warm in enumerate((None, WarmStart.of(half))):
            memory, outer = ImageMemory(problem, library, scaled), Outer(problem, scaled)
            if warm is not None:
                outer.resume(warm)
            memory.set_shooting(solver.flags(shooting))
            resumed = write(memory, first_iterate(problem, warm), outer, warm)
            images.append(Path(folder, f"{k}.image"))
            spoil(memory)
            memory.save(images[-1], resumed)
        environment = {**os.environ, "UBSAN_OPTIONS": "print_stacktrace=1"}
        command = [*tool.command, str(program_file), *map(str, images)]
        ran = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    assert ran.returncode == 0, ran.stderr[:6000]
    assert not ran.stderr, ran.stderr[:6000]
    lines = iter(ran.stdout.splitlines())
    for solution in expected:
        status, count, merit = next(lines).split()
        costs = [float(next(lines)) for _ in range(int(count))]
        assert STATUS[int(status)] is solution.status, (status, solution.status)
        np.testing.assert_allclose(costs, [record.cost for record in solution.history], rtol=1e-8)
        assert solution.search is not None
        np.testing.assert_allclose(float(merit), solution.search.merit, rtol=1e-8)
    return expected


def _program(problem: CompiledProblem, tool: Tool, case: Case) -> Path:
    """Return a program of a problem's modes and ``replay.c``."""
    width, cpu = case
    library, _ = library_for(problem, width=width)
    sources = program(library.modes, library.transitions)
    names = table_names(library)
    extern = "".join(f"extern const char {name}[];\n" for name in names)
    units = {
        **dict(sources.expressions), **dict(sources.kernels),
        "tables": f"{extern}const void *const tables[] = {{{', '.join(names)}}};\n",
        "replay": Path(__file__).with_name("replay.c").read_text(encoding="utf-8"),
    }  # fmt: skip
    straight = frozenset(name for name, _ in sources.expressions)
    flags = (*COMMON, cpu, *tool.flags, f"-DPIAFFE_W={width}")
    return _compiled(tuple(units.items()), tuple(sources.headers.items()), straight, flags, tool.flags)


@cache  # gaits of one robot are one program
def _compiled(
    units: tuple[tuple[str, str], ...], headers: tuple[tuple[str, str], ...], straight: frozenset[str],
    flags: tuple[str, ...], link: tuple[str, ...],
) -> Path:  # fmt: skip
    """Return a linked program, which lasts as long as this process."""
    folder = Path(tempfile.mkdtemp())
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    for name, text in headers:
        (folder / name).write_text(text)

    def unit(name: str, text: str) -> None:
        (folder / f"{name}.c").write_text(text)
        own = STRAIGHT if name in straight else ()
        _run([*working().command, *flags, *own, "-c", f"{name}.c", "-o", f"{name}.o"], folder)

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        list(pool.map(lambda each: unit(*each), sorted(units, key=lambda each: -len(each[1]))))
    _run([*working().command, *link, *(f"{name}.o" for name, _ in units), "-o", "replay", "-lm"], folder)
    return folder / "replay"


def _run(command: Sequence[str], folder: Path) -> None:
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[:3000]


def example(name: str) -> ocp.Problem:
    """Return a problem of an example, ``"file"`` or ``"file:name"``."""
    file, _, which = name.partition(":")
    spec = importlib.util.spec_from_file_location(f"example_{file}", EXAMPLES / f"{file}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    found = getattr(module, which or "problem")
    return found if isinstance(found, ocp.Problem) else found()


def main() -> int:
    """Check problems with a tool; return 1 if something is found."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("tool", choices=TOOLS)
    parser.add_argument("names", nargs="*", default=[*ALL, *OF_EXAMPLES])
    parser.add_argument("--iterations", type=int, default=25, help="of an example")
    arguments = parser.parse_args()
    if lacking := missing(arguments.tool):
        sys.stdout.write(f"nothing checked: {lacking}\n")
        return 2
    tool, found = TOOLS[arguments.tool], 0
    for name in arguments.names:
        made: Callable[[], ocp.Problem] = ALL.get(name, lambda name=name: example(name))
        problem = compile_problem(made())
        options = None if name in ALL else Options(max_iterations=arguments.iterations)
        for case in tool.cases if name in ALL else (tool.example,):
            try:
                done = check(problem, tool, case, options)
                told = f"{done[0].iterations} + {done[1].iterations} iterations, nothing found"
            except AssertionError as error:
                found, told = 1, f"FOUND\n{error}"
            sys.stdout.write(f"{name}, {case[0]} lanes, {case[1]}: {told}\n")
            sys.stdout.flush()
    return found


if __name__ == "__main__":
    sys.exit(main())
