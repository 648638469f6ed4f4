"""Rolls and a front flip in a run, over seeds: one row a seed, tables, figures. A study continues where it stopped.

    python benchmarks/studies/cafe/rolls.py running_roll --seeds 100

A seed draws masses within 5 %, friction between 0.5 and 0.8, the first state and the noise of the sensors. Plans act
20 ms late. Rows are in ``<task>/episodes.csv``, the table over all seeds in ``<task>/summary.md``.
"""

from __future__ import annotations

import argparse
import csv
import hashlib
import sys
from dataclasses import dataclass
from importlib import import_module
from io import StringIO
from math import pi
from pathlib import Path
from types import ModuleType
from typing import Any

from roll_log import Roll, row_of

from piaffe import ocp, simulation
from piaffe.errors import FileFormatError
from piaffe.files import write_whole

HERE = Path(__file__).resolve().parent
EXAMPLES = HERE.parents[2] / "examples"
ASSETS = HERE.parents[2] / "docs" / "assets"
AT_A_TIME = 5  # seeds that one planner runs before their rows are written


def example(name: str) -> ModuleType:
    """Return a file of ``examples/`` as a module; examples build on each other."""
    if str(EXAMPLES) not in sys.path:
        sys.path.insert(0, str(EXAMPLES))
    return import_module(name)


@dataclass(frozen=True)
class Task:
    """A task of the study.

    Args:
        title: what it is.
        files: the examples that declare it; the last one has its ``problem``.
        gait: argument of ``problem``, if it has one.
        speed: of the gait [m/s].
        least: least values of a success, by column.
        number: of the motion among the pieces.
        seconds: duration of an episode [s].
        turn: from the robot's heading to the direction of the bar [rad].
    """

    title: str
    files: tuple[str, ...]
    speed: float
    least: dict[str, float]
    gait: str = ""
    number: int = 1
    seconds: float = 6.0
    turn: float = 0.0

    def problem(self) -> ocp.Problem:
        """Return its problem; examples keep the last one."""
        declared: ocp.Problem = example(self.files[-1]).problem(*([self.gait] if self.gait else []))
        return declared


def _runs(speed: float) -> dict[str, float]:
    return {"before_m_per_s": 0.8 * speed, "after_m_per_s": 0.8 * speed}


_RUN = ("roll_then_pace", "running_roll")
TASKS = {
    "inplace_roll": Task(
        "Task 1: a roll in place, a hop, then a pace at 0.5 m/s", ("roll_then_pace",), 0.5,
        {"after_m_per_s": 0.4}, number=0, seconds=4.0,
    ),
    "trot_roll_trot": Task(
        "Task 2: trot, full stance, roll, trot at 0.6 m/s", (*_RUN, "run_roll_run_mpc"), 0.6, _runs(0.6), "trot",
    ),
    "pace_roll_pace": Task(
        "Task 2: pace, full stance, roll, pace at 0.6 m/s", (*_RUN, "run_roll_run_mpc"), 0.6, _runs(0.6), "pace",
    ),
    "running_roll": Task(
        "Task 3: pace at 0.8 m/s, roll without a full stance before it, pace", _RUN, 0.8,
        {"before_m_per_s": 0.7, "apex_m": 0.50, "bar_m": 0.35, "after_m_per_s": 0.64},
    ),
    "front_flip_run": Task(
        "A front flip in a run at 0.6 m/s", (*_RUN, "front_flip_run"), 0.6, _runs(0.6),
        turn=pi / 2,
    ),
}  # fmt: skip


def digest(task: Task) -> str:
    """Return a digest of the examples that declare a task; rows of other settings are not mixed with these."""
    text = b"".join((EXAMPLES / f"{name}.py").read_bytes() for name in task.files)
    return hashlib.sha256(text).hexdigest()[:12]


def rows_so_far(path: Path, settings: str) -> list[dict[str, str]]:
    """Return the rows of a file.

    Raises:
        FileFormatError: they are of other settings.
    """
    if not path.exists():
        return []
    rows = list(csv.DictReader(StringIO(path.read_text(encoding="utf-8"))))
    if any(row["settings"] != settings for row in rows):
        raise FileFormatError(
            f"file '{path.name}': its rows are of other settings - got {rows[0]['settings']}, expected {settings}; "
            "move it away, or go back to the examples of its commit"
        )
    return rows


