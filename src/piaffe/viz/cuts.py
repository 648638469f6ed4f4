"""The parts of a film: the plan or its simulation, once per speed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from piaffe.errors import ProblemError

from .films import Cut
from .playback import Playback, Snapshot
from .simulated import simulate


def cuts_of(
    playback: Playback, speeds: Sequence[float], *, ghost: bool, simulated: bool, mu: float | None
) -> tuple[list[Cut], str]:
    """Return the cuts of a film, and a text about the simulation; the text is empty without a simulation.

    Args:
        playback: the solution.
        speeds: the motion is shown once at each speed.
        ghost: also show the targets; in a simulation, the plan.
        simulated: show a simulation of the policy in place of the plan.
        mu: friction coefficient of the simulation; by default that of the problem.
    """
    for speed in speeds:
        if not 0 < speed < float("inf"):
            raise ProblemError(f"film: speed is out of range - got {speed}, expected a number > 0; 1 is real time")
    if not simulated:
        return [Cut(lambda t: playback.at(t, ghost=ghost), playback.start, playback.end, speed) for speed in speeds], ""
    run, snapshots = simulate(playback, mu=mu)
    note = "simulation" if run.lost_at is None else f"simulation, lost at {run.lost_at:.2f} s"
    shown = nearest(snapshots if ghost else [replace(snapshot, ghost=None) for snapshot in snapshots])
    return [Cut(shown, snapshots[0].time, snapshots[-1].time, speed, note) for speed in speeds], str(run)


def nearest(snapshots: Sequence[Snapshot]) -> Callable[[float], Snapshot]:
    """Return a function of time [s] that returns the snapshot nearest to it."""
    times = np.array([snapshot.time for snapshot in snapshots])
    return lambda t: snapshots[int(np.argmin(np.abs(times - t)))]


def picture_size(text: str) -> tuple[int, int]:
    """Return width and height of ``"1280x720"``; both must be even, because the film's encoding requires it."""
    parts = text.lower().split("x")
    if len(parts) == 2 and all(part.isdigit() and int(part) >= 64 and int(part) % 2 == 0 for part in parts):
        return int(parts[0]), int(parts[1])
    raise ProblemError(
        f"film: size is unusable - got '{text}', expected two even numbers from 64 on as WxH; give 1280x720"
    )


def is_sheet(path: Path) -> bool:
    """Return whether a file has the suffix of a picture, False for a film; raise for other suffixes."""
    if path.suffix in (".png", ".jpg", ".webp"):
        return True
    if path.suffix == ".mp4":
        return False
    raise ProblemError(
        f"file '{path}': unknown kind of film - got '{path.suffix}', expected '.mp4', or '.png' for single pictures; "
        "change the ending"
    )
