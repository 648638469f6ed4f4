"""The heuristic reference of a gait: base motion from a command, Raibert footholds, swings, joint angles."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, replace
from typing import Any

import casadi as cs
import numpy as np
from numpy.typing import NDArray

from piaffe.errors import ModelError, ProblemError
from piaffe.ocp import (
    SAME_TIME,
    BoundReference,
    ModelBase,
    Piece,
    PlanarFrame,
    Quantity,
    Reference,
    ReferenceFunctions,
    Sample,
    rotation,
)

from ..legged import LeggedModel, require_floating
from ..placed_ground import PlacedGround
from ..quantities import base, feet, joints
from ..terrain import Flat, HeightField
from .base_path import BasePath, ease, turn_by
from .base_slope import PlanarMotion, SlopeReference
from .footsteps import BOX, STRETCH, ContactSchedule, Footsteps
from .functions import GaitFunctions
from .step_expressions import StepExpressions
from .terrain_footsteps import TerrainFootsteps
from .terrain_step_expressions import TerrainStepExpressions

Array = NDArray[np.float64]

_MISS = 0.01  # largest error of a foot's inverse kinematics, as a fraction of the leg's reach; above it, an error
_AHEAD, _STEP = 50, 0.01  # number of samples that are made in one batch, and the time between them [s]
_KEEP = 5000  # number of samples that are kept


@dataclass(frozen=True, kw_only=True)
class GaitReference(Reference):
    """Targets of a gait from a velocity command; the gait begins at the state where the motion is, and ramps.

    For a stance with touchdown t and duration T, the foothold is the place below the hip at mid-stance. This is
    Raibert's ``v T / 2``, with the yaw motion of the base included. Two terms correct it, for the base's acceleration a
    and for the error of its velocity [Raibert 1986]::

        p = hip(t + T/2) − (h/g) a + k (v − v_ref)

    The foothold is clamped to a box about the hip at touchdown that the leg can reach. ``base.height``,
    ``feet.height`` and ``base.ground_normal`` have targets, too: these are relative to the terrain of the model.

    A controller that plans again places the path at the measured base, but the path keeps its heading: the integral of
    the commanded yaw rate. So a robot that turns more slowly than its targets is behind by an angle that does not grow.

    Args:
        speed: forward velocity after the ramp [m/s].
        lateral_speed: velocity to the left after the ramp [m/s].
        yaw_rate: yaw rate after the ramp [rad/s].
        height: of the base above the ground [m]; None for the height of the robot's ``"stand"`` pose.
        ramp: time in which velocity, height, roll and pitch change from their initial values to the command [s].
        swing_height: height of the swing [m]; None for 0.15 of the leg's reach.
        velocity_gain: k [s]; None for √(h/g).
        heading_limit: largest angle between the kept heading and the measured one [rad], at most π. Beyond it, as after
            a push, the kept heading goes with the measured one. With 0 every plan begins at the measured heading.
        lag_gain: velocity that is added to the command to make up for the lag of the base behind the integral of the
            command, per length of the lag [1/s]. With 0 an error of the speed stays.
        lag_limit: largest lag that is made up for, forward and left [m]. What is beyond, as after a push, is forgotten.
        terrain: height of level ground [m]; None for the ground of the model.
    """

    speed: float = 0.5
    lateral_speed: float = 0.0
    yaw_rate: float = 0.0
    height: float | None = None
    ramp: float = 1.0
    swing_height: float | None = None
    velocity_gain: float | None = None
    heading_limit: float = 0.15
    lag_gain: float = 0.0
    lag_limit: float = 0.05
    terrain: float | None = None

    def __post_init__(self) -> None:
        for key in ("speed", "lateral_speed", "yaw_rate", "ramp"):
            self._require(key, np.isfinite(getattr(self, key)), "a finite number")
        self._require("terrain", self.terrain is None or np.isfinite(self.terrain), "a finite number")
        self._require("ramp", self.ramp >= 0, "seconds ≥ 0")
        self._require("height", self.height is None or 0 < self.height < np.inf, "metres > 0")
        self._require("heading_limit", 0 <= self.heading_limit <= np.pi, "0 to π rad")
        self._require("lag_gain", 0 <= self.lag_gain < np.inf, "a number ≥ 0 [1/s]")
        self._require("lag_limit", 0 <= self.lag_limit < np.inf, "metres ≥ 0")
        self._require("swing_height", self.swing_height is None or 0 <= self.swing_height < np.inf, "metres ≥ 0")

    def bind(self, model: ModelBase, piece: Piece, start: Sample, frame: PlanarFrame) -> BoundGait:
        """Return the gait with its path beginning at the base of ``start``, and its first footholds at its feet."""
        if not isinstance(model, LeggedModel):
            raise ModelError(
                f"gait: model '{model.name}' has no feet - got {type(model).__name__}, expected a model of a legged "
                "robot first in the schedule; begin with models.WholeBody(robot)"
            )
        require_floating(model.robot, "gait")
        return BoundGait(self, model, piece, start)

    def _require(self, key: str, holds: Any, expected: str) -> None:
        if not holds:
            raise ProblemError(
                f"gait: {key} is out of range - got {getattr(self, key)}, expected {expected}; change it"
            )


class BoundGait(BoundReference):
    """A gait placed in the world.

    Args:
        gait: its command.
        model: the model of the robot.
        piece: the phases of the gait.
        start: base and joints at its start.

    Raises:
        ProblemError: at the commanded speed the reference of a foot is out of reach.
    """

    def __init__(self, gait: GaitReference, model: LeggedModel, piece: Piece, start: Sample) -> None:
        self.gait, self.model, self.piece = gait, model, piece
        self.robot = model.robot
        self.kinematics = model.kinematics
        self._height = gait.height if gait.height is not None else self.robot.base_height("stand")
        self._gravity = float(np.linalg.norm(self.robot.model.gravity.linear)) or 9.81
        self._home = self.kinematics.feet(self.robot.pose("stand"))
        self._anchor, self._error, self._lag = np.inf, np.zeros(2), np.zeros(2)
        self.ground = model.reference_ground if gait.terrain is None else Flat(gait.terrain)
        self._level = float(self.ground.level) if isinstance(self.ground, Flat) else 0.0
        self._begin(start)
        once, cycle = (tuple((p.duration, model.flags(p.mode)) for p in phases) for phases in (piece.once, piece.cycle))
        schedule = ContactSchedule(once, cycle)
        swing = gait.swing_height if gait.swing_height is not None else 0.15 * float(self.kinematics.reach.min())
        self._swing = swing
        ground = self._level + self.robot.foot_radius
        self.footsteps = self._made_footsteps(schedule, self._first_feet(start), ground, swing)
        self._slope = _slope_of(self.footsteps)
        if self._slope is not None:
            self._posture -= self._slope.posture(np.zeros(1), self._planar(np.zeros(1)))[0][0]
        self._weight = self._mean_force(schedule)
        self._kept: dict[float, dict[Quantity, Array]] = {}
        self._check_reach(schedule)

    def sample(self, t: float, phase: int) -> Sample:
        """Return the targets of base, joints and feet."""
        key = round(t, 9)
        if key not in self._kept:
            if len(self._kept) > _KEEP:
                self._kept.clear()
            times: Array = key + _STEP * np.arange(_AHEAD, dtype=float)
            made = self.samples(times)
            for i, time in enumerate(times):
                self._kept.setdefault(round(float(time), 9), {quantity: v[i] for quantity, v in made.items()})
        return {**self._kept[key], feet.force: self._force(phase)}

    def _force(self, phase: int) -> Array:
        """Return the contact forces in a phase, (3 nf,) [N]: the feet on the ground share the weight equally."""
        flags = self.footsteps.schedule.flags(phase)
        force = np.zeros((len(flags), 3))
        force[:, 2] = flags * self._weight / max(flags.sum(), 1.0)
        return force.ravel()

    def samples(self, t: Array) -> dict[Quantity, Array]:
        """Return all targets but the forces at times (S,) [s], each (S, ...)."""
        position, rpy, velocity, rates = self._base(t)
        orientation, omega = rotation.np_from_rpy(rpy), rotation.np_body_rate(rpy, rates)
        place, swing = self.footsteps.at(t)
        yaw = rpy[:, 2]
        angles, _ = self.kinematics.world_inverse(position, orientation, place)
        inward = np.swapaxes(rotation.np_matrix(orientation), -1, -2)
        arms = (place - position[:, None]) @ np.swapaxes(inward, -1, -2)
        relative = (swing - velocity[:, None]) @ np.swapaxes(inward, -1, -2) - np.cross(omega[:, None], arms)
        return {
            base.position: position,
            base.orientation: orientation,
            base.linear_velocity: velocity,
            base.angular_velocity: omega,
            base.height: position[:, 2:] - self._below(t),
            base.ground_normal: self._normal(t, inward),
            joints.position: angles,
            joints.velocity: self.kinematics.joint_velocities(angles, relative),
            feet.position: place.reshape(len(t), -1),
            feet.velocity: swing.reshape(len(t), -1),
            feet.reach: turn_by(-yaw[:, None], (place - position[:, None])[..., :2]).reshape(len(t), -1),
            feet.height: place[..., 2] - (self._level + self.robot.foot_radius),
        }

    def anchored(self, t: float, actual: Sample) -> BoundGait:
        """Return the gait moved to the measured state of the robot, for a controller that plans again at time t.

        The path of the base goes through the measured position, and keeps its heading within the limit about the
        measured one. Feet on the ground stay where they are. The next foothold of every foot corrects the error in
        velocity.

        Args:
            t: local time of the measured sample [s].
            actual: base position, orientation and linear velocity, and the positions of the feet if known.
        """
        now = np.array([t])
        place = np.asarray(actual[base.position])
        wanted, yaw = self.path.position(now)[0], float(self.path.yaw(now)[0])
        turn = float(rotation.np_to_rpy(np.asarray(actual[base.orientation]))[2]) - yaw
        turn -= 2 * np.pi * np.round(turn / (2 * np.pi))
        turn -= float(np.clip(turn, -self.gait.heading_limit, self.gait.heading_limit))  # the rest is kept
        origin = place[:2] + turn_by(np.array(turn), np.array(self.path.origin[:2]) - wanted)
        moved = copy(self)
        moved.path = replace(self.path, origin=(float(origin[0]), float(origin[1]), self.path.origin[2] + turn))
        if self.gait.lag_gain:
            behind, limit = self._lag + turn_by(np.array(-yaw - turn), wanted - place[:2]), self.gait.lag_limit
            moved._lag = np.clip(behind, -limit, limit)
        moved._aim(t)
        velocity = np.asarray(actual.get(base.linear_velocity, np.zeros(3)))[:2]
        moved._anchor, moved._error = t, velocity - moved._aimed.velocity(now)[0]
        where = np.asarray(actual[feet.position]).reshape(-1, 3) if feet.position in actual else None
        moved.footsteps = self.footsteps.held(t, where, moved._footholds)
        moved._slope = _slope_of(moved.footsteps)
        moved._kept = {}
        return moved

    def functions(self) -> ReferenceFunctions | None:
        """Return the gait as CasADi functions of time and of speed, lateral speed, yaw rate and height.

        A gait with an end has none on a height field: its samples are in tables, without commands.

        Raises:
            ProblemError: the gait has no end, and the ground is a height field.
        """
        if isinstance(self.ground, HeightField) and np.isfinite(self.piece.duration):
            return None
        command = np.array([self.gait.speed, self.gait.lateral_speed, self.gait.yaw_rate, self._height])
        numbers = GaitFunctions(
            self.model.state, self.kinematics, self.footsteps.schedule, self._step_expressions(), command,
            self.gait.ramp, self.gait.heading_limit, self.gait.lag_gain, self.gait.lag_limit, self._level,
            self._weight,
        )  # fmt: skip
        return numbers.compile()

    def _step_expressions(self) -> StepExpressions:
        """Return footholds and swings as expressions: on a terrain they depend on where a plan's frame is."""
        steps = StepExpressions(
            self._home, self.kinematics.reach, self._level + self.robot.foot_radius, self._swing, self._gravity,
            self.gait.velocity_gain,
        )  # fmt: skip
        if isinstance(self.ground, Flat):
            return steps
        if isinstance(self.ground, HeightField):
            raise ProblemError(
                f"gait of robot '{self.robot.name}': has no functions of time on this ground - got a height field of "
                f"{len(self.ground.heights)} by {len(self.ground.heights[0])} nodes and a gait without end, expected "
                "level ground, a slope, stairs or boxes where a controller plans again and again; use boxes, or choose "
                "a number of cycles with .cycles(n)"
            )
        placed = PlacedGround(self.ground, self.robot.foot_radius, cs.SX.sym("anchor", 3))
        return TerrainStepExpressions(**vars(steps), placed=placed)

    # ---- the base

    def _begin(self, start: Sample) -> None:
        position, rpy = np.asarray(start[base.position]), rotation.np_to_rpy(np.asarray(start[base.orientation]))
        moving = np.asarray(start.get(base.linear_velocity, np.zeros(3)))
        turning = np.asarray(start.get(base.angular_velocity, np.zeros(3)))
        first = np.array([*turn_by(-rpy[2], moving[:2]), turning[2]])
        last = np.array([self.gait.speed, self.gait.lateral_speed, self.gait.yaw_rate])
        self.path = BasePath((float(position[0]), float(position[1]), float(rpy[2])), first, last, self.gait.ramp)
        self._aimed = self.path
        self._posture = np.array([position[2], rpy[0], rpy[1]])

    def _aim(self, t: float) -> None:
        """Add the velocity that makes up for the lag to the path, which still goes through its position at time t."""
        more = np.array([*(self.gait.lag_gain * self._lag), 0.0])
        if not more.any():
            self._aimed = self.path
            return
        aimed, now = replace(self.path, first=self.path.first + more, last=self.path.last + more), np.array([t])
        x, y = np.array(self.path.origin[:2]) + self.path.position(now)[0] - aimed.position(now)[0]
        self._aimed = replace(aimed, origin=(float(x), float(y), self.path.origin[2]))

    def _base(self, t: Array) -> tuple[Array, Array, Array, Array]:
        """Return position, roll-pitch-yaw, linear velocity and rates of roll-pitch-yaw, (S, 3) each."""
        upright = np.array([self._level + self._height, 0.0, 0.0])
        posture, rates = ease(t, self.gait.ramp, self._posture, upright)
        if self._slope is not None:
            more, faster = self._slope.posture(t, self._planar(t))
            posture, rates = posture + more, rates + faster
        yaw, turning = self._aimed.yaw(t), self._aimed.command(t)[:, 2]
        return (
            np.column_stack([self._aimed.position(t), posture[:, 0]]),
            np.column_stack([posture[:, 1:], yaw]),
            np.column_stack([self._aimed.velocity(t), rates[:, 0]]),
            np.column_stack([rates[:, 1:], turning]),
        )

    def _planar(self, t: Array) -> PlanarMotion:
        return PlanarMotion(
            self._aimed.position(t), self._aimed.velocity(t), self._aimed.yaw(t), self._aimed.command(t)[..., 2]
        )

    def _below(self, t: Array) -> Any:
        """Return the height of the ground below the feet, (S, 1), or one number if it is level [m]."""
        return self._level if self._slope is None else self._slope.mean_height(t)[:, None]

    def _normal(self, t: Array, inward: Array) -> Array:
        """Return the upward normal of the ground in the axes of the base, (S, 3)."""
        return inward[..., 2] if self._slope is None else (inward @ self._slope.normal(t)[..., None])[..., 0]

    # ---- the feet

    def _made_footsteps(self, schedule: ContactSchedule, start: Array, ground: float, swing: float) -> Footsteps:
        if isinstance(self.ground, Flat):
            return Footsteps(schedule, start, ground, swing, self._footholds)
        return TerrainFootsteps(
            schedule, start, ground, swing, self._footholds, self.ground, self.robot.foot_radius,
            float(self.kinematics.reach.min()),
        )  # fmt: skip

    def _first_feet(self, start: Sample) -> Array:
        if feet.position in start:
            return np.asarray(start[feet.position]).reshape(-1, 3)
        angles = np.asarray(start[joints.position]) if joints.position in start else self.robot.pose("stand")
        return self.kinematics.world_feet(np.asarray(start[base.position]), np.asarray(start[base.orientation]), angles)

    def _footholds(self, foot: int, touchdown: Array, length: Array) -> Array:
        """Return the footholds of a foot's stances, (k, 2) [m]; see :class:`GaitReference`."""
        home = self._home[foot, :2]
        lever = self._height / self._gravity
        gain = self.gait.velocity_gain if self.gait.velocity_gain is not None else np.sqrt(lever)
        middle = touchdown + length / 2
        balance = home - lever * self._aimed.acceleration(middle)
        place = self._aimed.position(middle) + turn_by(self._aimed.yaw(middle), balance)
        corrected = np.flatnonzero(touchdown > self._anchor + SAME_TIME)[:1]
        place[corrected] += gain * self._error
        hip, yaw = self._aimed.position(touchdown), self._aimed.yaw(touchdown)
        offset = turn_by(-yaw, place - hip) - home
        reach = self.kinematics.reach[foot]
        room = np.sqrt(max((STRETCH * reach) ** 2 - self._height**2, 0.0))
        box = np.minimum(np.array(BOX) * reach, room)
        return np.asarray(hip + turn_by(yaw, home + np.clip(offset, -box, box)))

    def _mean_force(self, schedule: ContactSchedule) -> float:
        """Return the sum of the contact forces, while there are any, whose mean over a cycle is the weight [N]."""
        phases = schedule.cycle or schedule.once
        standing = sum(duration for duration, flags in phases if flags.any())
        whole = sum(duration for duration, _ in phases)
        return float(self.robot.mass * self._gravity * (whole / standing if standing else 0.0))

    def _check_reach(self, schedule: ContactSchedule) -> None:
        """Raise ProblemError if the feet cannot follow their reference after the ramp."""
        once = sum(duration for duration, _ in schedule.once)
        settled = self.gait.ramp + once + schedule.period if schedule.cycle else min(self.gait.ramp, once)
        t = settled + np.arange(0.0, max(schedule.period or once - settled, _STEP), _STEP)
        if self._slope is not None and np.isfinite(self.piece.duration):
            end = self.piece.duration
            t = np.arange(min(settled, end - _STEP), end, _STEP)
        position, rpy, _, _ = self._base(t)
        place, _ = self.footsteps.at(t)
        tolerance = 0.1 * _MISS * float(self.kinematics.reach.min())
        _, error = self.kinematics.world_inverse(position, rotation.np_from_rpy(rpy), place, tolerance=tolerance)
        foot = int(np.argmax(error.max(axis=0)))
        if error[:, foot].max() > _MISS * self.kinematics.reach[foot]:
            raise ProblemError(
                f"gait of robot '{self.robot.name}', foot '{self.robot.feet[foot].name}': its reference is out of "
                f"reach - got {error[:, foot].max():.3f} m too far at speed {self.gait.speed} m/s, base height "
                f"{self._height:.3f} m, expected a foot within reach of its leg; lower the speed, the height or the "
                "stance time"
            )


def _slope_of(footsteps: Footsteps) -> SlopeReference | None:
    return SlopeReference(footsteps) if isinstance(footsteps, TerrainFootsteps) else None