def write_rows(path: Path, rows: list[dict[str, Any]]) -> None:
    """Write all rows, atomically, in the order of seeds."""
    text = StringIO()
    writer = csv.DictWriter(text, fieldnames=list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(sorted(rows, key=lambda row: int(row["seed"])))
    write_whole(path, text.getvalue().encode())


def measured(task: Task, seed: int, episode: simulation.OnlineEpisode) -> dict[str, Any]:
    """Return the row of a seed's episode."""
    roll = Roll.of(task.problem(), task.number)
    row = row_of(episode, roll, task.turn)
    drawn = simulation.Variation().numbers(simulation.Plant(episode.robot).links, seed)
    base, other = list(drawn["mass_scale"].values())[:2]
    missed = [name for name, least in task.least.items() if not row[name] >= least]
    cause = row.pop("cause") or (f"{missed[0]} is too small" if missed else "")
    head = {"seed": seed, "success": int(not cause), "cause": cause, "friction": round(drawn["friction"], 3)}
    return {**head, "base_mass": round(base, 3), "other_masses": round(other, 3), **row, "settings": digest(task)}


def summary(task: Task, rows: list[dict[str, Any]]) -> str:
    """Return the table of a task's rows: successes, medians, percentiles, and failures with their causes."""
    from numpy import nanpercentile

    good = sum(int(row["success"]) for row in rows)
    lines = [f"# {task.title}", "", f"{good} of {len(rows)} seeds succeed.", ""]
    if task.least:
        least = ", ".join(f"{name} at least {value:g}" for name, value in task.least.items())
        lines += [f"A success stays up, is upright at the end, and has {least}.", ""]
    lines += ["| | median | 5 % | 95 % |", "| --- | --- | --- | --- |"]
    skipped = ("seed", "success", "cause", "settings", "ends", "touched")
    for name in (each for each in rows[0] if each not in skipped):
        values = [float(row[name]) for row in rows if row[name] not in ("", "nan", None)]
        if values:
            lines.append(f"| {name} | " + " | ".join(f"{v:.3g}" for v in nanpercentile(values, [50, 5, 95])) + " |")
    failed = [row for row in rows if not int(row["success"])]
    if failed:
        lines += ["", "| seed | ends | cause | friction | touched |", "| --- | --- | --- | --- | --- |"]
        lines += [f"| {r['seed']} | {r['ends']} | {r['cause']} | {r['friction']} | {r['touched']} |" for r in failed]
    return "\n".join([*lines, ""])


def main(name: str, seeds: int = 20, first: int = 0, figures: bool = False) -> float:
    """Run the seeds of a task that have no row yet; return the share of successes."""
    if figures:
        from piaffe.viz import gl

        gl.prepare()  # before MuJoCo is imported
    task, folder = TASKS[name], HERE / name
    path = folder / ("episodes.csv" if first < 500 else "trial.csv")
    rows: list[dict[str, Any]] = list(rows_so_far(path, digest(task)))
    done = {int(row["seed"]) for row in rows}
    for begin in range(first, first + seeds, AT_A_TIME):
        chosen = range(begin, min(begin + AT_A_TIME, first + seeds))
        if done.issuperset(chosen):
            continue
        for seed, episode in zip(
            chosen, example("roll_then_pace").run(task.problem(), chosen, task.seconds), strict=True
        ):
            if seed not in done:
                rows.append(measured(task, seed, episode))
                print({key: value for key, value in rows[-1].items() if key != "settings"}, flush=True)
        write_rows(path, rows)
    text = summary(task, rows)
    if first < 500:
        write_whole(folder / "summary.md", text.encode())
    print(text)
    if figures:
        from roll_figures import draw

        episode = example("roll_then_pace").run(task.problem(), range(first, first + 1), task.seconds)[0]
        draw(ASSETS, f"cafe_{name}", task, episode, first)
    return sum(int(row["success"]) for row in rows) / len(rows)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("name", choices=TASKS)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=0, help="the first seed; from 500 on, rows go to trial.csv")
    parser.add_argument("--figures", action="store_true", help="draw the first seed")
    main(**vars(parser.parse_args()))
