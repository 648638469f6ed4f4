"""The interactive viewer: a solution in MuJoCo's window; the motion repeats."""

from __future__ import annotations

import time
from pathlib import Path

from piaffe.solvers import Solution

from .cuts import cuts_of
from .gl import DisplayError, has_display
from .playback import Playback

_PAUSE_S = 0.5


def show(path: Path, *, simulated: bool = False, speed: float = 1.0) -> None:
    """Show a saved solution until the window is closed.

    Args:
        path: the saved solution.
        simulated: show a simulation of the policy in place of the plan.
        speed: 1 is real time.

    Raises:
        DisplayError: there is no display.
    """
    playback = Playback(Solution.load(path))
    (cut,), result = cuts_of(playback, [speed], ghost=False, simulated=simulated, mu=None)
    if result:
        print(result)
    if not has_display():
        raise DisplayError(
            "view: there is no display - got neither DISPLAY nor WAYLAND_DISPLAY, expected a window system; make "
            "a film instead: piaffe video"
        )
    import mujoco
    import mujoco.viewer

    from piaffe.models import mujoco_model

    model = mujoco_model(playback.robot, contacts="none", terrain=playback.terrain)
    data = mujoco.MjData(model)
    with mujoco.viewer.launch_passive(model, data, show_left_ui=False) as window:
        began = time.perf_counter()
        while window.is_running():
            t = cut.start + cut.speed * (time.perf_counter() - began)
            if t > cut.end + _PAUSE_S * cut.speed:
                began = time.perf_counter()
                continue
            data.qpos[:] = cut.shown(min(t, cut.end)).qpos
            mujoco.mj_forward(model, data)
            window.sync()
            time.sleep(0.01)
