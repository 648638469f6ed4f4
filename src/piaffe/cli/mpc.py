"""The command that runs a receding horizon in closed loop."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .arguments import FAILED, File, Json
from .reports import as_json, terminal

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID

    from piaffe.simulation import OnlineEpisode

    from .online import OnlineSetup
    from .online_task import OnlineTask


def mpc(
    file: File,
    low: Annotated[str, typer.Option(help="Low level: vwbc, riccati, or pd (plan's torques and gains).")] = "vwbc",
    qp: Annotated[
        str | None, typer.Option(help="Quadratic program of vwbc: own (the default), numpy, daqp or osqp.")
    ] = None,
    gains: Annotated[
        str | None,
        typer.Option(metavar="KP:KD", help="Gains of the joints, added to vwbc and riccati, or those of pd (20:0.5)."),
    ] = None,
    seconds: Annotated[float, typer.Option(help="Duration of an episode \\[s].")] = 10.0,
    seed: Annotated[int, typer.Option(min=0, help="The first seed.")] = 0,
    seeds: Annotated[int, typer.Option(min=1, help="Number of seeds, from the first one on.")] = 1,
    workers: Annotated[
        int | None, typer.Option(min=1, help="Episodes at a time, in processes; by default one per core.")
    ] = None,
    spread: Annotated[
        bool,
        typer.Option("--spread/--no-spread", help="Draw masses, friction, first state and noise, other for each seed."),
    ] = True,
    mass_spread: Annotated[
        float | None, typer.Option(help="Largest relative change of masses, by default 0.05; 0 for none.")
    ] = None,
    friction: Annotated[
        str | None,
        typer.Option(
            metavar="MU|LOW:HIGH",
            help="Friction of the plant, or the range in which it is drawn, by default 0.5:0.8; if nothing is drawn, "
            "that of the problem's friction cone, or of the plant's file.",
        ),
    ] = None,
    perturbation: Annotated[
        float | None, typer.Option(help="Factor of the perturbations of the first state, by default 1; 0 for none.")
    ] = None,
    noise: Annotated[
        float | None, typer.Option(help="Factor of the noise of sensors, by default 1; 0 for none.")
    ] = None,
    push: Annotated[
        list[str] | None,
        typer.Option(metavar="1.5@2.7:y", help="Push of m/s at a time along an axis; 60N@2.7:x/0.1 for a force."),
    ] = None,
    latency: Annotated[
        float | None,
        typer.Option(help="Time from a state to the first effect of its plan \\[s]; by default the file's."),
    ] = None,
    payload: Annotated[
        float, typer.Option(help="Mass on the base of the plant, not of the problem's model \\[kg].")
    ] = 0,
    command: Annotated[
        list[str] | None,
        typer.Option(
            metavar="'vx=0.5@0 yaw=0.5@6'",
            help="Commands to the gait at times \\[s]: vx, vy, yaw, height; motion=NAME.",
        ),
    ] = None,
    settle: Annotated[
        float, typer.Option(help="Time after each change of the command that does not count for its speed \\[s].")
    ] = 2.0,
    speed_bound: Annotated[float, typer.Option(help="Largest relative error of the speed of a success.")] = 0.05,
    plant: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.xml", help="MuJoCo model of the same robot as plant, with masses and friction of its own."
        ),
    ] = None,
    names: Annotated[
        Path | None,
        typer.Option(metavar="N.toml", help="Names in FILE.xml: tables \\[joints] and \\[feet], ours = theirs."),
    ] = None,
    joint: Annotated[
        list[str] | None, typer.Option(metavar="OURS=THEIRS", help="A joint's name in FILE.xml; may be repeated.")
    ] = None,
    foot: Annotated[
        list[str] | None,
        typer.Option(metavar="OURS=THEIRS", help="A foot's geom, site or body in FILE.xml; may be repeated."),
    ] = None,
    video: Annotated[
        Path | None, typer.Option(metavar="V.mp4", help="Film the first seed; V.png for a picture of six moments.")
    ] = None,
    size: Annotated[str, typer.Option(metavar="WxH", help="Width and height of the film in pixels.")] = "1280x720",
    plot: Annotated[
        Path | None, typer.Option(metavar="P.png", help="Draw a seed over time; of several seeds, P-seed-N.png each.")
    ] = None,
    json: Json = False,
) -> None:
    """Run FILE's problem as a receding horizon on a simulated plant. Exit code 1 unless every seed succeeds.

    A success has no fall, an upright base at its end, and the commanded speed. A module-level
    `mpc = dict(period=..., iterations=...)` in FILE sets arguments of solvers.RecedingHorizon, and
    `fall = models.Fall(...)` says what a fall is. FILE may have several problems by name, a dict: --command
    'motion=NAME@3' asks for another one.
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

    from piaffe.codegen import available_cores
    from piaffe.files import check_destination

    from .online import OnlineSetup
    from .online_names import names_of
    from .online_output import online_row, online_values, print_online
    from .online_settings import OnlineSettings, friction_of
    from .online_task import OnlineTask

    for path in (video, plot):
        if path is not None:
            check_destination(path)
    settings = OnlineSettings(
        low=low, qp=qp, gains=gains, seconds=seconds, latency=latency, push=" ".join(push or ()),
        command=" ".join(command or ()), payload=payload, plant=None if plant is None else str(plant),
        **names_of(names, joint or (), foot or ()), spread=spread, mass_spread=mass_spread,
        friction=None if friction is None else friction_of(friction), perturbation=perturbation, noise=noise,
        settle=settle, speed_bound=speed_bound,
    )  # fmt: skip
    setup = OnlineSetup.of_file(file, settings, quiet=json)
    with Console(stderr=True).status("compiling for this machine, once") as status:
        setup.build(lambda what: status.update(f"compiling for this machine, once ({what})"))
    chosen = range(seed, seed + seeds)
    rows: list[dict[str, Any]] = []
    saved: list[Path] = []
    first: OnlineEpisode | None = None
    for each, episode in _episodes(setup, OnlineTask(file, settings), chosen, workers or available_cores()):
        rows.append(online_row(each, episode, settings))
        first = episode if each == seed else first
        if plot is not None:
            from piaffe.viz import plot_online

            path = plot if seeds == 1 else plot.with_stem(f"{plot.stem}-seed-{each}")
            saved.append(
                plot_online(path, episode, title=f"{setup.title}, seed {each}", result=_result(rows[-1]), settle=settle)
            )
    values = online_values(setup, sorted(rows, key=lambda row: int(row["seed"])))
    if video is not None and first is not None:
        from piaffe.viz import film_online

        saved.append(film_online(video, first, setup.plant(seed), size=shape, note=setup.title))
    if json:
        print(as_json(values))
    else:
        print_online(terminal(), setup, values)
        for path in sorted(saved):
            print(f"saved {path}")
    raise typer.Exit(0 if values["successes"] == len(chosen) else FAILED)


