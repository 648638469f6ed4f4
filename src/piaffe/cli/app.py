"""The command line application; a command imports the packages that it needs when it runs."""

from __future__ import annotations

import os
import sys
from typing import Annotated

import typer

from piaffe import __version__
from piaffe.errors import PiaffeError
from piaffe.interrupts import exit_on_interrupt, interruptible

from .arguments import FAILED, INTERRUPTED, REFUSED
from .cache import cache
from .doctor import doctor
from .export import export
from .mpc import mpc
from .mppi import NamesControllers, mppi
from .new import new
from .picture_commands import plot, pose, video, view
from .problem_commands import check, describe, verify
from .reports import plain, terminal
from .solve import solve
from .study import study

COMMANDS = (new, describe, solve, verify, check, plot, video, view, pose, doctor, cache, mpc, mppi, study, export)

app = typer.Typer(
    name="piaffe",
    help="Declare a legged motion once; describe, solve, verify, plot and film it.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def main(arguments: list[str] | None = None) -> int:
    """Run a command and return its exit code; an error of Piaffe is printed as one line on standard error.

    Args:
        arguments: the words of the command; by default those of the process, which ends after the command.
    """
    code = _run(arguments)
    if arguments is None:
        exit_on_interrupt(INTERRUPTED)
    return code


def _run(arguments: list[str] | None) -> int:
    words = sys.argv[1:] if arguments is None else arguments
    show = "--traceback" in words or bool(os.environ.get("PIAFFE_TRACEBACK"))
    try:
        with interruptible():
            code = app([word for word in words if word != "--traceback"], prog_name="piaffe", standalone_mode=True)
    except KeyboardInterrupt:
        if show:
            raise
        terminal(stderr=True).print("interrupted")
        return INTERRUPTED
    except SystemExit as end:
        return int(end.code or 0) if isinstance(end.code, int | None) else FAILED
    except (PiaffeError, OSError) as error:
        if show:
            raise
        terminal(stderr=True).print(f"[bold red]error:[/] {plain(str(error))}", soft_wrap=True)
        return REFUSED
    return int(code or 0)


def _version(show: bool) -> None:
    if show:
        print(f"piaffe {__version__}")
        raise typer.Exit


@app.callback()
def options(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and exit.")
    ] = False,
    traceback: Annotated[bool, typer.Option("--traceback", help="Show the calls that led to an error.")] = False,
) -> None:
    """Declare a legged motion once; describe, solve, verify, plot and film it."""


for command in COMMANDS:
    app.command(cls=NamesControllers if command is mppi else None)(command)
