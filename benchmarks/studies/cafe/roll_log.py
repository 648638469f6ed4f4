"""What the log of an episode says of a roll: speeds, apex, bar, take-off, landing, and why it failed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from piaffe import models, ocp, simulation
from piaffe.models import base
from piaffe.ocp import rotation

EVERY = 2  # ticks of 2 ms between the states that a bar is compared with
SLIP, TILT = 0.02, 0.7  # a larger slip of a foot at take-off [m], a larger tilt when feet land [rad], are causes


@dataclass(frozen=True)
class Roll:
    """Times of a roll, or of another motion with a flight, in an episode [s].

    Args:
        begins: its start. takes_off: start of its first flight. lands: end of that flight. ends: its end.
    """

    begins: float
    takes_off: float
    lands: float
    ends: float

    @classmethod
    def of(cls, problem: ocp.Problem, number: int) -> Roll:
        """Return the times of a piece of a problem's motion."""
        pieces = problem.motion.pieces
        begins = sum(piece.duration for piece in pieces[:number])
        ends = np.cumsum([phase.duration for phase in pieces[number].phases]) + begins
        first = next(i for i, phase in enumerate(pieces[number].phases) if phase.name == "flight")
        return cls(begins, float(ends[first - 1]), float(ends[first]), float(ends[-1]))


def row_of(episode: simulation.OnlineEpisode, roll: Roll, turn: float) -> dict[str, Any]:
    """Return the figures of an episode, and the cause of a failure or an empty text."""
    t, x, space = episode.times, episode.states, episode.space

    def speed(first: float, last: float) -> float:
        found = episode.tracking(first, last)
        return found.velocity[0] if found and episode.end >= last else np.nan

    def at(time: float) -> np.ndarray:
        return x[min(int(np.searchsorted(t, time)), len(t) - 1)]

    up = at(roll.takes_off)
    landed = [each.late for each in episode.touchdowns if abs(each.time - roll.lands) < 0.1 and each.late is not None]
    tilt = float(
        np.arccos(np.clip(rotation.np_matrix(at(roll.lands)[space.slices[base.orientation]][None])[0, 2, 2], -1, 1))
    )
    before = (t >= roll.begins) & (t < roll.takes_off)
    step = float(t[1] - t[0])
    slip = float((np.where(episode.touching, episode.slips, 0.0)[before].sum(axis=0) * step).max(initial=0.0))
    over = (t >= roll.begins - 0.1) & (t <= roll.ends)
    bar = simulation.Bar(0.0, np.nan, 0.0, -1)
    if not episode.fell:
        along = turn + float(np.interp(roll.begins, t, episode.yaw))
        bar = simulation.highest_bar(models.mujoco_model(episode.robot, hull=True), x[over][::EVERY], along=along)
    share = np.abs(episode.torques) / episode.torque_limit
    touched = {name: time for name, time in episode.collisions.items() if time >= roll.begins}
    row = {
        "ends": episode.fault or ("upright" if episode.upright else "not upright"), "end_s": round(episode.end, 3),
        "before_m_per_s": speed(roll.begins - 0.5, roll.begins), "apex_m": x[:, 2].max(), "bar_m": bar.height,
        "after_m_per_s": speed(roll.ends + 1.0, roll.ends + 2.0) if roll.begins else speed(3.0, 4.0),
        "takeoff_vz_m_per_s": up[space.slices[base.linear_velocity]][2],
        "takeoff_roll_rate": up[space.slices[base.angular_velocity]][0],
        "takeoff_pitch_rate": up[space.slices[base.angular_velocity]][1],
        "takeoff_slip_mm": 1e3 * slip, "landing_late_ms": 1e3 * float(np.median(landed)) if landed else np.nan,
        "landing_tilt_rad": tilt, "torque_share_max": share.max(), "limited_share": episode.limited.any(axis=1).mean(),
        "relaxed_ticks": episode.relaxed, "fallback_ticks": episode.fallbacks,
        "plan_ms_median": 1e3 * np.median(episode.plans.seconds),
    }  # fmt: skip
    told = {
        key: round(float(value), 4) if isinstance(value, float | np.floating) else value for key, value in row.items()
    }
    names = " ".join(f"{name}@{time - roll.begins:.2f}" for name, time in touched.items())
    return {**told, "touched": names, "cause": cause(episode, roll, slip, tilt, touched)}


def cause(episode: simulation.OnlineEpisode, roll: Roll, slip: float, tilt: float, touched: dict[str, float]) -> str:
    """Return the first thing in the log that explains a fall, or an empty text if the robot is upright at the end.

    In the order of time: a fall before the motion, a slip of a foot that takes off, a landing with a tilt, another part
    than a foot that touches the ground in the landing, a fall later.
    """
    if episode.success:
        return ""
    if episode.end < roll.begins:
        return "falls in the gait before"
    if slip > SLIP:
        return f"a foot slips by {1e3 * slip:.0f} mm before the take-off"
    if episode.end < roll.lands:
        return "falls before the landing"
    if tilt > TILT:
        return f"lands with a tilt of {tilt:.2f} rad"
    soon = [name for name, time in touched.items() if abs(time - roll.lands) < 0.15]
    if soon:
        return f"{soon[0]} touches the ground in the landing"
    return "falls after the landing" if episode.end > roll.lands else "falls"
