"""Warnings about a problem: what is likely a mistake, found before a solve."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..compiler import CompiledPhase, CompiledProblem, Guess, Row
from ..language import ProblemWarning
from .constant_costs import constant_costs
from .contradictions import contradictions, same_twice
from .grid import few_steps
from .large_parameters import large_parameters
from .reach import out_of_reach
from .short_references import short_references
from .turns import far_angles, many_turns, other_order

Array = NDArray[np.float64]

NEAR_HALF_TURN = 0.3
"""An orientation residual is reported if its length is within this distance of π [rad]: at π its direction reverses."""


TOLERANCE = 1e-3
"""Violations of constraints by the initial state are reported above this value, relative to the row's scale."""


def find_warnings(compiled: CompiledProblem) -> list[ProblemWarning]:
    """Return what is likely a mistake in a problem; solvers issue these warnings before they iterate."""
    models = dict.fromkeys(phase.mode.model for phase in compiled.phases)
    found = [warning for model in models for warning in model.warnings(compiled.path)]
    found += [*few_steps(compiled), *many_turns(compiled), *far_angles(compiled), *other_order(compiled)]
    found += [*initial_violations(compiled), *same_twice(compiled), *contradictions(compiled)]
    found += [*out_of_reach(compiled), *constant_costs(compiled), *short_references(compiled)]
    found += large_parameters(compiled)
    guesses = {phase: Guess(phase) for phase in compiled.phases if _turning(phase)}
    if guesses:
        stages = {phase: guess.stage["residual"] for phase, guess in guesses.items()}
        ends = {phase: guess.terminal["residual"] for phase, guess in guesses.items()}
        blank = np.zeros((0, 0))
        found += half_turns(
            compiled, [stages.get(p, blank) for p in compiled.phases], [ends.get(p, blank) for p in compiled.phases]
        )
    placed = (each if each.source is not None else replace(each, source=compiled.source) for each in found)
    return list(dict.fromkeys(placed))


def initial_violations(compiled: CompiledProblem) -> list[ProblemWarning]:
    """Return a warning per constraint on the state that the initial state violates: no control can change that.

    Args:
        compiled: the problem.
    """
    phase, found = compiled.phases[0], []
    stage, x, p = phase.mode.functions["stage"], compiled.initial, phase.p[0]
    *_, g, h = (value.full().ravel() for value in stage(x, np.zeros(phase.mode.nu), np.zeros(phase.mode.nz), p))
    for kind, missed in (("g", -g * phase.g_mask[0]), ("h", np.abs(h) * phase.h_mask[0])):
        of_state = {row.term for row in phase.mode.rows[f"terminal_{kind}"]}
        worst: dict[int, int] = {}
        for i, row in enumerate(phase.mode.rows[f"stage_{kind}"]):
            if row.term in of_state and missed[i] > max(TOLERANCE, missed[worst[row.term]] if row.term in worst else 0):
                worst[row.term] = i
        for term, i in worst.items():
            row, declared = phase.mode.rows[f"stage_{kind}"][i], compiled.terms[term]
            found.append(
                ProblemWarning(
                    f"term '{compiled.row_name(row)}' ({declared.source}), phase '{phase.name}', node 0",
                    f"the initial state violates it - got {missed[i] * row.scale:.3g} {row.unit}".rstrip()
                    + ", expected no violation; no control can change it: change the initial state or the bound, or "
                    "restrict the term with when=",
                    declared.source,
                )
            )
    return found


def half_turns(compiled: CompiledProblem, stages: Sequence[Array], ends: Sequence[Array]) -> list[ProblemWarning]:
    """Return a warning per term and phase with an orientation residual within ``NEAR_HALF_TURN`` of π.

    Args:
        compiled: the problem.
        stages: residual rows of every phase's stages, (N, nr) each, as the function ``stage`` returns them.
        ends: residual rows of every phase's last node, (nr_end,) each.
    """
    found = []
    for phase, stage, end in zip(compiled.phases, stages, ends, strict=True):
        for group, rows, weights, first in (
            ("stage_residual", stage, phase.weight, 0),
            ("terminal_residual", np.atleast_2d(end), phase.end_weight[None], phase.num_stages),
        ):
            for term, columns in _turning(phase, group).items():
                counted = np.any(weights[:, columns] > 0, axis=1)
                angles = np.where(counted, np.linalg.norm(rows[:, columns], axis=1), 0.0)
                node = int(np.argmax(angles))
                if angles[node] > np.pi - NEAR_HALF_TURN:
                    declared = compiled.terms[term]
                    found.append(
                        ProblemWarning(
                            f"term '{declared.name}' ({declared.source}), phase '{phase.name}', node {first + node}",
                            f"the residual is near half a turn - got {angles[node]:.2f} rad, expected less than "
                            f"{np.pi - NEAR_HALF_TURN:.2f} rad; beyond π the cost turns in the other direction: add a "
                            "keyframe in between, or lengthen the phase",
                            declared.source,
                        )
                    )
    return found


def _turning(phase: CompiledPhase, group: str | None = None) -> dict[int, list[int]]:
    """Return the columns of each term's rotation in a group of residuals, or in all groups."""
    found: dict[int, list[int]] = {}
    for name in ("stage_residual", "terminal_residual") if group is None else (group,):
        rows: tuple[Row, ...] = phase.mode.rows[name]
        for column, row in enumerate(rows):
            if row.rotates:
                found.setdefault(row.term, []).append(column)
    return found