def _episodes(
    setup: OnlineSetup, task: OnlineTask, seeds: Sequence[int], workers: int
) -> Iterator[tuple[int, OnlineEpisode]]:
    """Yield seeds and their episodes, with bars of progress."""
    from piaffe.viz import progress_bars

    from .online_task import episodes_in_processes

    count = min(workers, len(seeds))
    with progress_bars() as progress:
        overall = progress.add_task("seeds", total=len(seeds))
        if count > 1:
            for made in episodes_in_processes(task, seeds, count):
                progress.advance(overall)
                yield made
            return
        for each in seeds:
            inner = progress.add_task(f"seed {each}", total=setup.periods)
            episode = setup.run(each, _advance(progress, inner, setup.periods))
            progress.remove_task(inner)
            progress.advance(overall)
            yield each, episode


def _advance(progress: Progress, bar: TaskID, periods: int) -> Callable[[float, float], Any]:
    """Return the function that an episode calls after every period."""
    return lambda done, seconds: progress.update(bar, completed=round(periods * done / seconds))


def _result(row: dict[str, Any]) -> str:
    """Return in words how an episode ended; empty for a success."""
    if row["fell"]:
        return str(row["fault"])
    if not row["upright"]:
        return "not upright at the end"
    return f"upright, speed off by {100 * row['speed_error']:.1f} %" if row["followed"] is False else ""
