"""The commands on a declared problem: describe, solve, verify, check."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from piaffe.errors import PiaffeError

from .arguments import FAILED, File, Json, Saved
from .reports import plain, terminal, working


def describe(
    file: File,
    pictures: Annotated[
        Path | None,
        typer.Option(metavar="P.png", help="Also draw each keyframe; feet that are off the ground have a red mark."),
    ] = None,
) -> None:
    """Print the compiled phases, the models in which each term is bound (or why it is not), and warnings."""
    if pictures is not None:
        from piaffe.files import check_destination
        from piaffe.viz import gl, require_picture

        require_picture(pictures)
        check_destination(pictures)
        gl.prepare()  # before the problem's file imports MuJoCo

    from piaffe.ocp import compile_problem, load_problem
    from piaffe.ocp import describe as text

    problem = load_problem(file)
    with working("compiling the problem"):
        told = text(compile_problem(problem))
    print(told)
    if pictures is not None:
        from piaffe.viz import keyframes, save_picture

        print(f"saved {save_picture(keyframes(problem), pictures)}")


def verify(
    solution: Saved,
    file: File,
    simulated: Annotated[
        bool, typer.Option("--simulate", help="Also play the feedback policy on MuJoCo, from perturbed starts.")
    ] = False,
    seeds: Annotated[int, typer.Option(min=1, help="Number of perturbed starts of the simulation.")] = 10,
    first_seed: Annotated[int, typer.Option(min=0, help="The first seed.")] = 0,
    friction: Annotated[
        float | None, typer.Option(help="Friction coefficient of the simulation; by default that of the problem.")
    ] = None,
    perturbation: Annotated[
        float, typer.Option(min=0.0, help="Factor of the perturbations; with 0 the simulation starts as planned.")
    ] = 1.0,
    json: Json = False,
) -> None:
    """Recompute a solution without the solver; with --simulate, also play it. Exit code 1 if it does not execute.

    Recomputed are defects, equalities, inequalities, slip and height of standing feet, and the parabola of flights.
    """
    from piaffe.ocp import compile_problem, load_problem
    from piaffe.ocp import verify as recompute
    from piaffe.solvers import Solution  # only to read the file

    from .reports import as_json, print_execution, print_verification, simulation_values, verification_values

    loaded = Solution.load(solution)
    problem = load_problem(file, quiet=json)
    with working("compiling the problem"):
        compiled = compile_problem(problem, checks=False)
        result = recompute(compiled, loaded.trajectory)
    values = verification_values(compiled, loaded.trajectory, result)
    if not json:
        print_verification(terminal(), result, values)
    played = True
    if simulated:
        from piaffe.simulation import Perturbation, execute

        chosen = range(first_seed, first_seed + seeds)
        starts = Perturbation().scaled(perturbation)
        with working(f"simulating {seeds} starts"):
            run = execute(loaded, compiled, seeds=chosen, friction=friction, perturbation=starts)
        values["simulation"], played = simulation_values(run), run.holds
        if not json:
            print_execution(terminal(), run)
    if json:
        print(as_json(values))
    raise typer.Exit(0 if result.holds and played else FAILED)


def check(
    file: File,
    points: Annotated[
        int, typer.Option(min=1, help="Nodes of the initial guess per mode, and the same number of random states.")
    ] = 3,
    seed: Annotated[int, typer.Option(help="Seed of the random states.")] = 0,
) -> None:
    """Compare every derivative with finite differences, check the initial guess for NaN, print units and sizes."""
    from piaffe.ocp import check_derivatives, check_guess, compile_problem, find_warnings, load_problem, report

    from .reports import print_derivatives, print_dimensions

    console = terminal()
    problem = load_problem(file)
    failures = 0
    with working("compiling the problem") as status:
        compiled = compile_problem(problem, checks=False)
        try:
            check_guess(compiled)
        except PiaffeError as error:
            failures += 1
            console.print(f"[bold red]error:[/] {plain(str(error))}", soft_wrap=True)
        status.update("comparing derivatives with finite differences")
        checks = check_derivatives(compiled, points=points, seed=seed)
        status.update("looking for mistakes")
        warnings = find_warnings(compiled)
    failures += sum(not each.agrees for each in checks)
    print_derivatives(console, checks)
    console.print()
    print_dimensions(console, *report(compiled))
    for warning in warnings:
        console.print(f"[bold yellow]warning:[/] {plain(str(warning))}", highlight=False, soft_wrap=True)
    agreed = sum(each.agrees for each in checks)
    colour = "red" if failures else "green"
    console.print(f"[bold {colour}]{agreed} of {len(checks)} blocks of derivatives agree[/]")
    raise typer.Exit(FAILED if failures else 0)
