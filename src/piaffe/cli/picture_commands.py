"""The commands that show a solution: plot, video, view."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .arguments import Saved
from .reports import working

if TYPE_CHECKING:
    from piaffe.solvers import Solution

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
    with working("drawing"):
        saved = draw(Solution.load(solution), output, title=title, dpi=dpi)
    print(f"saved {saved}")


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
    from piaffe.viz import gl, is_sheet, picture_size

    shape = picture_size(size)
    is_sheet(output)
    gl.prepare()  # before MuJoCo is imported

    from piaffe.files import check_destination
    from piaffe.solvers import Solution

    check_destination(output)
    made, result = film(
        Solution.load(solution), output, speeds=speed or [1.0], ghost=ghost, simulated=simulated, friction=friction,
        size=shape, fps=fps, azimuth=azimuth, distance=distance,
    )  # fmt: skip
    if result:
        print(result)
    print(f"saved {made}")


def film(
    solution: Solution,
    output: Path,
    *,
    speeds: Sequence[float] = (1.0,),
    ghost: bool = False,
    simulated: bool = False,
    friction: float | None = None,
    size: tuple[int, int] = (1280, 720),
    fps: int = 50,
    azimuth: float = 60.0,
    distance: float = 1.85,
) -> tuple[Path, str]:
    """Write a film, or a picture of six moments; return its path, and a text about the simulation.

    The backend of OpenGL has been chosen.
    """
    from piaffe.viz import Playback, Studio, cuts_of, is_sheet, sheet, write

    with working("simulating" if simulated else "reading"):
        playback = Playback(solution)
        cuts, result = cuts_of(playback, speeds, ghost=ghost, simulated=simulated, mu=friction)
    columns, rows = SHEET if is_sheet(output) else (1, 1)
    studio = Studio(playback.robot, (size[0] // columns, size[1] // rows), azimuth=azimuth, distance=distance)
    if is_sheet(output):
        return sheet(output, studio, cuts[0], playback.feet, columns=columns, rows=rows), result
    return write(output, studio, cuts, playback.feet, fps=fps), result


def view(
    solution: Saved,
    simulated: Annotated[bool, typer.Option("--simulate", help="Simulate the policy in MuJoCo and show it.")] = False,
    speed: Annotated[float, typer.Option(help="1 is real time.")] = 1.0,
) -> None:
    """Show a solution in MuJoCo's interactive viewer; the motion repeats until the window is closed."""
    from piaffe.viz import show

    show(solution, simulated=simulated, speed=speed)
