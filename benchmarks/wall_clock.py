"""Run Mini Cheetah's trot against the real clock: plans in a thread of C, ticks 500 or 1000 times a second, MuJoCo.

Each row is one episode with a plan rate. A plan is missed if it is not complete a latency, which is the period, after
its state; a tick is late if its torques are not ready before the next tick is due. The cause of a late tick is the
largest of these times within the last four steps: a sleep that was too long, a tick, a step of the simulator; and
whether the system took the processor away, or the garbage collector ran. What the machine allows is measured first: a
loop that only sleeps a millisecond, with the same priority.
"""

from __future__ import annotations

import gc
import resource
from collections import Counter
from time import perf_counter, sleep
from typing import Any

import numpy as np
from cascade import HEAD, declaration
from common import arguments, surroundings, tell

from piaffe import models, ocp, simulation, solvers

SPEED = 0.5  # [m/s]
RATES = ((50, 0.01, 0.002), (100, 0.01, 0.002), (200, 0.005, 0.001))
"""Plans per second, time step of the whole-body stages [s], time between ticks [s]; periods are multiples of both."""
CAUSES = ("sleep", "tick", "plant")


class Watch(simulation.WallClock):
    """A real clock that notes at every step when it was due, when the thread slept and woke, and what happened then."""

    def __init__(self, priority: int) -> None:
        super().__init__(priority=priority)
        self.rows: list[tuple[float, ...]] = []
        self.collections: list[tuple[float, float]] = []

    def __enter__(self) -> Watch:
        super().__enter__()
        gc.callbacks.append(self._collected)
        return self

    def __exit__(self, *error: Any) -> None:
        gc.callbacks.remove(self._collected)
        super().__exit__(*error)

    def _collected(self, phase: str, info: dict[str, int]) -> None:
        if phase == "start":
            self._began = perf_counter()
        else:
            self.collections.append((self._began, perf_counter()))

    def reach(self, t: float) -> None:
        """Wait, and note when."""
        called = perf_counter()
        super().reach(t)
        switches = resource.getrusage(resource.RUSAGE_THREAD).ru_nivcsw
        self._row = [(self._zero or 0.0) + t, called, perf_counter(), np.nan, switches]
        self.rows.append(self._row)  # type: ignore[arg-type]

    def ticked(self, t: float, tick: float) -> None:
        """Note when the torques were ready."""
        super().ticked(t, tick)
        self._row[3] = perf_counter()

    def causes(self, tick: float) -> dict[str, int]:
        """Return the number of late ticks by cause."""
        due, called, woke, ticked, switches = np.array(self.rows).T
        late = np.flatnonzero(ticked - due > tick)
        slept = woke - np.maximum(called, due)
        acted = np.where(np.isnan(ticked), 0.0, ticked - woke)
        stepped = np.append(called[1:] - np.where(np.isnan(ticked), woke, ticked)[:-1], 0.0)
        found: Counter[str] = Counter()
        for i in late:
            part = slice(max(i - 4, 0), i + 1)
            longest = int(np.argmax([slept[part].max(), acted[part].max(), stepped[part].max()]))
            name = CAUSES[longest]
            if longest and switches[i] > switches[part][0]:
                name += ", processor taken away"
            if any(begin < ticked[i] and end > due[part][0] and end - begin > 5e-4 for begin, end in self.collections):
                name += ", garbage collector"
            found[name] += 1
        return dict(found)


def long_sleeps(seconds: float, priority: int) -> dict[str, Any]:
    """Return how often and by how much a loop that only sleeps is late by more than a tick."""
    late: list[float] = []
    steps = round(seconds / 1e-3)
    with simulation.WallClock(priority=priority) as clock:
        zero = perf_counter()
        for k in range(steps):
            due = zero + 1e-3 * k
            sleep(max(due - perf_counter(), 0.0))
            if (off := perf_counter() - due) > RATES[0][2]:
                late.append(off)
                zero += off  # the next ones are not late because of this one
        given = clock.real_time
    return {"sleeps": steps, "late": len(late), "latest_ms": round(1e3 * max(late, default=0.0), 2), "real_time": given}


