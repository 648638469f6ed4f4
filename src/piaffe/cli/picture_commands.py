"""The commands that show a solution: plot, video, view."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .arguments import Saved

SHEET = (3, 2)  # columns and rows of a picture of single moments


def plot(
    solution: Saved,
    output: Annotated[Path, typer.Option("--output", "-o", metavar="P.png", help="Image or PDF to write.")],
    title: Annotated[str, typer.Option(help="Title of the figure; by default the name of the robot.")] = "",
    dpi: Annotated[int, typer.Option(min=30, max=600, help="Pixels per inch.")] = 150,
) -> None:
    """Draw base, joints, torques with limits, forces with friction cones, contacts, defects and convergence."""
    from piaffe.files import check_destination
    from piaffe.solvers import Solution
    from piaffe.viz import plot as draw
    from piaffe.viz import require_picture

    require_picture(output)
    check_destination(output)
    print(f"saved {draw(Solution.load(solution), output, title=title, dpi=dpi)}")


def video(
    solution: Saved,
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="V.mp4", help="Film to write; V.png for a picture of six moments.")
    ],
    simulated: Annotated[
        bool,
        typer.Option("--simulate", help="Simulate the policy in MuJoCo and film it; print its errors."),
    ] = False,
    ghost: Annotated[
        bool,
        typer.Option("--ghost", help="Also show the path of the keyframes (with --simulate: the plan), transparent."),
    ] = False,
    speed: Annotated[
        list[float] | None, typer.Option(help="1 is real time; repeat the option to show the motion several times.")
    ] = None,
    size: Annotated[str, typer.Option(metavar="WxH", help="Width and height in pixels.")] = "1280x720",
    fps: Annotated[int, typer.Option(min=1, max=240, help="Frames per second.")] = 50,
    azimuth: Annotated[float, typer.Option(help="Direction of view about the vertical [degree].")] = 60.0,
    distance: Annotated[float, typer.Option(help="Distance of the camera, in sizes of the robot.")] = 1.85,
    friction: Annotated[
        float | None, typer.Option(help="Friction coefficient of the simulation; by default that of the problem.")
    ] = None,
) -> None:
    """Film a solution, rendered off screen by MuJoCo: the planned motion, or a simulation of the policy."""
    from piaffe.viz import cuts_of, gl, is_sheet, picture_size

    shape = picture_size(size)
    pictures_only = is_sheet(output)
    gl.prepare()  # before MuJoCo is imported

    from piaffe.files import check_destination
    from piaffe.solvers import Solution
    from piaffe.viz import Playback, Studio, sheet, write

    check_destination(output)
    playback = Playback(Solution.load(solution))
    cuts, result = cuts_of(playback, speed or [1.0], ghost=ghost, simulated=simulated, mu=friction)
    if result:
        print(result)
    columns, rows = SHEET if pictures_only else (1, 1)
    studio = Studio(
        playback.robot, (shape[0] // columns, shape[1] // rows), azimuth=azimuth, distance=distance,
        spec=playback.scene(),
    )  # fmt: skip
    if pictures_only:
        print(f"saved {sheet(output, studio, cuts[0], playback.feet, columns=columns, rows=rows)}")
    else:
        print(f"saved {write(output, studio, cuts, playback.feet, fps=fps)}")


def view(
    solution: Saved,
    simulated: Annotated[bool, typer.Option("--simulate", help="Simulate the policy in MuJoCo and show it.")] = False,
    speed: Annotated[float, typer.Option(help="1 is real time.")] = 1.0,
) -> None:
    """Show a solution in MuJoCo's interactive viewer; the motion repeats until the window is closed."""
    from piaffe.viz import show

    show(solution, simulated=simulated, speed=speed)
