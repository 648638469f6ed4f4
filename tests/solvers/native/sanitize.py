"""Run the compiled solver under AddressSanitizer and UndefinedBehaviorSanitizer: ``make sanitize``.

Every array of a machine is allocated by itself, exactly as large as it is said to be, and begins as NaN, as do
variables on the stack; so what is read past an end, or before it is written, shows. Histories must be those of the
NumPy backend. Arguments name problems of the tests; ``landing``, of a whole robot, takes minutes to compile.
"""

import ctypes
import os
import subprocess
import sys
from typing import Any

import numpy as np

from piaffe.ocp import CompiledProblem, compile_problem
from piaffe.solvers import MSiLQR, Options
from piaffe.solvers.native import Machine, build, load
from piaffe.solvers.native.compilers import working
from piaffe.solvers.native.library import Library
from piaffe.solvers.native.program import program

from .test_solver import ALL

SANITIZE = ("-fsanitize=address,undefined", "-fno-sanitize-recover=all")
FLAGS = (
    "-O1", "-g", "-fno-omit-frame-pointer", "-ftrivial-auto-var-init=pattern", "-fno-math-errno", "-ffp-contract=fast",
    "{native}", *SANITIZE,
)  # fmt: skip
WIDTHS = (1, 4, 8)
LIBC = ctypes.CDLL(None)
SMALL = [name for name in ALL if name != "landing"]


class ExactMachine(Machine):
    """A machine with no room behind its arrays."""

    def _array(self, size: int, values: Any = None) -> Any:
        place = ctypes.c_void_p()
        LIBC.posix_memalign(ctypes.byref(place), ctypes.c_size_t(64), ctypes.c_size_t(8 * size))
        assert place.value
        array = np.frombuffer((ctypes.c_double * size).from_address(place.value)) if size else np.zeros(0)
        if values is None:
            array[:] = np.nan
        else:
            array[:] = np.ravel(values) if isinstance(values, np.ndarray) else values
        return self._keep(array)


def tell(text: str) -> None:
    """Write a line."""
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


def library_of(problem: CompiledProblem, width: int) -> Library:
    """Return an instrumented library."""
    modes = tuple(dict.fromkeys(phase.mode for phase in problem.phases))
    links = tuple(dict.fromkeys(phase.transition for phase in problem.phases if phase.transition is not None))
    sources = program(modes, links)
    built = build(
        [*sources.expressions, *sources.kernels], headers=sources.headers, flags=FLAGS, link=("-lm", *SANITIZE),
        width=width, label="sanitized",
    )  # fmt: skip
    return Library(load(built) if "LD_PRELOAD" in os.environ else ctypes.CDLL(None), built, modes, links)


def solve(name: str, problem: CompiledProblem, width: int) -> None:
    """Solve twice, cold and warm, and compare with NumPy."""
    options = Options(barrier_gap=1e-5)
    by_numpy = MSiLQR(problem, options, backend="numpy")
    native = MSiLQR(problem, options, backend="numpy")
    native.machine = ExactMachine(problem, library_of(problem, width), options)
    a, b = native.solve(), by_numpy.solve()
    for got, expected in ((a, b), (native.solve(b), by_numpy.solve(b))):
        assert got.status is expected.status, (got.status, expected.status)
        costs = [[record.cost for record in solution.history] for solution in (got, expected)]
        np.testing.assert_allclose(*costs, rtol=1e-8)
    native.machine.library.piaffe_policy(ctypes.byref(native.machine.c))
    native.machine.library.piaffe_profile(ctypes.byref(native.machine.c), 2, (ctypes.c_double * 5)())
    tell(f"{name}, {width} lanes: {a.iterations} iterations, {a.status.name.lower()}")


def main() -> int:
    """Build, then run again with the sanitizers' libraries loaded."""
    chosen = {name: compile_problem(ALL[name]()) for name in sys.argv[1:] or SMALL}
    if "LD_PRELOAD" in os.environ:
        for name, problem in chosen.items():
            for width in WIDTHS:
                solve(name, problem, width)
        tell("no finding")
        return 0
    for problem in chosen.values():
        for width in WIDTHS:
            library_of(problem, width)
    command = working().command
    libraries = []
    for name in ("libasan.so", "libubsan.so", "libstdc++.so.6"):
        done = subprocess.run([*command, f"-print-file-name={name}"], capture_output=True, text=True, check=True)
        libraries.append(done.stdout.strip())
    environment = {
        **os.environ, "LD_PRELOAD": " ".join(libraries), "UBSAN_OPTIONS": "print_stacktrace=1",
        "ASAN_OPTIONS": "detect_leaks=0",  # Python's
    }  # fmt: skip
    again = [sys.executable, "-m", "tests.solvers.native.sanitize", *sys.argv[1:]]
    return subprocess.run(again, env=environment, check=False).returncode


if __name__ == "__main__":
    sys.exit(main())
