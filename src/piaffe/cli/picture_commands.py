"""The commands that show a solution: plot, video, view."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from piaffe.errors import ProblemError

from .arguments import Saved
from .reports import plain, terminal, working

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from piaffe.models import Robot


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
    azimuth: Annotated[float, typer.Option(help="Direction of view about the vertical \\[degree].")] = 60.0,
    distance: Annotated[float, typer.Option(help="Distance of the camera, in sizes of the robot.")] = 1.85,
    friction: Annotated[
        float | None, typer.Option(help="Friction coefficient of the simulation; by default that of the problem.")
    ] = None,
) -> None:
    """Film a solution, rendered off screen by MuJoCo: the planned motion, or a simulation of the policy."""
    from piaffe.viz import film, gl, is_sheet, picture_size

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


def pose(
    robot: Annotated[str, typer.Argument(metavar="ROBOT", help="A robot's name, or a URDF file.")],
    output: Annotated[Path, typer.Option("--output", "-o", metavar="P.png", help="Picture to write.")],
    joints: Annotated[
        str, typer.Option(help="A pose's name, or angles by label: 'HAA=0.1 FL_KFE=-1.2' \\[rad]; the others stand.")
    ] = "stand",
    rpy: Annotated[str, typer.Option(help="Roll, pitch and yaw of the base \\[rad], separated by commas.")] = "0,0,0",
    feet: Annotated[str | None, typer.Option(help="Frames of the feet of a URDF, separated by commas.")] = None,
    size: Annotated[str, typer.Option(metavar="WxH", help="Width and height in pixels.")] = "960x720",
    azimuth: Annotated[float, typer.Option(help="Direction of view about the vertical \\[degree].")] = 60.0,
) -> None:
    """Draw a robot in a pose, with its lowest foot on the ground, and print where its base and feet are."""
    from piaffe.viz import gl, is_sheet, picture_size

    shape = picture_size(size)
    if not is_sheet(output):
        raise ProblemError(f"pose: '{output}' is a film - got '.mp4', expected a picture; change the ending to '.png'")
    gl.prepare()  # before MuJoCo is imported

    from piaffe import models
    from piaffe.files import check_destination
    from piaffe.viz import picture, save_picture

    check_destination(output)
    loaded = models.load(robot) if feet is None else models.load(robot, feet=feet.split(","))
    angles: object = _angles(joints) if "=" in joints else joints
    turned = _numbers(rpy, "--rpy", 3)
    _warn_of_limits(loaded, loaded.pose(angles))
    if loaded.base == "free":
        state = models.WholeBody(loaded).state(joints=angles, rpy=turned)
        print(f"base {state[2]:.4f} m above the ground")
        for name, place in loaded.forward_kinematics(angles, state[:3], turned).items():
            print(f"foot {name} at ({', '.join(f'{each + 0.0:.4f}' for each in place.round(4))}) m")
    else:
        state = loaded.pose(angles)
    print(f"saved {save_picture(picture(loaded, state, size=shape, azimuth=azimuth), output)}")


def _warn_of_limits(robot: Robot, angles: NDArray[np.float64]) -> None:
    """Print the joints that are beyond their limits on standard error."""
    for name, angle, lower, upper in zip(robot.joint_names, angles, robot.joint_lower, robot.joint_upper, strict=True):
        if not lower - 1e-6 <= angle <= upper + 1e-6:
            terminal(stderr=True).print(
                f"[yellow]warning:[/] pose: joint beyond its limit - got {plain(name)} at {angle:.3f} rad, expected "
                f"{lower:.3f} to {upper:.3f} rad; change the angle",
                soft_wrap=True,
            )


def _angles(text: str) -> dict[str, float]:
    """Return the angles of ``"HAA=0.1 FL_KFE=-1.2"`` by label."""
    pairs = [entry.partition("=") for entry in text.replace(",", " ").split()]
    return {label: _numbers(value, f"--joints {label}", 1)[0] for label, _, value in pairs}


def _numbers(text: str, what: str, count: int) -> list[float]:
    try:
        found = [float(each) for each in text.split(",")]
    except ValueError:
        found = []
    if len(found) != count:
        raise ProblemError(f"{what}: is unusable - got '{text}', expected {count} numbers; separate them by commas")
    return found


def view(
    solution: Saved,
    simulated: Annotated[bool, typer.Option("--simulate", help="Simulate the policy in MuJoCo and show it.")] = False,
    speed: Annotated[float, typer.Option(help="1 is real time.")] = 1.0,
) -> None:
    """Show a solution in MuJoCo's interactive viewer; the motion repeats until the window is closed."""
    from piaffe.viz import show

    show(solution, simulated=simulated, speed=speed)
