"""The command that exports a receding horizon and its low level as C."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .arguments import FAILED, File, Json
from .reports import as_json, terminal


def export(
    file: File,
    output: Annotated[Path, typer.Option("--output", "-o", metavar="DIR", help="Folder of the C project.")],
    name: Annotated[
        str | None, typer.Option(help="Name of the controller, prefix of all names in C; by default FILE's.")
    ] = None,
    gains: Annotated[
        str | None, typer.Option(metavar="KP:KD", help="Gains of the joints, added to the torques (3:0.5).")
    ] = None,
    latency: Annotated[float | None, typer.Option(help="From a state to the first effect of its plan \\[s].")] = None,
    max_age: Annotated[
        float | None, typer.Option(help="A plan acts until its state is this old \\[s]; then the joints are damped.")
    ] = None,
    seconds: Annotated[float, typer.Option(help="Duration of the closed loop that `make check` replays \\[s].")] = 5.0,
    seed: Annotated[int, typer.Option(min=0, help="Seed of this closed loop.")] = 0,
    spread: Annotated[
        bool, typer.Option("--spread/--no-spread", help="Draw its plant, first state and noise, as piaffe mpc does.")
    ] = True,
    command: Annotated[
        list[str] | None, typer.Option(metavar="'vx=0.5@0'", help="Commands in this closed loop, as for piaffe mpc.")
    ] = None,
    check: Annotated[
        bool, typer.Option("--check", help="Build here, run make check and make loop, and write what they find to DIR.")
    ] = False,
    json: Json = False,
) -> None:
    """Write FILE's receding horizon and low level as a C library that needs neither Python nor Piaffe.

    A module-level `mpc = dict(period=..., iterations=...)` in FILE sets arguments of solvers.RecedingHorizon. FILE may
    also have several problems by name, a dict, between which a command of the controller changes.
    `make -C DIR check` builds the library and replays a closed loop that was recorded here; `--check` does it at once.
    """
    from rich.console import Console

    from piaffe.files import check_destination, write_whole
    from piaffe.solvers import export_controller

    from .online import OnlineSetup
    from .online_settings import OnlineSettings

    settings = OnlineSettings(
        gains=gains, seconds=seconds, latency=latency, command=" ".join(command or ()), spread=spread
    )  # fmt: skip
    check_destination(output / "check.bin")
    setup = OnlineSetup.of_file(file, settings, quiet=json)
    with Console(stderr=True).status("compiling for this machine, once") as status:
        setup.build(lambda what: status.update(f"compiling for this machine, once ({what})"))
        status.update("writing C")
        exported = export_controller(
            setup.declared, output, name=name or _name_of(file), options={**setup.options, "latency": setup.latency},
            low=setup.low_level, max_age=max_age,
        )  # fmt: skip
        status.update("recording a closed loop")
        recorder = exported.recorder()
        episode = setup.episode(recorder, recorder, seed)
        write_whole(output / "check.bin", recorder.file())
        measured = None
        if check:
            status.update("building and checking")
            measured = exported.check()
    if episode.fault:
        terminal().print(f"the recorded closed loop ends after {episode.end:g} s: {episode.fault}")
    if json:
        told = {"folder": str(output), "name": exported.name, "plans": recorder.plans, "ticks": recorder.ticks}
        print(as_json(told | ({} if measured is None else {"check": measured.told()})))
    else:
        terminal().print(
            f"saved {output}: '{exported.name}', {recorder.plans} plans and {recorder.ticks} ticks"
            + (f" to check; now: make -C {output} check" if measured is None else f"; {measured.words()}"),
            soft_wrap=True,
        )
    raise typer.Exit(FAILED if episode.fault else 0)


def _name_of(file: str) -> str:
    """Return the name of a file, or of the problem in it, as an identifier in small letters."""
    path, _, problem = file.partition(":")
    return f"{Path(path).stem}_{problem}".strip("_").lower() if problem else Path(path).stem.lower()
