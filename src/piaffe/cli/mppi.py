"""The command that runs a sampling controller in closed loop."""

from __future__ import annotations

import ast
import sys
from collections.abc import Callable
from contextlib import nullcontext, redirect_stdout
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperCommand, TyperOption

from piaffe.errors import SamplingError

from .arguments import FAILED
from .reports import as_json, terminal, working

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID

CONTROLLER = "Name of the controller: {known}, or one of FILE's `controllers`."

SampledFile = Annotated[
    str,
    typer.Argument(
        metavar="FILE[:name]", help="Python file with `sampled_problem` or `problem`, or another name after a colon."
    ),
]


class NamesControllers(TyperCommand):
    """A command whose help lists the controllers; only the help imports them."""

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Write the help."""
        from piaffe.sampling import CONTROLLERS

        for option in self.params:
            if isinstance(option, TyperOption) and option.help == CONTROLLER:
                option.help = CONTROLLER.format(known=", ".join(CONTROLLERS))
        super().format_help(ctx, formatter)


def mppi(
    file: SampledFile,
    controller: Annotated[str, typer.Option(help=CONTROLLER)] = "td-cd",
    value: Annotated[
        str | None,
        typer.Option(metavar="V", help="Value function at the horizon's end; by default the file's; `none` for none."),
    ] = None,
    allow: Annotated[
        str,
        typer.Option(metavar="'NAME ...'", help="Properties in which the problem may differ from that of the value."),
    ] = "",
    steps: Annotated[int, typer.Option(min=1, help="Control steps per episode.")] = 400,
    seeds: Annotated[int, typer.Option(min=1, help="Number of seeds; they are 0, 1, ....")] = 1,
    seed: Annotated[int | None, typer.Option(min=0, help="Run only this seed.")] = None,
    horizon: Annotated[int | None, typer.Option(min=2, help="Steps H of the horizon; by default as declared.")] = None,
    samples: Annotated[int | None, typer.Option(min=1, help="Perturbed roll-outs per stage.")] = None,
    temperature: Annotated[float | None, typer.Option(help="λ of the weights.")] = None,
    setting: Annotated[
        list[str] | None,
        typer.Option(
            "--set", metavar="NAME=VALUE", help="Any other option of the controller, or argument of FILE's function."
        ),
    ] = None,
    threads: Annotated[int | None, typer.Option(min=1, help="Threads of roll-outs; by default one per core.")] = None,
    payload: Annotated[
        float, typer.Option(help="Mass on the base of the plant, not of the controller's model \\[kg].")
    ] = 0.0,
    friction: Annotated[
        float | None, typer.Option(help="Friction of the plant; by default that of the controller's model.")
    ] = None,
    latency: Annotated[float, typer.Option(help="Time from a state to the first effect of its plan \\[s].")] = 0.0,
    plant_timestep: Annotated[float, typer.Option(help="Step of the plant's simulator \\[s].")] = 0.002,
    spread: Annotated[
        bool, typer.Option("--spread/--no-spread", help="Random initial states, different for each seed.")
    ] = True,
    json: Annotated[bool, typer.Option("--json", help="Print one JSON object and nothing else.")] = False,
    video: Annotated[
        Path | None, typer.Option(metavar="V.mp4", help="Film the first seed; V.png for a picture of six moments.")
    ] = None,
    size: Annotated[str, typer.Option(metavar="WxH", help="Width and height of the film in pixels.")] = "1280x720",
    plot: Annotated[Path | None, typer.Option(metavar="P.png", help="Draw all seeds over time.")] = None,
    save: Annotated[Path | None, typer.Option(metavar="R.npz", help="Save the episodes.")] = None,
) -> None:
    """Run a sampling controller in closed loop on a simulated plant. Exit code 1 unless every seed succeeds."""
    if video is not None:
        from piaffe.viz import gl, is_sheet, picture_size

        is_sheet(video)
        shape = picture_size(size)
        gl.prepare()  # before MuJoCo is imported
    if plot is not None:
        from piaffe.viz import require_picture

        require_picture(plot)

    from piaffe.files import check_destination

    for path in (video, plot, save):
        if path is not None:
            check_destination(path)

    from piaffe.sampling import complete, load_declared, prepare, save_episodes
    from piaffe.viz import progress_bars

    from .episodes import episode_values, print_episodes

    settings: dict[str, Any] = {
        "controller": controller, "value": value, "allow": allow, "steps": steps, "horizon": horizon,
        "payload": payload, "friction": friction, "latency": latency, "plant_timestep": plant_timestep,
        "spread": spread,
    }  # fmt: skip
    settings |= {k: v for k, v in {"samples": samples, "temperature": temperature}.items() if v is not None}
    more = dict(pair(text) for text in setting or [])
    for name in more:
        if name in settings and name in ("samples", "temperature", "horizon", "value") and settings[name] is not None:
            raise SamplingError(
                f"command line: '{name}' is given twice - got --{name} {settings[name]} and --set {name}={more[name]}, "
                "expected one of them; remove one"
            )
    settings |= more
    with redirect_stdout(sys.stderr) if json else nullcontext():
        declared = load_declared(file)
        with working("compiling for this machine, once"):
            trial = prepare(declared, complete(declared, settings, "command line"), threads)
    chosen = range(seeds) if seed is None else [seed]
    episodes = {}
    try:
        with progress_bars() as progress:
            overall = progress.add_task("seeds", total=len(chosen))
            for each in chosen:
                inner = progress.add_task(f"seed {each}", total=steps)
                episodes[each] = trial.run(each, _advance(progress, inner))
                progress.remove_task(inner)
                progress.advance(overall)
    finally:
        trial.close()
    values = episode_values(trial, episodes)
    saved = []
    if save is not None:
        about = {key: values[key] for key in ("controller", "problem", "plant", "settings")}
        saved.append(save_episodes(save, {f"seed {each}": episode for each, episode in episodes.items()}, about))
    if plot is not None:
        from piaffe.viz import plot_episodes

        saved.append(plot_episodes(plot, trial, episodes))
    if video is not None:
        from piaffe.viz import film_episode

        saved.append(film_episode(video, trial.plant, episodes[chosen[0]], size=shape, note=trial.controller.title))
    if json:
        print(as_json(values))
    else:
        print_episodes(terminal(), trial, values)
        for path in saved:
            print(f"saved {path}")
    raise typer.Exit(0 if values["successes"] == len(chosen) else FAILED)


def _advance(progress: Progress, bar: TaskID) -> Callable[[int, int], None]:
    """Return the function that an episode calls after every step."""
    return lambda done, steps: progress.update(bar, completed=done)


def pair(text: str) -> tuple[str, Any]:
    """Return name and value of ``NAME=VALUE``; a value that is not a Python literal is text."""
    name, equal, value = text.partition("=")
    if not equal or not name.isidentifier():
        raise SamplingError(f"--set: is no setting - got '{text}', expected NAME=VALUE; write --set terrain=stairs")
    try:
        return name, ast.literal_eval(value)
    except (ValueError, SyntaxError):
        return name, value