def problem(dt: float) -> ocp.Problem:
    """Return the trot of ``plan_tick.py`` with another time step of the whole-body stages [s]."""
    body, srb, walking, effort, limits = declaration()
    schedule = body.over(HEAD, dt=dt).without(effort) + srb.over(0.50, dt=0.05).without(limits)
    trot = models.gaits.trot(speed=SPEED, velocity_gain=0.05)
    return ocp.Problem(trot, schedule, walking + effort, limits, initial=body.state(joints="stand"))


def episode(rate: int, dt: float, tick: float, seconds: float, priority: int) -> dict[str, Any]:
    """Return the figures of one episode."""
    mpc = solvers.RecedingHorizon(problem(dt), period=1 / rate, latency=1 / rate)
    low = solvers.Vwbc(mpc.plan(mpc.initial, 0.0), leave_out=("base.position x", "base.position y"))
    clock = Watch(priority)
    plant = simulation.Plant(models.load("mini_cheetah"), friction=0.7)
    made = simulation.run_online(
        mpc, low, plant, seconds=seconds, tick=tick, latency=1 / rate, every=5, wall_clock=clock
    )
    deadlines = made.deadlines
    assert deadlines is not None  # the clock is real
    plans, ticks = made.plans.seconds, made.tick_seconds
    return {
        "plans_per_s": rate, "whole_body_dt_s": dt, "tick_s": tick, "seconds": made.end, "upright": made.success,
        "plans": deadlines.plans, "missed_plans": deadlines.missed_plans, "ticks": deadlines.ticks,
        "late_ticks": deadlines.missed_ticks, "late_percent": round(100 * deadlines.missed_ticks / deadlines.ticks, 3),
        "latest_ms": round(1e3 * deadlines.latest, 2), "real_time": deadlines.real_time, "causes": clock.causes(tick),
        "plan_ms": [round(1e3 * float(np.percentile(plans[1:], q)), 2) for q in (50, 99, 100)],
        "tick_us": [round(1e6 * float(np.nanpercentile(ticks, q)), 1) for q in (50, 99)],
    }  # fmt: skip


def main(
    repeats: int = 1, seconds: float = 60.0, priority: int = 2, json: bool = False, save: bool = False
) -> dict[str, Any]:
    """Print and return missed plans and late ticks for each plan rate."""
    alone = long_sleeps(seconds, priority)
    rows = [episode(*each, seconds, priority) for _ in range(repeats) for each in RATES]
    results = {"benchmark": "wall_clock", "seconds": seconds, "sleeps": alone, "rows": rows, **surroundings()}
    lines = [
        f"trot against the real clock, {seconds:g} s; real-time priority: {'yes' if alone['real_time'] else 'no'}",
        f"only sleeps of 1 ms: {alone['late']} of {alone['sleeps']} late by 2 ms, latest {alone['latest_ms']} ms",
        f"{'plans/s':>8}{'ticks/s':>8}{'missed':>14}{'late ticks':>18}{'latest ms':>11}",
    ]
    for row in rows:
        late = f"{row['late_ticks']:9} = {row['late_percent']:.3f} %{row['latest_ms']:11.2f}"
        lines.append(
            f"{row['plans_per_s']:8}{1 / row['tick_s']:8.0f}{row['missed_plans']:6} of {row['plans']:5}{late}  "
            f"plan {row['plan_ms']} ms, tick {row['tick_us']} µs, "
            f"{'upright' if row['upright'] else 'fell'}, {row['causes'] or 'none late'}"
        )
    tell(results, lines, json=json, save=save)
    return results


if __name__ == "__main__":
    parser = arguments(__doc__ or "", 1)
    parser.add_argument("--seconds", type=float, default=60.0, help="of each episode")
    parser.add_argument("--priority", type=int, default=2, help="real-time priority of the ticks; 0 for none")
    main(**vars(parser.parse_args()))
