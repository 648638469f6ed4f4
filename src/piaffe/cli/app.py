"""The commands: arguments in, text out; the work is done elsewhere and imported when it is needed."""

from __future__ import annotations

import os
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from piaffe import __version__
from piaffe.errors import PiaffeError
from piaffe.ocp import load_problem

from .reports import plain, terminal
from .sampling_commands import NamesControllers, mppi, study

FAILED, REFUSED = 1, 2  # exit codes: the result is not what was hoped for; the command could not do what was asked
SHEET = (3, 2)  # columns and rows of a picture of single moments

File = Annotated[
    str, typer.Argument(metavar="FILE[:name]", help="Python file with `problem`, or another name after a colon.")
]
Saved = Annotated[Path, typer.Argument(metavar="R.npz", help="A saved solution.")]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object and nothing else.")]

app = typer.Typer(
    name="piaffe",
    help="Declare a legged motion once; describe, solve, verify, plot and film it.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def main(arguments: list[str] | None = None) -> int:
    """Run a command and return its exit code; errors of Piaffe's own become one line on standard error."""
    given = sys.argv[1:] if arguments is None else arguments
    show = "--traceback" in given or bool(os.environ.get("PIAFFE_TRACEBACK"))
    try:
        code = app([a for a in given if a != "--traceback"], prog_name="piaffe", standalone_mode=True)
    except SystemExit as end:
        return int(end.code or 0) if isinstance(end.code, int | None) else FAILED
    except (PiaffeError, OSError) as error:
        if show:
            raise
        terminal(stderr=True).print(f"[bold red]error:[/] {plain(str(error))}", soft_wrap=True)
        return REFUSED
    return int(code or 0)


def _version(wanted: bool) -> None:
    if wanted:
        print(f"piaffe {__version__}")
        raise typer.Exit


@app.callback()
def options(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and exit.")
    ] = False,
    traceback: Annotated[bool, typer.Option("--traceback", help="Show where an error came from.")] = False,
) -> None:
    """Declare a legged motion once; describe, solve, verify, plot and film it."""


@app.command()
def describe(file: File) -> None:
    """Print the compiled phases, what bound where, what did not and why, and warnings."""
    from piaffe.ocp import compile_problem
    from piaffe.ocp import describe as text

    print(text(compile_problem(load_problem(file))))


@app.command()
def solve(
    file: File,
    save: Annotated[Path | None, typer.Option(metavar="R.npz", help="Save the solution, converged or not.")] = None,
    json: Json = False,
    max_iterations: Annotated[int | None, typer.Option(min=1, help="Stop after so many iterations.")] = None,
    time_limit: Annotated[float | None, typer.Option(help="Stop after so many seconds.")] = None,
    warm_start: Annotated[Path | None, typer.Option(metavar="R.npz", help="Begin from a saved solution.")] = None,
    backend: Annotated[str, typer.Option(help="native (compiled C) or numpy (the readable reference).")] = "native",
) -> None:
    """Solve a problem, with a live table of iterations. Exit code 1 if it does not converge."""
    from piaffe.solvers import Options, Solution
    from piaffe.viz import LiveTable

    from .building import start_solver
    from .reports import as_json, print_solution, solution_values

    problem = load_problem(file, quiet=json)
    given: dict[str, Any] = {"max_iterations": max_iterations, "time_limit_s": time_limit}
    settings = replace(Options(), **{key: value for key, value in given.items() if value is not None})
    start = None if warm_start is None else Solution.load(warm_start)
    began = time.perf_counter()
    solver = start_solver(problem, settings, backend)
    if json:
        solution = solver.solve(start)
    else:
        with LiveTable(settings) as table:
            solution = solver.solve(start, progress=table)
    wall_s = time.perf_counter() - began
    saved = None if save is None else solution.save(save)
    if json:
        print(as_json(solution_values(solution, wall_s)))
    else:
        print_solution(terminal(), solution, wall_s)
        if saved is not None:
            print(f"saved {saved}")
    raise typer.Exit(0 if solution.converged else FAILED)


@app.command()
def verify(solution: Saved, file: File, json: Json = False) -> None:
    """Recompute every defect, equality and inequality without the solver. Exit code 1 if some bound is missed."""
    from piaffe.ocp import compile_problem
    from piaffe.ocp import verify as recompute
    from piaffe.solvers import Solution  # to read the file; nothing of the solver is run

    from .reports import as_json, print_verification, verification_values

    trajectory = Solution.load(solution).trajectory
    compiled = compile_problem(load_problem(file, quiet=json), checks=False)
    result = recompute(compiled, trajectory)
    values = verification_values(compiled, trajectory, result)
    if json:
        print(as_json(values))
    else:
        print_verification(terminal(), result, values)
    raise typer.Exit(0 if result.holds else FAILED)


@app.command()
def check(
    file: File,
    points: Annotated[
        int, typer.Option(min=1, help="Nodes of the initial guess per mode, and as many random states.")
    ] = 3,
    seed: Annotated[int, typer.Option(help="Seed of the random states.")] = 0,
) -> None:
    """Compare every derivative with finite differences, scan the initial guess for NaN, report units and sizes."""
    from piaffe.ocp import check_derivatives, check_guess, compile_problem, find_warnings, report

    from .reports import print_derivatives, print_dimensions

    console = terminal()
    compiled = compile_problem(load_problem(file), checks=False)
    failures = 0
    try:
        check_guess(compiled)
    except PiaffeError as error:
        failures += 1
        console.print(f"[bold red]error:[/] {plain(str(error))}", soft_wrap=True)
    findings = check_derivatives(compiled, points=points, seed=seed)
    failures += sum(not finding.agrees for finding in findings)
    print_derivatives(console, findings)
    console.print()
    print_dimensions(console, *report(compiled))
    for warning in find_warnings(compiled):
        console.print(
            f"[bold yellow]warning:[/] {plain(warning.where)}: {plain(warning.text)}", highlight=False, soft_wrap=True
        )
    agreed = sum(finding.agrees for finding in findings)
    colour = "red" if failures else "green"
    console.print(f"[bold {colour}]{agreed} of {len(findings)} blocks of derivatives agree[/]")
    raise typer.Exit(FAILED if failures else 0)


