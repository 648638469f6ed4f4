"""Solutions: a trajectory with policy, value function, multipliers, history, costs of terms and violations."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piaffe.errors import SolverError
from piaffe.html import html_curve, html_table
from piaffe.ocp import Policy, Trajectory, Violation

from . import explanation, file
from .explanation import Relaxation
from .parts import PhaseSolution
from .record import Record
from .search_state import SearchState
from .status import Status

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False, repr=False)
class Solution:
    """The result of a solve.

    Args:
        status: the reason why the solve ended.
        trajectory: times, states, controls and outputs.
        phases: policy, value function and multipliers, aligned with the trajectory's phases.
        history: one record per iteration.
        cost: declared cost, without barrier and multipliers.
        max_defect: ∞-norm in the tangent, in natural sizes of the model.
        max_equality, max_inequality: raw SI divided by the row's scale.
        term_costs: cost of each named term.
        violations: the worst violation of each named constraint, worst first.
        barrier_weight: last ε.
        wall_s: time of the solve [s]. compile_s: time of compilation [s].
        models: model name → recipe. limits: declared limits of constraints, for plots.
        fault: a sentence about the cause of the status. ``NOT_FINITE``: the number, its function, declaration, phase,
            node and time. ``UNSTABLE``: the phase in which the value function grows most. Empty for other statuses.
        search: state of the search; with it a warm start continues as if the solve had not stopped.
    """

    status: Status
    trajectory: Trajectory
    phases: tuple[PhaseSolution, ...]
    history: tuple[Record, ...]
    cost: float
    max_defect: float
    max_equality: float
    max_inequality: float
    term_costs: Mapping[str, float]
    violations: tuple[Violation, ...]
    barrier_weight: float
    wall_s: float
    compile_s: float
    models: Mapping[str, Mapping[str, Any]]
    limits: tuple[Mapping[str, Any], ...]
    fault: str = ""
    search: SearchState | None = None

    @property
    def converged(self) -> bool:
        """Whether every tolerance is met and the iterate is stationary."""
        return self.status is Status.CONVERGED

    @property
    def iterations(self) -> int:
        """Number of iterations."""
        return len(self.history)

    @property
    def states(self) -> Array:
        """States of all phases stacked; only for phases of one state size, (nodes, nx)."""
        return np.vstack([phase.states for phase in self.trajectory.phases])

    @property
    def controls(self) -> Array:
        """Controls of all phases stacked; only for phases of one control size, (stages, nu)."""
        return np.vstack([phase.controls for phase in self.trajectory.phases])

    @cached_property
    def policy(self) -> Policy:
        """The policy: ``solution.policy(x, t)`` is the control ū + K (x ⊖ x̄) of a state x at time t [s], (nu,)."""
        return Policy(self.trajectory, [phase.feedback for phase in self.phases])

    def raise_if_failed(self) -> Solution:
        """Return the solution; raise SolverError with the explanation if it has not converged."""
        if not self.converged:
            raise SolverError(self.explain())
        return self

    def explain(self) -> str:
        """Return a text about the end of the solve: the reason, the violations, the largest defect."""
        lines = [self.status.advice, *([self.fault] if self.fault else [])]
        if self.history:
            last = self.history[-1]
            lines.append(
                f"After {self.iterations} iterations: cost {self.cost:.6g}, largest defect {self.max_defect:.2e}, "
                f"equality {self.max_equality:.2e}, inequality {self.max_inequality:.2e}; "
                f"last step {last.step_size:.3g}, "
                f"regularisation {last.regularization:.1e}, barrier weight {last.barrier_weight:.1e}."
            )
        lines += explanation.rows(self.violations, self.status)
        defects = [
            (float(np.max(np.abs(p.defects))), t.name, p.defects, t)
            for p, t in zip(self.phases, self.trajectory.phases, strict=True)
        ]
        size, name, table, trajectory = max(defects, key=lambda item: item[0])
        if not self.converged and size > 0:
            node, row = np.unravel_index(int(np.argmax(np.abs(table))), table.shape)
            lines.append(
                f"- largest defect: phase '{name}', node {node}, '{trajectory.state.labels[row]}' by {size:.3g}"
            )
        if not self.converged:
            lines += [
                text for text in (explanation.wandering(self.history), explanation.scales(self.violations)) if text
            ]
        relaxed = self.relaxation
        if relaxed is not None:
            lines.append(
                f"Relaxation with which all rows can hold, by their multipliers: '{relaxed.term}' by "
                f"{relaxed.amount:.3g} {relaxed.unit}".rstrip()
                + "."
            )
        return "\n".join(lines)

    @property
    def relaxation(self) -> Relaxation | None:
        """A relaxation of the constraint at fault, if the solve ended with violations that cannot be met."""
        if self.converged or self.status in (Status.UNSTABLE, Status.NOT_FINITE, Status.STATIONARY):
            return None
        return explanation.relaxation(self.violations, self.status)

    def save(self, path: str | Path) -> Path:
        """Write the solution as one ``.npz`` with a versioned header, atomically."""
        return file.write({entry.name: getattr(self, entry.name) for entry in fields(self)}, Path(path))

    @staticmethod
    def load(path: str | Path) -> Solution:
        """Read a solution; raise FileFormatError for a truncated, foreign or newer file."""
        return Solution(**file.read(Path(path)))

    def to_csv(self, path: str | Path) -> Path:
        """Write the trajectory as CSV; see :meth:`piaffe.ocp.Trajectory.to_csv`."""
        return self.trajectory.to_csv(path)

    def to_mcap(self, path: str | Path) -> Path:
        """Write the trajectory as an MCAP log; see :meth:`piaffe.ocp.Trajectory.to_mcap`."""
        return self.trajectory.to_mcap(path)

    def to_pandas(self) -> Any:
        """Return the trajectory as a table of pandas; see :meth:`piaffe.ocp.Trajectory.to_pandas`."""
        return self.trajectory.to_pandas()

    def __repr__(self) -> str:
        return (
            f"Solution({self.status.name}, {self.iterations} iterations, {self.wall_s:.3g} s, cost {self.cost:.6g}; "
            f"defect {self.max_defect:.1e}, equality {self.max_equality:.1e}, inequality {self.max_inequality:.1e})"
        )

    def _repr_html_(self) -> str:
        terms = sorted(self.term_costs.items(), key=lambda item: -item[1])
        curves = html_curve("cost", [record.cost for record in self.history])
        curves += html_curve("largest defect", [record.max_defect for record in self.history])
        return html_table(repr(self), ("term", "cost"), [(name, f"{value:.6g}") for name, value in terms], curves)

    def __str__(self) -> str:
        head = (
            f"{self.status.name}: {self.iterations} iterations, {self.wall_s:.2f} s, cost {self.cost:.6g}\n"
            f"defect {self.max_defect:.1e}, equality {self.max_equality:.1e}, inequality {self.max_inequality:.1e}"
        )
        terms = sorted(self.term_costs.items(), key=lambda item: -item[1])
        body = "\n".join(f"  {value:12.6g}  {name}" for name, value in terms)
        return f"{head}\n{body}" if self.converged else f"{head}\n{self.explain()}\n{body}"
