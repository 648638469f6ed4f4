"""A simulation: MuJoCo, stepped with one control at a time, with a check for divergence."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from piaffe.models import Mujoco, import_mujoco

from .actuators import Drive
from .forces import foot_forces, foot_slip, others_in_contact
from .scene import Scene, forbid, scene_of

Array = NDArray[np.float64]

MAX_SPEED = 1e3
"""A simulation with a larger speed has diverged [m/s], [rad/s]."""


class Simulation:
    """A robot in MuJoCo at one time, which goes on step by step.

    Args:
        scene: the robot in MuJoCo: a model, whose controls are its action's, or a scene.
        x: its first state (nx,).
        drive: actuators between commanded and acting torques; None for a model, whose action has limits of its own.
    """

    def __init__(self, scene: Mujoco | Scene, x: Array, drive: Drive | None = None) -> None:
        self._mujoco = import_mujoco()
        self.scene = scene_of(scene) if isinstance(scene, Mujoco) else scene
        self._compiled = compiled = self.scene.compiled
        forbid(compiled, "AUTORESET")  # without this, MuJoCo resets a diverged state
        self._data = self._mujoco.MjData(compiled)
        self._positions, self._velocities = self.scene.positions, self.scene.velocities
        self._joints, self._drive = self._velocities[6:], drive
        nq = len(self._positions)
        self._data.qpos[self._positions], self._data.qvel[self._velocities] = x[:nq], x[nq:]
        self._feet, self._owners = list(self.scene.feet), list(self.scene.owners)
        self._steps = 0
        self.failed = False
        self.torque: Array = np.zeros(len(self._joints))
        """Torques that acted in the last step (n,) [Nm]; with a drive only."""
        self.limited: NDArray[np.bool_] = np.zeros(len(self._joints), dtype=bool)
        """Which commands exceeded a limit of the drive in the last step (n,)."""

    @property
    def state(self) -> Array:
        """Its state (nx,)."""
        return np.concatenate([self._data.qpos[self._positions], self._data.qvel[self._velocities]])

    @property
    def timestep(self) -> float:
        """Its time step [s]."""
        return float(self._compiled.opt.timestep)

    @property
    def weight(self) -> float:
        """Weight of the robot [N]."""
        gravity = float(np.linalg.norm(self._compiled.opt.gravity))
        return gravity * float(self._compiled.body_subtreemass[self.scene.base])

    def foot_forces(self) -> Array:
        """Return the world force on each foot, (nf, 3) [N], in the last step; before any step, in the first state."""
        if self._steps == 0:
            self._mujoco.mj_forward(self._compiled, self._data)
        total: Array = np.zeros((len(self.scene.robot.feet), 3))
        np.add.at(total, self._owners, foot_forces(self._compiled, self._data, self._feet))
        return total

    def foot_slip(self) -> Array:
        """Return how far each foot slipped along the ground in the last step, (nf,) [m]; 0 for feet in the air."""
        fastest: Array = np.zeros(len(self.scene.robot.feet))
        np.maximum.at(fastest, self._owners, foot_slip(self._compiled, self._data, self._feet))
        return fastest * self.timestep

    def others_in_contact(self) -> tuple[str, ...]:
        """Return the names of the parts that touched the ground in the last step and are no feet."""
        return others_in_contact(self._compiled, self._data, self._feet)

    def settle(self) -> None:
        """Clear the warm start of the contact solver, as at the start of a controller's roll-outs."""
        self._data.qacc_warmstart[:] = 0.0

    def change_velocity(self, change: Array) -> None:
        """Add a change to the base's linear velocity in world axes (3,) [m/s]; joint velocities do not change."""
        self._data.qvel[self._velocities[:3]] += change

    def pull(self, force: Array) -> None:
        """Set the force on the centre of mass of the base link in world axes (3,) [N], for all following steps."""
        self._data.xfrc_applied[self.scene.base, :3] = force

    def step(self, control: Array) -> None:
        """Make a step of the simulator with a control (nu,); after a failure the state does not change any more."""
        if self.failed or not np.all(np.isfinite(control)):
            self.failed = True
            return
        data = self._data
        before = data.qpos.copy(), data.qvel.copy()
        if self._drive is not None:
            control, self.limited = self._drive(control, data.qvel[self._joints])
            self.torque = control
        if self.scene.direct:
            data.qfrc_applied[self._joints] = control
        else:
            data.ctrl[:] = control
        with _Silence(self._mujoco):
            self._mujoco.mj_step(self._compiled, data)
        self._steps += 1
        stopped = bool(data.warning.number.any()) or data.time < (self._steps - 0.5) * self._compiled.opt.timestep
        with np.errstate(invalid="ignore"):
            finite = np.all(np.isfinite(data.qpos)) and np.all(np.isfinite(data.qvel))
            bad = not finite or float(np.abs(data.qvel).max(initial=0.0)) > MAX_SPEED
        if stopped or bad:
            self.failed = True
            data.qpos[:], data.qvel[:] = before


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
