"""The record of a planner, a low level and a plant in closed loop, and its figures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piaffe.models import Robot, base, joints
from piaffe.ocp import Manifold, rotation

from .contacts import Touchdown, touchdowns
from .tracking import Tracking, heading, in_heading, stretches, tracked
from .wall_clock import Deadlines

Array = NDArray[np.float64]

UPRIGHT = 0.7
"""At the end, the base's z axis of an upright robot is nearer to the vertical than this [rad]."""


@dataclass(frozen=True, eq=False)
class PlanLog:
    """What is known of the P plans of an episode.

    Args:
        times: of the states from which they were made (P,) [s].
        seconds: time of the thread's processor that each took (P,) [s].
        iterations: of the planner (P,); NaN where a plan does not say.
        statuses: of the plans; empty where a plan does not say.
        acting: time from which each plan acted (P,) [s].
        motions: the motion of each plan, of several, see ``solvers.Motions``; empty for planners of one.
        requests: per plan, the motion that was asked for and had not begun, or an empty text; empty as ``motions``.
    """

    times: Array
    seconds: Array
    iterations: Array
    statuses: tuple[str, ...]
    acting: Array = field(default_factory=lambda: np.zeros(0))
    motions: tuple[str, ...] = ()
    requests: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class OnlineEpisode:
    """The record of an episode with T ticks, to its end or to a fall. NaN stands for what is not known.

    Args:
        robot: the robot. space: the space of its states.
        seconds: requested duration [s].
        times: of the ticks (T,) [s].
        states: of the plant (T, nx). estimates: what the low level was given (T, nx).
        controls: torques that the low level asked for (T, nu) [Nm].
        torques: that acted in the last step before the next tick (T, nu) [Nm].
        limited: whether a limit of the actuators was active at that step (T, nu).
        torque_limit: of the plant (nu,) [Nm].
        forces: on the feet in world axes in the step before the tick (T, nf, 3) [N].
        slips: speed of each foot's point of contact along the ground (T, nf) [m/s].
        planned: contacts in the plan, 1 or 0 (T, nf).
        commands: commanded velocity ahead and to the left [m/s] and yaw rate [rad/s] (T, 3).
        ages: time since the state of the acting plan (T,) [s].
        tick_seconds: time of the thread's processor that each tick took (T,) [s].
        qp_iterations: of the low level (T,).
        plans: the plans.
        collisions: parts that are no feet and touched the ground at ticks, with the time of the first contact [s].
        last: the last state (nx,).
        end: time of the last state [s].
        fault: why the episode ended before its time; empty if it did not.
        least_force: a foot with at least this normal force is on the ground [N].
        fallbacks: number of ticks whose program had no solution. relaxed: of ticks in which limits on contact forces
            gave way to find one. damped: of ticks with numbers that were not finite.
        deadlines: those of an episode against the real clock; else None.
    """

    robot: Robot
    space: Manifold
    seconds: float
    times: Array
    states: Array
    estimates: Array
    controls: Array
    torques: Array
    limited: NDArray[np.bool_]
    torque_limit: Array
    forces: Array
    slips: Array
    planned: Array
    commands: Array
    ages: Array
    tick_seconds: Array
    qp_iterations: Array
    plans: PlanLog
    collisions: Mapping[str, float]
    last: Array
    end: float
    fault: str
    least_force: float
    fallbacks: int
    relaxed: int
    damped: int
    deadlines: Deadlines | None = None

    @property
    def fell(self) -> bool:
        """Whether the episode ended before its time."""
        return bool(self.fault)

    @property
    def upright(self) -> bool:
        """Whether the base is upright in the last state, within 0.7 rad."""
        up = rotation.np_matrix(self.last[self.space.slices[base.orientation]][None])[0, 2, 2]
        return bool(up > np.cos(UPRIGHT))

    @property
    def success(self) -> bool:
        """Whether the robot did not fall, and is upright at the end."""
        return not self.fell and self.upright

    @cached_property
    def motions(self) -> tuple[tuple[float, str], ...]:
        """The motions in their order, each with the time from which it acted [s]; empty for planners of one."""
        found: list[tuple[float, str]] = []
        for time, motion in zip(self.plans.acting, self.plans.motions, strict=False):
            if not found or found[-1][1] != motion:
                found.append((float(time), motion))
        return tuple(found)

    @cached_property
    def touching(self) -> NDArray[np.bool_]:
        """Which feet were on the ground (T, nf)."""
        return np.asarray(self.forces[:, :, 2] >= self.least_force)

    @cached_property
    def touchdowns(self) -> tuple[Touchdown, ...]:
        """The planned touchdowns, and how late they were; empty if the plan's contacts are not known."""
        return touchdowns(self.times, self.planned, self.touching, self.robot.foot_names)

    @cached_property
    def yaw(self) -> Array:
        """Heading of the base, full turns included (T,) [rad]."""
        return heading(self.states[:, self.space.slices[base.orientation]])

    @cached_property
    def velocity(self) -> Array:
        """Velocity of the base ahead and to the left (T, 2) [m/s]."""
        return in_heading(self.yaw, self.states[:, self.space.slices[base.linear_velocity]])

    def tracking(self, first: float = -np.inf, last: float = np.inf) -> Tracking | None:
        """Return how the base followed its command from a time to another [s]; None if there is no tick between."""
        chosen = (self.times >= first - 1e-9) & (self.times <= last + 1e-9)
        if not chosen.any():
            return None
        return tracked(self.times[chosen], self.yaw[chosen], self.velocity[chosen], self.commands[chosen])

    def settled(self, settle: float = 2.0) -> tuple[Tracking, ...]:
        """Return how the base followed each constant command, without its beginning; empty without commands.

        Args:
            settle: time that is left out after each change of the command [s]. A gait has a ramp of 1 s by default.
        """
        parts = stretches(self.times, self.commands, settle)
        return tuple(tracked(self.times[p], self.yaw[p], self.velocity[p], self.commands[p]) for p in parts)

    def excess(self) -> dict[str, float]:
        """Return by how much limits of the robot were exceeded at most; 0 if never.

        ``torque`` is that of the torques which were asked for [Nm], ``angle`` [rad] and ``speed`` [rad/s] are of the
        joints.
        """
        q, v = (self.states[:, self.space.slices[each]] for each in (joints.position, joints.velocity))
        robot = self.robot
        return {
            "torque": float(np.max(np.abs(self.controls) - self.torque_limit, initial=0.0)),
            "angle": float(np.max(np.maximum(q - robot.joint_upper, robot.joint_lower - q), initial=0.0)),
            "speed": float(np.max(np.abs(v) - robot.joint_speed_limit, initial=0.0)),
        }

    def summary(self, settle: float = 0.0) -> dict[str, Any]:
        """Return the figures of the episode, as values for JSON; None stands for what is not known.

        Args:
            settle: the figures of tracking and slip leave out this time at the start [s].
        """
        begin = (float(self.times[0]) if len(self.times) else 0.0) + settle
        tracking, late = self.tracking(begin), [each.late for each in self.touchdowns if each.late is not None]
        after = self.times >= begin
        exact = {
            "success": self.success, "upright": self.upright, "fell": self.fell, "fault": self.fault or None,
            "end_s": self.end, "seconds": self.seconds, "ticks": len(self.times), "plans": len(self.plans.times),
            "fallbacks": self.fallbacks, "relaxed": self.relaxed, "damped": self.damped,
            "collisions": dict(self.collisions),
            "touchdowns": len(self.touchdowns), "touchdowns_without": len(self.touchdowns) - len(late),
            "deadlines": None if self.deadlines is None else asdict(self.deadlines),
            "motions": [[time, name] for time, name in self.motions],
            "plan_statuses": {name: self.plans.statuses.count(name) for name in dict.fromkeys(self.plans.statuses)},
        }  # fmt: skip
        figures = {
            **({} if tracking is None else {
                "speed_m_per_s": tracking.speed, "speed_error": tracking.speed_error,
                "yaw_rate": tracking.yaw_rate, "yaw_rate_error": tracking.yaw_rate_error,
                "rms_velocity_error_m_per_s": tracking.rms_velocity,
            }),
            **{f"{name}_excess": value for name, value in self.excess().items()},
            "limited": float(np.mean(np.any(self.limited, axis=1))) if len(self.times) else np.nan,
            "slip_mean_m_per_s": _mean(self.slips[after]), "slip_max_m_per_s": _largest(self.slips[after]),
            "touchdown_late_ms_median": 1e3 * _quantile(late, 50),
            "touchdown_late_ms_p5": 1e3 * _quantile(late, 5), "touchdown_late_ms_p95": 1e3 * _quantile(late, 95),
            "plan_ms_median": 1e3 * _quantile(self.plans.seconds, 50),
            "plan_ms_p99": 1e3 * _quantile(self.plans.seconds, 99),
            "iterations_mean": _mean(self.plans.iterations),
            "plan_age_ms_max": 1e3 * _largest(self.ages),
            "tick_us_median": 1e6 * _quantile(self.tick_seconds, 50),
            "tick_us_p99": 1e6 * _quantile(self.tick_seconds, 99),
            "qp_iterations_mean": _mean(self.qp_iterations), "qp_iterations_max": _largest(self.qp_iterations),
        }  # fmt: skip
        return {**exact, **{name: value if np.isfinite(value) else None for name, value in figures.items()}}


def _known(values: Any) -> Array:
    numbers = np.asarray(values, dtype=float).ravel()
    return np.asarray(numbers[np.isfinite(numbers)])


def _mean(values: Any) -> float:
    return float(np.mean(_known(values))) if len(_known(values)) else float("nan")


def _largest(values: Any) -> float:
    return float(np.max(_known(values), initial=-np.inf))


def _quantile(values: Any, percent: float) -> float:
    return float(np.percentile(_known(values), percent)) if len(_known(values)) else float("nan")
