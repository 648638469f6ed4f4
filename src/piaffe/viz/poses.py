"""Pictures of poses: a robot before a solve, several moments of a solution in one image, and its keyframes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import Image, ImageDraw, ImageFont

from piaffe.errors import ProblemError, ShapeError
from piaffe.files import whole_file
from piaffe.models import Robot, base, heights_off_ground, joints, mujoco_spec
from piaffe.models.terrain import Terrain
from piaffe.ocp import rotation

from . import gl
from .caption import FONT
from .films import follow
from .playback import Playback, Snapshot
from .studio import Studio
from .style import INK

if TYPE_CHECKING:
    from piaffe.ocp import Problem
    from piaffe.solvers import Solution

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]

_GAP = 4  # [pixels] between pictures
_MARK = (0.85, 0.15, 0.1, 0.9)  # of a foot that should be on the ground


def picture(
    robot: Robot,
    state: ArrayLike | str = "stand",
    *,
    terrain: Terrain | None = None,
    marked: Sequence[str] = (),
    size: tuple[int, int] = (640, 480),
    azimuth: float = 60.0,
    distance: float = 1.85,
) -> Picture:
    """Return a picture of a robot in a pose, (height, width, 3).

    Args:
        robot: the robot.
        state: a state of a model of it, (nx,), with or without velocities; or the name of a pose, on level ground.
        terrain: the ground; level by default.
        marked: names of feet that get a red mark.
        size: width and height [pixels].
        azimuth: direction of view about the vertical [degree].
        distance: distance of the camera, in sizes of the robot.

    Raises:
        ShapeError: the state has another size.
        DisplayError: there is no OpenGL.
    """
    gl.prepare()
    qpos = _qpos(robot, state)
    spec = mujoco_spec(robot, contacts="none", terrain=terrain)
    with Studio(robot, size, azimuth=azimuth, distance=distance, spec=spec) as studio:
        shown = Snapshot(0.0, qpos, np.zeros((len(robot.feet), 3)), "", (False,) * len(robot.feet))
        middle = studio.fixed if studio.fixed is not None else qpos[:3]
        drawn = studio.picture(shown, np.asarray(middle), marked=dict.fromkeys(marked, _MARK))
    return np.asarray(Image.fromarray(drawn).resize(size, Image.Resampling.LANCZOS))


def strip(
    solution: Solution, times: Sequence[float] | int = 6, *, size: tuple[int, int] = (320, 240), azimuth: float = 60.0
) -> Picture:
    """Return one image of a solution's poses side by side, (height, n width, 3).

    Args:
        solution: the solution of a problem with a robot.
        times: the times [s], or the number of equally spaced ones.
        size: width and height of each picture [pixels].
        azimuth: direction of view about the vertical [degree].

    Raises:
        ProblemError: there are no times.
        ModelError: the solution has no robot.
        DisplayError: there is no OpenGL.
    """
    gl.prepare()
    playback = Playback(solution)
    chosen = np.linspace(playback.start, playback.end, times) if isinstance(times, int) else np.asarray(times, float)
    if chosen.size == 0:
        raise ProblemError("strip: there are no times - got none, expected at least one [s]; give some")
    with Studio(playback.robot, size, azimuth=azimuth, spec=playback.scene()) as studio:
        shown = [playback.at(float(t)) for t in chosen]
        looks = follow(shown, 1.0, studio.fixed) if studio.fixed is not None else [s.qpos[:3] for s in shown]
        drawn = [studio.picture(s, np.asarray(look)) for s, look in zip(shown, looks, strict=True)]
    return _side_by_side([_captioned(d, f"{s.time:.2f} s  {s.phase}", size) for d, s in zip(drawn, shown, strict=True)])


def keyframes(problem: Problem, *, size: tuple[int, int] = (320, 240), azimuth: float = 60.0) -> Picture:
    """Return one image of the targets of a problem at its start and at the end of each phase that has a keyframe.

    Feet that stand in the phase, or land at its end, and are more than 2 cm off the ground have a red mark. Below each
    picture are phase, time, and position [m] and roll, pitch, yaw [degree] of the base.

    Raises:
        ProblemError: the problem has no robot, or no keyframe.
        DisplayError: there is no OpenGL.
    """
    from piaffe.ocp import compile_problem

    gl.prepare()
    compiled = compile_problem(problem, checks=False)
    model: Any = compiled.phases[0].mode.model  # of a robot, see below
    robot: Robot | None = getattr(model, "robot", None)
    if robot is None or robot.base == "fixed" or joints.position not in model.state.slices:
        raise ProblemError(
            f"problem ({problem.source}): has no poses to show - got model '{model.name}' first, expected a whole body "
            "with a floating base; describe it without pictures"
        )
    terrain: Terrain = model.state.terrain
    shown: list[tuple[str, Array, list[str]]] = [(f"start  0 s\n{_place(problem.initial)}", problem.initial, [])]
    for phase, following in zip(compiled.phases, (*compiled.phases[1:], None), strict=True):
        placed = compiled.path.interval_before(float(phase.times[-1]))
        if phase.ends_phase and placed.phase.target is not None and phase.mode.model is model:
            stances: list[Any] = [model.resolve(each.interval.phase.mode) for each in (phase, following) if each]
            standing = {name for stance in stances for name in stance.feet}
            x = model.state.pack({**model.state.unpack(problem.initial), **_own(model, compiled.path, placed)})
            values = model.state.unpack(x)
            pose = (values[quantity] for quantity in (base.position, base.orientation, joints.position))
            off = heights_off_ground(robot, terrain, [name for name in robot.foot_names if name in standing], *pose)
            place = _place(x, placed.phase.target.values.get("rpy"))
            shown.append((f"{placed.phase.name}  {float(phase.times[-1]):g} s\n{place}", x, list(off)))
    return _side_by_side([
        _captioned(picture(robot, x, terrain=terrain, marked=off, size=size, azimuth=azimuth), text, size)
        for text, x, off in shown
    ])  # fmt: skip


def _place(x: Array, rpy: ArrayLike | None = None) -> str:
    """Return position [m] and roll, pitch, yaw [degree] of a floating base; declared angles keep full turns."""
    angles = np.degrees(rotation.np_to_rpy(x[3:7]) if rpy is None else np.asarray(rpy, dtype=float))
    place, turned = np.round(x[:3], 3) + 0.0, np.round(angles) + 0.0
    return f"({', '.join(f'{each:g}' for each in place)}) m  ({', '.join(f'{each:g}' for each in turned)})°"


def _own(model: Any, path: Any, placed: Any) -> dict[Any, Array]:
    """Return the targets of a keyframe that are a part of the model's state."""
    sample = path.sample(placed.end, placed)
    return {quantity: sample[quantity] for quantity in model.state.slices if quantity in sample}


