"""A linear Kalman filter for the base of a legged robot, on inertial unit and leg kinematics."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from piaffe.errors import ModelError
from piaffe.models import Robot
from piaffe.models.terrain import Flat, Terrain
from piaffe.ocp import rotation

from .numbers import finite_number
from .perturbation import check_deviations
from .sensors import Reading

Array = NDArray[np.float64]

_SWING = 1e3  # [m/√s], a foot in the air may go anywhere


@dataclass(frozen=True, kw_only=True)
class KalmanNoise:
    """Standard deviations that a :class:`KalmanEstimator` assumes.

    Args:
        acceleration: of the acceleration, per √Hz [m/s²/√Hz].
        slip: of the place of a foot on the ground, per root of time [m/√s].
        foot_position: of the place of a foot relative to the base [m].
        foot_velocity: of the velocity of a foot on the ground [m/s].
        foot_height: of the height of a foot on the ground [m].

    Raises:
        ModelError: a standard deviation is negative or not a number.
    """

    acceleration: float = 0.2
    slip: float = 0.01
    foot_position: float = 0.002
    foot_velocity: float = 0.1
    foot_height: float = 0.005

    def __post_init__(self) -> None:
        check_deviations(self, "kalman noise", ModelError)


class KalmanEstimator:
    """Estimates position and velocity of the base; orientation and joints are taken as they are measured.

    The state is s = (p, v, p₁, …, p_nf): place and velocity of the base, and places of the centres of the feet's balls,
    in the world. With the specific force f of a reading, a = R f + g, and c = ω_i × r ẑ, the velocity of the centre of
    a ball of radius r that rolls on the ground with its link's angular velocity ω_i, the prediction over Δt is::

        p ← p + v Δt + ½ a Δt²,    v ← v + a Δt,    p_i ← p_i + c Δt on the ground, any place in the air

    Forward kinematics give d, the place of a foot relative to the base, and ḋ, its velocity for a base at rest, both in
    world axes. A reading is::

        p_i − p = d for all feet,    v = c − ḋ and p_i,z = height of the ground + r for feet on the ground

    This is the filter of legged robots of [Bledt2018Cheetah3], with rolling feet.

    Args:
        robot: the robot.
        contacts: which feet are on the ground: those of the plan (``"schedule"``), where it is known, or those whose
            force says so (``"measured"``).
        settle: a foot counts as on the ground from this time after its touchdown on [s], because it is neither there on
            schedule nor at rest at once.
        terrain: the ground; level at z = 0 by default.
        noise: assumed standard deviations.

    Raises:
        ModelError: ``contacts`` is unknown, or ``settle`` is negative.
    """

    def __init__(
        self,
        robot: Robot,
        *,
        contacts: Literal["schedule", "measured"] = "schedule",
        settle: float = 0.02,
        terrain: Terrain | None = None,
        noise: KalmanNoise | None = None,
    ) -> None:
        if contacts not in ("schedule", "measured"):
            raise ModelError(
                f"estimator: contacts is unknown - got {contacts!r}, expected 'schedule' or 'measured'; choose one"
            )
        self.robot, self._scheduled, self._terrain = robot, contacts == "schedule", terrain or Flat()
        self._noise, self._gravity = noise or KalmanNoise(), np.array(robot.model.gravity.linear)
        self._data, self._frames = robot.model.createData(), [robot.frame_id(foot.frame) for foot in robot.feet]
        self._nf = len(robot.feet)
        self._settle, self._stood = finite_number("estimator", "settle", settle), np.zeros(len(robot.feet))
        if self._settle < 0:
            raise ModelError(f"estimator: settle is out of range - got {settle!r}, expected seconds ≥ 0; change it")
        self._size = 6 + 3 * self._nf
        self._rows = self._measurement()
        self.mean, self.covariance = np.zeros(self._size), np.eye(self._size)

    def _measurement(self) -> Array:
        """Return the rows of all readings: places of the feet, velocity by each foot, heights, (7 nf, 6 + 3 nf)."""
        nf, eye = self._nf, np.eye(3)
        rows = np.zeros((7 * nf, self._size))
        for i in range(nf):
            at, foot = slice(3 * i, 3 * i + 3), slice(6 + 3 * i, 9 + 3 * i)
            rows[at, :3], rows[at, foot] = -eye, eye
            rows[3 * nf + 3 * i : 3 * nf + 3 * i + 3, 3:6] = eye
            rows[6 * nf + i, 8 + 3 * i] = 1.0
        return rows

    def reset(self, x: Array) -> None:
        """Begin anew from a known state (nx,)."""
        n = self.robot.num_joints
        places, _, _ = self._kinematics(x[3:7], x[7 : 7 + n], np.zeros(3), np.zeros(n))
        self.mean = np.concatenate([x[:3], x[7 + n : 10 + n], (places + x[:3]).ravel()])
        self.covariance = 1e-6 * np.eye(self._size)
        self._stood[:] = np.inf

    def estimate(self, reading: Reading, elapsed: float) -> Array:
        """Return the state (nx,) of a reading."""
        known = np.isfinite(reading.planned) & self._scheduled
        touching = np.where(known, reading.planned, reading.touching) > 0.5
        self._stood = np.where(touching, self._stood + elapsed, 0.0)
        on = touching & (self._stood > self._settle)
        places, rates, spins = self._kinematics(
            reading.orientation, reading.joint_position, reading.angular_velocity, reading.joint_velocity
        )
        rolling = np.cross(spins, (0.0, 0.0, self.robot.foot_radius))
        to_world = rotation.np_matrix(reading.orientation[None])[0]
        self._predict(to_world @ reading.acceleration + self._gravity, rolling, on, elapsed)
        self._correct(places, rolling - rates, on)
        return np.concatenate([
            self.mean[:3], reading.orientation, reading.joint_position, self.mean[3:6], reading.angular_velocity,
            reading.joint_velocity,
        ])  # fmt: skip

    def _predict(self, acceleration: Array, rolling: Array, on: NDArray[np.bool_], elapsed: float) -> None:
        h, mean = elapsed, self.mean
        mean[:3] += h * mean[3:6] + h**2 / 2 * acceleration
        mean[3:6] += h * acceleration
        mean[6:] += h * (rolling * on[:, None]).ravel()
        step = np.eye(self._size)
        step[:3, 3:6] = h * np.eye(3)
        feet = np.repeat(np.where(on, self._noise.slip, _SWING) ** 2 * h, 3)
        deviation = self._noise.acceleration**2
        grown = step @ self.covariance @ step.T
        grown[range(3), range(3)] += deviation * h**3 / 3
        grown[range(3), range(3, 6)] += deviation * h**2 / 2
        grown[range(3, 6), range(3)] += deviation * h**2 / 2
        grown[range(3, 6), range(3, 6)] += deviation * h
        grown[range(6, self._size), range(6, self._size)] += feet
        self.covariance = grown

    def _correct(self, places: Array, velocities: Array, on: NDArray[np.bool_]) -> None:
        nf, noise, feet = self._nf, self._noise, self.mean[6:].reshape(-1, 3)
        heights = np.asarray(self._terrain.height(feet[:, 0], feet[:, 1])) + self.robot.foot_radius
        used = np.concatenate([np.ones(3 * nf, dtype=bool), np.repeat(on, 3), on])
        deviations = np.repeat((noise.foot_position, noise.foot_velocity, noise.foot_height), (3 * nf, 3 * nf, nf))
        rows = self._rows[used]
        off = np.concatenate([places.ravel(), velocities.ravel(), heights])[used] - rows @ self.mean
        cross = self.covariance @ rows.T
        spread = rows @ cross + np.diag(deviations[used] ** 2)
        gain = np.linalg.solve(spread, cross.T).T
        self.mean = self.mean + gain @ off
        left = np.eye(self._size) - gain @ rows  # Joseph's form keeps the covariance symmetric and positive
        self.covariance = left @ self.covariance @ left.T + gain @ np.diag(deviations[used] ** 2) @ gain.T

    def _kinematics(self, orientation: Array, joints: Array, spin: Array, rates: Array) -> tuple[Array, Array, Array]:
        """Return places and velocities of the feet for a base at rest in the origin, and spins of their links.

        All are in world axes, (nf, 3).
        """
        q = np.concatenate([np.zeros(3), orientation[[1, 2, 3, 0]], joints])
        pin.forwardKinematics(self.robot.model, self._data, q, np.concatenate([np.zeros(3), spin, rates]))
        places, velocities, spins = (np.zeros((self._nf, 3)) for _ in range(3))
        for i, frame in enumerate(self._frames):
            places[i] = pin.updateFramePlacement(self.robot.model, self._data, frame).translation
            motion = pin.getFrameVelocity(self.robot.model, self._data, frame, pin.LOCAL_WORLD_ALIGNED)
            velocities[i], spins[i] = motion.linear, motion.angular
        return places, velocities, spins
