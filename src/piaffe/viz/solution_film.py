"""The film of a solution, or of its simulation, in one call."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from . import gl
from .cuts import cuts_of, is_sheet
from .films import sheet, write
from .playback import Playback
from .studio import Studio

if TYPE_CHECKING:
    from piaffe.solvers import Solution

SHEET = (3, 2)  # columns and rows of a picture of single moments


def film(
    solution: Solution,
    path: str | Path,
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
    """Write a film of a solution, or a picture of six moments.

    Args:
        solution: the solution of a problem with a robot.
        path: the file, ``.mp4`` for a film, ``.png`` for a picture.
        speeds: 1 is real time; the motion is shown once at each.
        ghost: also show the targets; in a simulation, the plan.
        simulated: show a simulation of the feedback policy in MuJoCo.
        friction: coefficient of the simulation; by default that of the problem.
        size: width and height [pixels].
        fps: pictures per second.
        azimuth: direction of view about the vertical [degree].
        distance: distance of the camera, in sizes of the robot.

    Returns:
        The path, and a text about the simulation, empty without one.

    Raises:
        ProblemError: a speed or the suffix is unusable.
        ModelError: the solution has no robot.
        DisplayError: there is no OpenGL.
    """
    path, as_picture = Path(path), is_sheet(Path(path))
    gl.prepare()
    playback = Playback(solution)
    cuts, result = cuts_of(playback, speeds, ghost=ghost, simulated=simulated, mu=friction)
    columns, rows = SHEET if as_picture else (1, 1)
    of_each = (size[0] // columns, size[1] // rows)
    studio = Studio(playback.robot, of_each, azimuth=azimuth, distance=distance, spec=playback.scene())
    if as_picture:
        return sheet(path, studio, cuts[0], playback.feet, columns=columns, rows=rows), result
    return write(path, studio, cuts, playback.feet, fps=fps), result