def _qpos(robot: Robot, state: ArrayLike | str) -> Array:
    """Return MuJoCo's position vector of a state or a pose."""
    base = 7 if robot.base == "free" else 0
    count = base + robot.num_joints
    if isinstance(state, str):
        joints = robot.pose(state)
        place = [0.0, 0.0, robot.base_height(state), 1.0, 0.0, 0.0, 0.0][:base]
        return np.concatenate([place, joints])
    x = np.asarray(state, dtype=float)
    if x.shape not in ((count,), (2 * count - (base > 0),)):
        raise ShapeError(
            f"picture: state has another size - got shape {x.shape}, expected ({count},) or "
            f"({2 * count - (base > 0)},) of robot '{robot.name}'; pass a state of this robot"
        )
    return x[:count]


def _captioned(drawn: Picture, text: str, size: tuple[int, int]) -> Picture:
    image = Image.fromarray(drawn).resize(size, Image.Resampling.LANCZOS)
    font = ImageFont.truetype(str(FONT), max(size[1] // 18, 9))
    ImageDraw.Draw(image).text((0.03 * size[0], 0.98 * size[1]), text, font=font, fill=INK, anchor="ld")
    return np.asarray(image)


def _side_by_side(pictures: Sequence[Picture]) -> Picture:
    height = pictures[0].shape[0]
    gap = np.full((height, _GAP, 3), 255, dtype=np.uint8)
    parts = [part for each in pictures for part in (each, gap)][:-1]
    return np.concatenate(parts, axis=1)


def save_picture(drawn: Picture, path: str | Path) -> Path:
    """Write a picture into a file, atomically; return its path."""
    path = Path(path)
    with whole_file(path) as temporary:
        Image.fromarray(drawn).save(temporary)
    return path
