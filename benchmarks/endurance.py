"""Whether a trot that turns stays the same for an hour: speed, heading, times and memory, by part of the time.

Mini Cheetah trots with rotors and losses of joints, with the problem of ``examples/gaits_mpc.py``. The heading's lag is
how much less it turns than its command, in degrees for each minute. Memory is the resident memory of the process at the
end of a part. The record of the episode is a part of it, and grows with every plan.
"""

from __future__ import annotations

import os
import sys
from math import degrees
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from common import arguments, example, surroundings, tell

from piaffe import simulation, solvers

SETTLE, EVERY = 5.0, 50  # [s]; one tick of so many is recorded
LEAVE_OUT = ("base.position x", "base.position y")
_RECORDED = sys.getsizeof((0.0,) * 4) + 3 * sys.getsizeof(0.0) + 8  # bytes of a plan in the record: a row of numbers


def resident() -> float:
    """Return the resident memory of this process [MB]."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def turning(episode: simulation.OnlineEpisode, first: float, last: float) -> float:
    """Return the slope of the line through the headings between two times [rad/s]; steps of the gait count little."""
    chosen = (episode.times >= first) & (episode.times <= last)
    return float(np.polyfit(episode.times[chosen], episode.yaw[chosen], 1)[0])


class Watch:
    """Notes the resident memory at the ends of the parts of an episode.

    Args:
        ends: of the parts [s].
    """

    def __init__(self, ends: list[float]) -> None:
        self.ends, self.memory = ends, [np.nan] * len(ends)

    def __call__(self, t: float, seconds: float) -> None:
        """Note the memory if a part ends; the episode calls this after every plan."""
        for i, end in enumerate(self.ends):
            if t >= end - 1e-9 and np.isnan(self.memory[i]):
                self.memory[i] = resident()
                print(f"{t:.0f} of {seconds:.0f} s", file=sys.stderr, flush=True)


def part(episode: simulation.OnlineEpisode, first: float, last: float, memory: float) -> dict[str, Any]:
    """Return the figures of a part of an episode, from a time to another [s]."""
    found, plans, rate = episode.tracking(first, last), episode.plans, turning(episode, first, last)
    assert found is not None  # the episode has reached the part
    made = (plans.times >= first) & (plans.times < last)
    ticks = episode.tick_seconds[(episode.times >= first) & (episode.times < last)]
    recorded = np.count_nonzero(plans.times < last) * _RECORDED / 1e6
    return {
        "from_s": first, "to_s": last, "speed_m_per_s": round(found.velocity[0], 5),
        "yaw_rate_rad_per_s": round(rate, 6),
        "heading_lag_deg_per_min": round(60 * degrees(found.commanded_yaw_rate - rate), 3),
        "plan_ms": round(1e3 * float(np.median(plans.seconds[made])), 3),
        "tick_us": round(1e6 * float(np.nanmedian(ticks)), 2),
        "resident_mb": round(memory, 1), "plans_in_record_mb": round(recorded, 1),
    }  # fmt: skip


def main(
    seconds: float = 3600.0, yaw_rate: float = 0.3, parts: int = 6, gait: str = "trot", json: bool = False,
    save: bool = False,
) -> dict[str, Any]:  # fmt: skip
    """Print and return speed, yaw rate, heading lag, times and memory by part of the time."""
    module = example("gaits_mpc")
    mpc = solvers.RecedingHorizon(getattr(module, gait))
    low = solvers.Vwbc(mpc.plan(mpc.initial, 0.0), leave_out=LEAVE_OUT)
    edges = [float(each) for each in np.linspace(SETTLE, seconds, parts + 1)]
    watch, began = Watch(edges[1:]), perf_counter()
    episode = simulation.run_online(
        mpc, low, simulation.Plant(module.robot, friction=0.7), seconds=seconds, every=EVERY, progress=watch,
        commands=simulation.parse_commands(f"yaw={yaw_rate}@1"),
    )  # fmt: skip
    reached = [i for i in range(parts) if edges[i] < episode.end - 1.0]
    rows = [part(episode, edges[i], min(edges[i + 1], episode.end), watch.memory[i]) for i in reached]
    lag = round(60 * degrees(yaw_rate - turning(episode, SETTLE, seconds)), 4) if reached else None
    results = {
        "benchmark": "endurance", "gait": gait, "seconds": seconds, "commanded_speed_m_per_s": module.SPEED,
        "commanded_yaw_rate_rad_per_s": yaw_rate, "upright": episode.success, "end_s": episode.end,
        "fault": episode.fault, "fallbacks": episode.fallbacks, "heading_lag_deg_per_min": lag,
        "wall_s": round(perf_counter() - began, 1), "parts": rows, **surroundings(),
    }  # fmt: skip
    state = "upright" if episode.success else episode.fault
    lines = [
        f"{gait}, {seconds:g} s at {module.SPEED} m/s and {yaw_rate} rad/s: {state} after {episode.end:g} s",
        f"the heading lags behind by {lag} degrees a minute, over all of it",
        f"{'from':>8}{'to [s]':>8}{'m/s':>9}{'rad/s':>10}{'°/min':>9}{'plan ms':>9}{'tick µs':>9}{'MB':>8}"
        f"{'record':>8}",
    ]
    for row in rows:
        lines.append(
            f"{row['from_s']:8.0f}{row['to_s']:8.0f}{row['speed_m_per_s']:9.4f}{row['yaw_rate_rad_per_s']:10.5f}"
            f"{row['heading_lag_deg_per_min']:9.3f}{row['plan_ms']:9.2f}{row['tick_us']:9.1f}"
            f"{row['resident_mb']:8.1f}{row['plans_in_record_mb']:8.1f}"
        )
    tell(results, lines, json=json, save=save)
    return results


if __name__ == "__main__":
    parser = arguments(__doc__ or "", 1)
    parser.add_argument("seconds", type=float, nargs="?", default=3600.0, help="simulated time")
    parser.add_argument("--yaw-rate", type=float, default=0.3, help="commanded, from 1 s on [rad/s]")
    parser.add_argument("--parts", type=int, default=6, help="of the time, each with its figures")
    parser.add_argument("--gait", default="trot", help="trot, pace, bound, flying_trot or pronk")
    options = vars(parser.parse_args())
    options.pop("repeats")  # the episode is deterministic
    main(**options)
