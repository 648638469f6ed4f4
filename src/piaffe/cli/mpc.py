"""The command that runs a receding horizon in closed loop."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .arguments import FAILED, File, Json
from .reports import as_json, terminal

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID


def mpc(
    file: File,
    low: Annotated[str, typer.Option(help="Low level: vwbc, riccati, or pd (plan's torques and gains).")] = "vwbc",
    qp: Annotated[
        str | None, typer.Option(help="Quadratic program of vwbc: own (the default), numpy, daqp or osqp.")
    ] = None,
    seconds: Annotated[float, typer.Option(help="Duration of an episode [s].")] = 10.0,
    seed: Annotated[int, typer.Option(min=0, help="The first seed.")] = 0,
    seeds: Annotated[int, typer.Option(min=1, help="Number of seeds, from the first one on.")] = 1,
    perturbation: Annotated[
        float, typer.Option(min=0.0, help="Factor of the perturbations of the first state; 0 for none.")
    ] = 1.0,
    push: Annotated[
        list[str] | None,
        typer.Option(metavar="1.5@2.7:y", help="Push of m/s at a time along an axis; 60N@2.7:x/0.1 for a force."),
    ] = None,
    latency: Annotated[
        float | None, typer.Option(help="Time from a state to the first effect of its plan [s]; by default the file's.")
    ] = None,
    payload: Annotated[float, typer.Option(help="Mass on the base of the plant, not of the problem's model [kg].")] = 0,
    friction: Annotated[
        float | None, typer.Option(help="Friction of the plant; by default 0.6, or that of the plant's file.")
    ] = None,
    command: Annotated[
        list[str] | None,
        typer.Option(metavar="'vx=0.5@0 yaw=0.5@6'", help="Commands to the gait at times [s]: vx, vy, yaw, height."),
    ] = None,
    plant: Annotated[
        Path | None, typer.Option(metavar="FILE.xml", help="MuJoCo model of the same robot as plant.")
    ] = None,
    video: Annotated[
        Path | None, typer.Option(metavar="V.mp4", help="Film the first seed; V.png for a picture of six moments.")
    ] = None,
    size: Annotated[str, typer.Option(metavar="WxH", help="Width and height of the film in pixels.")] = "1280x720",
    plot: Annotated[Path | None, typer.Option(metavar="P.png", help="Draw the first seed over time.")] = None,
    json: Json = False,
) -> None:
    """Run FILE's problem as a receding horizon on a simulated plant. Exit code 1 unless every seed succeeds.

    A module-level `mpc = dict(period=..., iterations=...)` in FILE sets arguments of solvers.RecedingHorizon.
    """
    if video is not None:
        from piaffe.viz import gl, is_sheet, picture_size

        is_sheet(video)
        shape = picture_size(size)
        gl.prepare()  # before MuJoCo is imported
    if plot is not None:
        from piaffe.viz import require_picture

        require_picture(plot)

    from rich.console import Console

    from piaffe.ocp import load_problem_file
    from piaffe.viz import progress_bars

    from .online import OnlineSetup, online_values, print_online

    problem, module = load_problem_file(file, quiet=json)
    setup = OnlineSetup(
        problem, getattr(module, "mpc", {}), file=file, low=low, qp=qp, seconds=seconds, latency=latency,
        payload=payload, friction=friction, pushes=push or (), commands=command or (), plant_file=plant,
        perturbation=perturbation,
    )  # fmt: skip
    with Console(stderr=True).status("compiling for this machine, once") as status:
        setup.build(lambda what: status.update(f"compiling for this machine, once ({what})"))
    chosen = range(seed, seed + seeds)
    episodes = {}
    with progress_bars() as progress:
        overall = progress.add_task("seeds", total=len(chosen))
        for each in chosen:
            inner = progress.add_task(f"seed {each}", total=setup.periods)
            episodes[each] = setup.run(each, _advance(progress, inner, setup.periods))
            progress.remove_task(inner)
            progress.advance(overall)
    values = online_values(setup, episodes)
    saved = []
    if plot is not None:
        from piaffe.viz import plot_online

        saved.append(plot_online(plot, episodes[seed], title=setup.title))
    if video is not None:
        from piaffe.viz import film_online

        saved.append(film_online(video, episodes[seed], size=shape, note=setup.title))
    if json:
        print(as_json(values))
    else:
        print_online(terminal(), setup, values)
        for path in saved:
            print(f"saved {path}")
    raise typer.Exit(0 if values["successes"] == len(chosen) else FAILED)


def _advance(progress: Progress, bar: TaskID, periods: int) -> Callable[[float, float], Any]:
    """Return the function that an episode calls after every period."""
    return lambda done, seconds: progress.update(bar, completed=round(periods * done / seconds))
