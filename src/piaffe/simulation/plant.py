"""A plant: MuJoCo, stepped with one control at a time, with a check for divergence."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piaffe.models import Mujoco, import_mujoco

from .forces import foot_forces, foot_slip, others_in_contact

Array = NDArray[np.float64]

MAX_SPEED = 1e3
"""A simulation with a larger speed has diverged [m/s], [rad/s]."""


class Plant:
    """A simulated robot.

    Args:
        model: the robot in MuJoCo.
        x: its first state (nx,).
    """

    def __init__(self, model: Mujoco, x: Array) -> None:
        self._mujoco = import_mujoco()
        compiled: Any = copy.copy(model.compiled())
        bits = self._mujoco.mjtDisableBit
        compiled.opt.disableflags |= int(bits.mjDSBL_AUTORESET)  # without this, MuJoCo resets a diverged state
        compiled.opt.disableflags &= ~int(bits.mjDSBL_WARMSTART)
        self._compiled, self._data = compiled, self._mujoco.MjData(compiled)
        self._data.qpos[:], self._data.qvel[:] = x[: compiled.nq], x[compiled.nq :]
        self._feet = [compiled.geom(foot.name).id for foot in model.robot.feet]
        self._steps = 0
        self.failed = False

    @property
    def state(self) -> Array:
        """Its state (nx,)."""
        return np.concatenate([self._data.qpos, self._data.qvel])

    def foot_forces(self) -> Array:
        """Return the world force on each foot, (nf, 3) [N], in the last step; before any step, in the first state."""
        if self._steps == 0:
            self._mujoco.mj_forward(self._compiled, self._data)
        return foot_forces(self._compiled, self._data, self._feet)

    def foot_slip(self) -> Array:
        """Return how far each foot slipped along the ground in the last step, (nf,) [m]; 0 for feet in the air."""
        return foot_slip(self._compiled, self._data, self._feet) * float(self._compiled.opt.timestep)

    def others_in_contact(self) -> tuple[str, ...]:
        """Return the names of the parts that touched the ground in the last step and are no feet."""
        return others_in_contact(self._compiled, self._data, self._feet)

    def settle(self) -> None:
        """Clear the warm start of the contact solver, as at the start of a controller's roll-outs."""
        self._data.qacc_warmstart[:] = 0.0

    def step(self, control: Array) -> None:
        """Make a step of the simulator with a control (nu,); after a failure the state does not change any more."""
        if self.failed or not np.all(np.isfinite(control)):
            self.failed = True
            return
        data, before = self._data, self.state
        data.ctrl[:] = control
        with _Silence(self._mujoco):
            self._mujoco.mj_step(self._compiled, data)
        self._steps += 1
        stopped = bool(data.warning.number.any()) or data.time < (self._steps - 0.5) * self._compiled.opt.timestep
        with np.errstate(invalid="ignore"):
            bad = not np.all(np.isfinite(self.state)) or float(np.abs(data.qvel).max(initial=0.0)) > MAX_SPEED
        if stopped or bad:
            self.failed = True
            data.qpos[:], data.qvel[:] = before[: self._compiled.nq], before[self._compiled.nq :]


class _Silence:
    """Suppresses MuJoCo's message and its log file when it diverges; the plant detects a divergence itself."""

    def __init__(self, mujoco: Any) -> None:
        self._mujoco = mujoco

    def __enter__(self) -> None:
        self._before = self._mujoco.get_mju_user_warning()
        self._mujoco.set_mju_user_warning(_ignore)

    def __exit__(self, *_: object) -> None:
        self._mujoco.set_mju_user_warning(self._before)


def _ignore(message: str) -> None:
    """Ignore a message."""
