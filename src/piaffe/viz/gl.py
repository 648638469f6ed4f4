"""Choice of a backend that renders without a window; another process tries each, before MuJoCo is imported here."""

from __future__ import annotations

import os
import subprocess
import sys

from piaffe.errors import PiaffeError

_WORKED: set[str] = set()  # the probe takes a process and a second
_PROBE = """
import mujoco
model = mujoco.MjModel.from_xml_string("<mujoco><worldbody><light/><geom type='sphere' size='1'/></worldbody></mujoco>")
data = mujoco.MjData(model)
mujoco.mj_forward(model, data)
with mujoco.Renderer(model, 32, 32) as renderer:
    renderer.update_scene(data)
    assert renderer.render().max() > 0
"""


class DisplayError(PiaffeError, RuntimeError):
    """Pictures cannot be rendered or shown: there is no OpenGL, or no display."""


def prepare(timeout_s: float = 120.0) -> str:
    """Choose a backend that renders off screen, set ``MUJOCO_GL`` to it and return it.

    If ``MUJOCO_GL`` is set, only its backend is tried; else EGL (driver of a graphics card, or Mesa), OSMesa
    (software), and a window system, in this order.

    Raises:
        DisplayError: no backend works.
    """
    chosen = os.environ.get("MUJOCO_GL", "")
    candidates = [chosen] if chosen else ["egl", "osmesa", *(["glfw"] if has_display() else [])]
    for backend in candidates:
        if works(backend, timeout_s):
            os.environ["MUJOCO_GL"] = backend
            return backend
    raise DisplayError(
        f"film: MuJoCo cannot render here - got no working OpenGL (tried {', '.join(candidates)}), expected EGL or "
        "OSMesa; install Debian's or Ubuntu's libosmesa6 (apt-get install libosmesa6) for software rendering, or a "
        "graphics driver" + (", and unset MUJOCO_GL to try all backends" if chosen else "")
    )


def works(backend: str, timeout_s: float) -> bool:
    """Return whether a picture can be rendered with a backend; what has worked is not tried again."""
    if backend in _WORKED:
        return True
    try:
        done = subprocess.run(
            [sys.executable, "-c", _PROBE],
            env={**os.environ, "MUJOCO_GL": backend},
            capture_output=True,
            timeout=timeout_s,
        )
    except subprocess.TimeoutExpired:
        return False
    if done.returncode == 0:
        _WORKED.add(backend)
    return done.returncode == 0


def has_display() -> bool:
    """Return whether there is a window system that can open windows."""
    return sys.platform != "linux" or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
