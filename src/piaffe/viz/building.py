"""Start a solver with a display of the compilation; a missing compiler is reported in one line."""

from __future__ import annotations

import sys
import warnings

from rich.console import Console

from piaffe.codegen import NoCompilerWarning
from piaffe.ocp import Problem
from piaffe.solvers import MSiLQR, Options


def start_solver(problem: Problem, options: Options, backend: str) -> MSiLQR:
    """Return a solver; during its compilation, standard error shows the progress.

    Args:
        problem: the problem.
        options: options.
        backend: ``"native"`` or ``"numpy"``.
    """
    console = Console(stderr=True)
    with console.status("compiling the problem") as status, warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", NoCompilerWarning)

        def show(done: int, steps: int, what: str) -> None:
            status.update(f"compiling for this machine, once: {done} of {steps} ({what})")

        solver = MSiLQR(problem, options, backend=backend, building=show)  # type: ignore[arg-type]  # checked there
    for warning in caught:
        if issubclass(warning.category, NoCompilerWarning):
            print(warning.message, file=sys.stderr)
        else:
            warnings.warn_explicit(warning.message, warning.category, warning.filename, warning.lineno)
    return solver
