"""Start a solver with a display of the compilation; warnings are shown in one line each, as soon as they come."""

from __future__ import annotations

import sys
import warnings
from typing import Any

from rich.console import Console
from rich.markup import escape

from piaffe.codegen import NoCompilerWarning
from piaffe.errors import PiaffeWarning
from piaffe.ocp import Problem
from piaffe.solvers import MSiLQR, Options


def start_solver(problem: Problem, options: Options, backend: str) -> MSiLQR:
    """Return a solver; during its compilation, standard error shows the progress, and the problem's warnings.

    Args:
        problem: the problem.
        options: options.
        backend: ``"native"`` or ``"numpy"``.
    """
    console = Console(stderr=True)
    with console.status("compiling the problem") as status, warnings.catch_warnings():
        warnings.simplefilter("always", NoCompilerWarning)
        warnings.simplefilter("always", PiaffeWarning)
        others = warnings.showwarning

        def print_warning(message: Warning | str, category: type[Warning], *more: Any, **named: Any) -> None:
            if issubclass(category, NoCompilerWarning):
                print(message, file=sys.stderr)
            elif issubclass(category, PiaffeWarning):
                text = str(message).replace("[", r"\[")
                console.print(f"[bold yellow]warning:[/] {text}", highlight=False, soft_wrap=True)
            else:
                others(message, category, *more, **named)

        def show(done: int, steps: int, what: str) -> None:
            status.update(f"compiling for this machine, once: {done} of {steps} ({what})")

        def show_phases(done: int, phases: int, phase: str) -> None:
            status.update(f"compiling the problem: {done} of {phases} phases ({escape(phase)})")

        warnings.showwarning = print_warning
        return MSiLQR(problem, options, backend=backend, compiling=show_phases, building=show)  # type: ignore[arg-type]
