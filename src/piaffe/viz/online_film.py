"""Films of episodes of a receding horizon: the plant's states, with the contact forces of the simulator."""

from __future__ import annotations

from pathlib import Path

from piaffe.simulation import OnlineEpisode

from .cuts import nearest
from .film import Cut, sheet, write
from .playback import Snapshot
from .studio import Studio

_FPS = 50


def film_online(path: Path, episode: OnlineEpisode, *, size: tuple[int, int], note: str = "") -> Path:
    """Write a film of an episode, or, for the suffix of a picture, six moments of it; return its path.

    The ground of the film is level.

    Args:
        path: the file, ``.mp4`` or ``.png``.
        episode: the episode; it has at least one tick.
        size: width and height [pixels].
        note: text beside the speed.
    """
    robot, nq = episode.robot, 7 + episode.robot.num_joints
    shown = [
        Snapshot(float(time), state[:nq], force, robot.name, tuple(bool(each) for each in touch))
        for time, state, force, touch in zip(
            episode.times, episode.states, episode.forces, episode.touching, strict=True
        )
    ]
    cut = Cut(nearest(shown), shown[0].time, shown[-1].time, 1.0, note)
    columns, rows = (1, 1) if path.suffix == ".mp4" else (3, 2)
    studio = Studio(robot, (size[0] // columns, size[1] // rows))
    if path.suffix == ".mp4":
        return write(path, studio, [cut], robot.foot_names, fps=_FPS)
    return sheet(path, studio, cut, robot.foot_names, columns=columns, rows=rows)
