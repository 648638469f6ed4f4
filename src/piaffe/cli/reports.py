"""Output of the commands: summaries, verifications and checks, as tables and as JSON."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.status import Status
from rich.table import Table

if TYPE_CHECKING:
    from piaffe.ocp import (
        CompiledProblem,
        ConstraintReport,
        CostReport,
        DerivativeCheck,
        Kind,
        Trajectory,
        Verification,
        Violation,
    )
    from piaffe.simulation import Execution
    from piaffe.solvers import Solution

KINDS: tuple[Kind, ...] = ("defect", "equality", "inequality", "slip", "height", "flight")
_LOG_WIDTH = 150
_OVER_SPEED = 1.01  # part of a joint's speed limit above which a note says so
_ADVICE: dict[Kind, str] = {
    "defect": "solve again with this file; a solution of another problem, or one that has not converged, has defects",
    "equality": "solve until it converges",
    "inequality": "solve until it converges, with this file",
    "slip": "a smaller dt, or the model's default integrator",
    "height": "look at the initial state and the keyframes before the touchdown; a smaller dt",
    "flight": "a smaller dt, or torques that change less: a larger weight on joints.torque",
}


def terminal(*, stderr: bool = False) -> Console:
    """Return the console for the output: as wide as the terminal, or, in a log, wide enough for the tables."""
    console = Console(stderr=stderr, highlight=False)
    return console if console.is_terminal else Console(stderr=stderr, highlight=False, width=_LOG_WIDTH)


def working(what: str) -> Status:
    """Return a context that shows on standard error what is done, if that is a terminal."""
    return Console(stderr=True).status(what)


def plain(text: str) -> str:
    """Return text with escaped brackets, so that it contains no markup."""
    return text.replace("[", r"\[")


def as_json(values: dict[str, Any]) -> str:
    """Return an object as one line of JSON; numbers that are not finite become null."""

    def clean(value: Any) -> Any:
        if isinstance(value, float) and not math.isfinite(value):
            return None
        if isinstance(value, dict):
            return {key: clean(entry) for key, entry in value.items()}
        return [clean(entry) for entry in value] if isinstance(value, list | tuple) else value

    return json.dumps(clean(values))


# ---- solve


def solution_values(solution: Solution, wall_s: float) -> dict[str, Any]:
    """Return the values that ``solve --json`` prints.

    Args:
        solution: the result.
        wall_s: time from the loaded problem to the result, compilation included [s].
    """
    return {
        "status": solution.status.name, "converged": solution.converged, "iterations": solution.iterations,
        "cost": solution.cost, "max_defect": solution.max_defect, "max_equality": solution.max_equality,
        "max_inequality": solution.max_inequality, "wall_s": wall_s, "compile_s": solution.compile_s,
        "solve_s": solution.wall_s, "advice": solution.status.advice, "term_costs": dict(solution.term_costs),
    }  # fmt: skip


def print_solution(console: Console, solution: Solution, wall_s: float) -> None:
    """Print a summary: status, cost of each term, worst violation of each constraint."""
    colour = "green" if solution.converged else "red"
    console.print(f"[bold {colour}]{solution.status.name}[/] {solution.status.advice.partition(': ')[2]}")
    console.print(
        f"{solution.iterations} iterations in {solution.wall_s:.2f} s; functions built in {solution.compile_s:.2f} s, "
        f"solver compiled or loaded in {wall_s - solution.wall_s - solution.compile_s:.2f} s, {wall_s:.2f} s in all; "
        f"cost {solution.cost:.6g}",
        soft_wrap=True,
    )
    table = new_table("term", ">cost", ">share")
    total = sum(solution.term_costs.values()) or 1.0
    for name, cost in sorted(solution.term_costs.items(), key=lambda item: -item[1]):
        table.add_row(name, f"{cost:.5g}", f"{100 * cost / total:.1f} %")
    console.print(table)
    table = new_table("constraint", "kind", ">worst", "unit", "where")
    for row in solution.violations:
        met = row.amount <= 1e-3
        amount = f"{row.amount:.1e}" if met else f"[red]{row.amount:.2e}[/]"
        table.add_row(row.name, row.kind, amount, row.unit, f"{row.phase}, node {row.node}" if row.amount > 0 else "")
    console.print(table)
    print_impacts(console, solution)
    if not solution.converged:
        console.print(solution.explain())


def print_impacts(console: Console, solution: Solution) -> None:
    """Print the impulses of the feet that land: the largest and smallest vertical one, and the largest ratio."""
    from piaffe.models import measures

    found = measures.impacts(solution.trajectory)
    if not found:
        return
    table = new_table("impact after", ">at s", ">feet", ">smallest Λz", ">largest Λz", ">max(|Λx|, |Λy|)/Λz", "unit")
    for impact in found:
        normal = impact.normal
        table.add_row(
            plain(impact.phase), f"{impact.time:.2f}", str(len(normal)), f"{normal.min():.3g}", f"{normal.max():.3g}",
            f"{impact.ratio:.3g}", "N s",
        )  # fmt: skip
    console.print(table)


# ---- verify


def verification_values(compiled: CompiledProblem, trajectory: Trajectory, result: Verification) -> dict[str, Any]:
    """Return the values that ``verify --json`` prints."""
    from piaffe.models import measures

    turns = measures.turns(trajectory)
    worst, fastest = result.worst(), measures.fastest_joint(compiled, trajectory)
    return {
        "verified": result.holds, "max_defect": result.max_defect, "max_equality": result.max_equality,
        "max_inequality": result.max_inequality, "max_slip_m": result.max_slip, "max_height_m": result.max_height,
        "max_flight_m": result.max_flight, "turns_rad": None if turns is None else turns.tolist(),
        "turns_x_rad": None if turns is None else float(turns[0]), "apex_m": measures.apex(trajectory),
        "min_foot_z_m": measures.lowest_foot(compiled, trajectory),
        "fastest_joint": None if fastest is None else {**asdict(fastest), "ratio": fastest.ratio},
        "duration_s": trajectory.duration, "worst": _violation_values(worst),
        **{f"worst_{kind}": _violation_values(result.worst(kind)) for kind in KINDS},
    }  # fmt: skip


def _violation_values(worst: Violation | None) -> dict[str, Any] | None:
    """Return what a verification computes of a violation: it has no multipliers."""
    shown = ("kind", "name", "phase", "node", "amount", "unit", "source")
    return None if worst is None else {key: getattr(worst, key) for key in shown}


def print_verification(console: Console, result: Verification, values: dict[str, Any]) -> None:
    """Print a verification: the worst row of each kind, its bound, and the rotation and heights of the motion."""
    from piaffe.ocp import BOUNDS

    table = new_table("kind", ">worst", ">bound", "row", "phase", ">node", "unit", "declared")
    for kind in KINDS:
        row = result.worst(kind)
        if row is not None:
            colour = "green" if row.ratio <= 1 else "red"
            table.add_row(
                kind, f"[{colour}]{row.amount:.2e}[/]", f"{BOUNDS[kind]:.3g}", row.name, row.phase, str(row.node),
                row.unit, row.source,
            )  # fmt: skip
    console.print(table)
    if values["turns_rad"] is not None:
        x, y, z = values["turns_rad"]
        console.print(
            f"turned {x:.3f}, {y:.3f}, {z:.3f} rad about its own x, y, z; apex {values['apex_m']:.3f} m",
            highlight=False,
        )
    if values["min_foot_z_m"] is not None:
        console.print(f"lowest foot {values['min_foot_z_m']:+.4f} m above the terrain")
    fastest = values["fastest_joint"]
    if fastest is not None and fastest["ratio"] > _OVER_SPEED:
        console.print(
            f"[yellow]note:[/] joint {plain(fastest['name'])} reaches {fastest['speed']:.3g}, {fastest['ratio']:.2g} "
            f"times the robot's limit of {fastest['limit']:.3g}; models.joint_speed_limits() in the problem keeps it",
            soft_wrap=True,
        )
    beyond = [row for row in map(result.worst, KINDS) if row is not None and row.ratio > 1]
    if not beyond:
        console.print("[bold green]verified[/]")
    for row in beyond:
        console.print(
            f"[bold red]not within the bounds[/]: {row.kind}, {row.ratio:.2g} times its bound; {_ADVICE[row.kind]}",
            soft_wrap=True,
        )


def simulation_values(execution: Execution) -> dict[str, Any]:
    """Return the values that ``verify --simulate --json`` prints under ``simulation``."""
    return {
        "seeds": len(execution.trials), "followed": execution.followed, "duration_s": execution.duration,
        "friction": execution.friction, "perturbation": asdict(execution.perturbation),
        "error_median_m": execution.median_error, "error_worst_m": execution.worst_error,
        "trials": [
            {
                "seed": trial.seed, "followed": trial.followed, "lost_at_s": trial.lost_at,
                "error_m": trial.position, "error_rad": trial.orientation, "saturated": trial.saturated,
                "deviations": [
                    {
                        "what": each.what, "name": each.name, "time_s": each.time, "phase": each.phase,
                        "amount": each.amount, "text": str(each),
                    }
                    for each in trial.deviations
                ],
            }
            for trial in execution.trials
        ],
    }  # fmt: skip


def print_execution(console: Console, execution: Execution) -> None:
    """Print a simulation: how many starts followed, why others were lost, and the most frequent departures."""
    table = new_table("departure from the plan, largest", "phase", ">seeds", ">at s")
    for each, count in execution.frequent():
        table.add_row(str(each), plain(each.phase), f"{count} of {len(execution.trials)}", f"{each.time:.2f}")
    if table.row_count:
        console.print(table)
    for trial in execution.trials:
        if not trial.followed:
            console.print(plain(str(trial)), style="red", highlight=False, soft_wrap=True)
    colour = "green" if execution.holds else "red"
    console.print(f"[bold {colour}]{plain(str(execution))}[/]", highlight=False, soft_wrap=True)


# ---- check


def print_derivatives(console: Console, checks: list[DerivativeCheck]) -> None:
    """Print the comparison of derivatives: one line per mode or reset, then one per block that does not agree."""
    table = new_table("derivatives of", ">blocks", ">largest error", ">allowed error", ">order", "at")
    for where in dict.fromkeys(check.where for check in checks):
        own = [check for check in checks if check.where == where]
        worst = max(own, key=lambda each: (not each.agrees, each.error / each.allowed if each.allowed else 0.0))
        rates = [check.rate for check in own if check.rate is not None]
        table.add_row(
            where, str(len(own)), f"{worst.error:.1e}", f"{worst.allowed:.1e}",
            f"{min(rates):.2f}" if rates else "exact", f"{worst.row} by {worst.by}",
        )  # fmt: skip
    console.print(table)
    for check in checks:
        if check.agrees:
            continue
        what = "is not finite here" if math.isinf(check.error) else "disagrees with differences"
        what = what if check.smooth or math.isinf(check.error) else "is not smooth here"
        source = f" ({check.source})" if check.source else ""
        console.print(
            f"[red]{check.term}{source}[/]: {check.output} by {check.by} {what} at '{check.row}' - got an "
            f"error of {check.error:.2e}, expected at most {check.allowed:.2e}; {check.where}",
        )


def print_dimensions(console: Console, costs: list[CostReport], constraints: list[ConstraintReport]) -> None:
    """Print unit and size of every term at the initial guess."""
    table = new_table(
        "cost", "at", ">rows", "unit", ">weights", "weight unit", ">largest residual", ">cost at the guess"
    )
    for cost in costs:
        low, high = cost.weights
        weights = "0" if high == 0 else f"{low:.3g}" if low == high else f"{low:.3g} … {high:.3g}"
        table.add_row(
            cost.name, cost.at, str(cost.rows), cost.unit or "-", weights, cost.weight_unit, f"{cost.largest:.3g}",
            f"{cost.cost:.4g}",
        )  # fmt: skip
    console.print(table)
    if constraints:
        table = new_table("constraint", "kind", ">rows", "unit", ">scale", ">rows x nodes", ">violated", ">largest")
        for row in constraints:
            table.add_row(
                row.name, row.kind, str(row.rows), row.unit or "-", f"{row.scale:g}", str(row.counted), str(row.missed),
                f"{row.worst:.3g}",
            )  # fmt: skip
        console.print(table)


def print_cells(console: Console, lines: Sequence[Mapping[str, str]]) -> None:
    """Print the cells of a study, one per line."""
    names = list(dict.fromkeys(name for line in lines for name in line))
    shown = new_table(*(name if name == "method" else plain(f">{name}") for name in names))
    for line in lines:
        shown.add_row(*(plain(line.get(name, "")) for name in names))
    console.print(shown)


def new_table(*columns: str) -> Table:
    """Return an empty table; a column with ">" before its name is aligned to the right."""
    table = Table(box=None, pad_edge=False, header_style="bold", padding=(0, 2, 0, 0))
    for column in columns:
        right = column.startswith(">")
        table.add_column(column.removeprefix(">"), justify="right" if right else "left", no_wrap=right)
    return table