@app.command()
def plot(
    solution: Saved,
    output: Annotated[Path, typer.Option("--output", "-o", metavar="P.png", help="Image or PDF to write.")],
    title: Annotated[str, typer.Option(help="What stands above; the robot's name by default.")] = "",
    dpi: Annotated[int, typer.Option(min=30, max=600, help="Pixels per inch.")] = 150,
) -> None:
    """Draw base, joints, torques with limits, forces with friction cones, contacts, defects and convergence."""
    from piaffe.solvers import Solution
    from piaffe.viz import plot as draw

    print(f"saved {draw(Solution.load(solution), output, title=title, dpi=dpi)}")


@app.command()
def video(
    solution: Saved,
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="V.mp4", help="Film to write; V.png for six moments of it.")
    ],
    simulated: Annotated[
        bool, typer.Option("--simulate", help="Play the policy in MuJoCo and film that; say how far it got.")
    ] = False,
    ghost: Annotated[
        bool, typer.Option("--ghost", help="Show the keyframes' path (with --simulate the plan) as a ghost.")
    ] = False,
    speed: Annotated[
        list[float] | None, typer.Option(help="1 is real time; give several to show the motion again, e.g. 1 and 0.25.")
    ] = None,
    size: Annotated[str, typer.Option(metavar="WxH", help="Width and height in pixels.")] = "1280x720",
    fps: Annotated[int, typer.Option(min=1, max=240, help="Pictures per second.")] = 50,
    azimuth: Annotated[float, typer.Option(help="Direction of view about the vertical [degree].")] = 60.0,
    distance: Annotated[float, typer.Option(help="Distance of the camera, in sizes of the robot.")] = 1.85,
    friction: Annotated[
        float | None, typer.Option(help="Friction coefficient to simulate with; that of the problem by default.")
    ] = None,
) -> None:
    """Film a solution, rendered off screen by MuJoCo: the planned motion, or the policy played in simulation."""
    from piaffe.viz import cuts_of, gl, is_sheet, picture_size

    shape = picture_size(size)
    pictures_only = is_sheet(output)
    gl.prepare()  # before MuJoCo is imported

    from piaffe.solvers import Solution
    from piaffe.viz import Playback, Studio, sheet, write

    playback = Playback(Solution.load(solution))
    cuts, said = cuts_of(playback, speed or [1.0], ghost=ghost, simulated=simulated, mu=friction)
    if said:
        print(said)
    columns, rows = SHEET if pictures_only else (1, 1)
    studio = Studio(playback.robot, (shape[0] // columns, shape[1] // rows), azimuth=azimuth, distance=distance)
    if pictures_only:
        print(f"saved {sheet(output, studio, cuts[0], playback.feet, columns=columns, rows=rows)}")
    else:
        print(f"saved {write(output, studio, cuts, playback.feet, fps=fps)}")


@app.command()
def view(
    solution: Saved,
    simulated: Annotated[bool, typer.Option("--simulate", help="Play the policy in MuJoCo and show that.")] = False,
    speed: Annotated[float, typer.Option(help="1 is real time.")] = 1.0,
) -> None:
    """Show a solution in MuJoCo's interactive viewer, over and over until its window is closed."""
    from piaffe.viz import show

    show(solution, simulated=simulated, speed=speed)


@app.command()
def doctor(
    urdf: Annotated[str, typer.Argument(metavar="URDF", help="A URDF file, or the name of a known robot.")],
    feet: Annotated[
        str | None, typer.Option(metavar="'FRAME ...'", help="Frames of the feet, separated by spaces or commas.")
    ] = None,
    foot_radius: Annotated[float | None, typer.Option(help="Radius of the foot's ball [m].")] = None,
) -> None:
    """Say what is wrong or missing in a robot's description. Exit code 1 if it cannot be used."""
    from piaffe.models import diagnose

    names = feet.replace(",", " ").split() if feet else None
    findings = diagnose(urdf, feet=names, foot_radius=foot_radius)
    console = terminal()
    colours = {"error": "bold red", "warning": "bold yellow", "note": "dim"}
    for finding in findings:
        console.print(
            f"[{colours[finding.severity]}]{finding.severity}:[/] {plain(f'{finding.where}: {finding.text}')}",
            soft_wrap=True,
        )
    errors = sum(finding.severity == "error" for finding in findings)
    warnings = sum(finding.severity == "warning" for finding in findings)
    console.print(f"{errors} errors, {warnings} warnings")
    raise typer.Exit(FAILED if errors else 0)


@app.command()
def cache(
    clear: Annotated[bool, typer.Option("--clear", help="Remove all of them.")] = False,
    json: Json = False,
) -> None:
    """Show the compiled solvers that are kept: where, what for, how large and how old; or remove them."""
    from piaffe.codegen import Cache

    from .libraries import cache_values, megabytes, print_cache
    from .reports import as_json

    kept = Cache()
    if clear:
        removed, freed = kept.clear()
        text = f"libraries removed: {removed}, freed: {megabytes(freed)}"
        print(as_json({"removed": removed, "freed": freed}) if json else text)
    elif json:
        print(as_json(cache_values(kept)))
    else:
        print_cache(terminal(), cache_values(kept))


app.command(cls=NamesControllers)(mppi)
app.command()(study)
