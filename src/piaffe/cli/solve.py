"""The command that solves a problem, saves the solution, and draws and films it."""

from __future__ import annotations

import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from piaffe.errors import FileWriteError

from .arguments import FAILED, File, Json
from .reports import terminal

if TYPE_CHECKING:
    from piaffe.solvers import Solution

RESULTS = Path("results")
"""Where a solution is saved if no other place is given."""


def solve(
    file: File,
    save: Annotated[
        Path | None,
        typer.Option(
            metavar="R.npz",
            help="Save the solution here, converged or not; by default as results/NAME.npz, NAME of FILE.",
        ),
    ] = None,
    no_save: Annotated[bool, typer.Option("--no-save", help="Do not save the solution.")] = False,
    plot: Annotated[Path | None, typer.Option(metavar="P.png", help="Also draw the solution, as piaffe plot.")] = None,
    video: Annotated[Path | None, typer.Option(metavar="V.mp4", help="Also film it, as piaffe video.")] = None,
    json: Json = False,
    max_iterations: Annotated[int | None, typer.Option(min=1, help="Largest number of iterations.")] = None,
    time_limit: Annotated[float | None, typer.Option(help="Time limit \\[s].")] = None,
    warm_start: Annotated[Path | None, typer.Option(metavar="R.npz", help="Start from a saved solution.")] = None,
    backend: Annotated[str, typer.Option(help="native (compiled C) or numpy (the readable reference).")] = "native",
) -> None:
    """Solve a problem, with a live table of iterations. Exit code 1 if it does not converge."""
    pictures = _checked_pictures(plot, video)
    destination = None if no_save else _destination(file, save)

    from piaffe.ocp import load_problem
    from piaffe.solvers import Options, Solution
    from piaffe.viz import LiveTable, start_solver

    from .reports import as_json, print_solution, solution_values

    problem = load_problem(file, quiet=json)
    limits: dict[str, Any] = {"max_iterations": max_iterations, "time_limit_s": time_limit}
    settings = replace(Options(), **{key: value for key, value in limits.items() if value is not None})
    start = None if warm_start is None else Solution.load(warm_start)
    began = time.perf_counter()
    solver = start_solver(problem, settings, backend)
    if json:
        solution = solver.solve(start)
    else:
        with LiveTable(settings) as table:
            solution = solver.solve(start, progress=table)
    wall_s = time.perf_counter() - began
    if json:
        print(as_json(solution_values(solution, wall_s)))
    else:
        print_solution(terminal(), solution, wall_s)
    # after the summary, which is not lost if the disk is full by now
    made = [] if destination is None else [solution.save(destination)]
    made += [draw(solution, path) for draw, path in pictures]
    if not json:
        print(*(f"saved {path}" for path in made), sep="\n")
    raise typer.Exit(0 if solution.converged else FAILED)


def _destination(file: str, save: Path | None) -> Path | None:
    """Return where the solution goes, checked before the solve; None, with a warning, if the default is no place."""
    from piaffe.files import check_destination
    from piaffe.ocp import split_spec

    if save is not None:
        check_destination(save)
        return save
    path, name = split_spec(file)
    chosen = RESULTS / f"{path.stem}{'' if name == 'problem' else f'-{name}'}.npz"
    try:
        check_destination(chosen)
    except FileWriteError as error:
        print(f"warning: the solution is not saved: {error}", file=sys.stderr)
        return None
    return chosen


def _checked_pictures(plot: Path | None, video: Path | None) -> list[tuple[Any, Path]]:
    """Return what draws each picture and where; raise before the solve if one cannot be written."""
    from piaffe.files import check_destination
    from piaffe.viz import gl, is_sheet, require_picture

    pictures: list[tuple[Any, Path]] = []
    if plot is not None:
        require_picture(plot)
        check_destination(plot)
        pictures.append((_draw, plot))
    if video is not None:
        is_sheet(video)
        check_destination(video)
        gl.prepare()  # before the problem's file imports MuJoCo
        pictures.append((_film, video))
    return pictures


def _draw(solution: Solution, path: Path) -> Path:
    from piaffe.viz import plot

    return plot(solution, path)


def _film(solution: Solution, path: Path) -> Path:
    from piaffe.viz import film

    return film(solution, path)[0]
