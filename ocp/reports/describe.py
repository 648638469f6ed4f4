"""Description of a compiled problem: its phases, the models that each term is bound in, and why it is not in others."""

from __future__ import annotations

from ..compiler import CompiledProblem
from ..language import Constraint
from .warnings import find_warnings


def _table(head: list[str], rows: list[list[str]]) -> list[str]:
    widths = [max(len(line[i]) for line in [head, *rows]) for i in range(len(head))]
    lines = [
        "  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip()
        for line in [head, *rows]
    ]
    return [lines[0], "-" * max(map(len, lines)), *lines[1:]]


def _kind(term: Constraint) -> str:
    return f"{term.kind}, bounds over phases" if term.varies("lower") or term.varies("upper") else term.kind


def describe(compiled: CompiledProblem) -> str:
    """Return the text that ``print(problem)`` and ``piaffe describe`` show."""
    phases = [
        [
            p.name, p.label or "flight", p.mode.model.name, f"{p.times[0]:.3f}", f"{p.times[-1]:.3f}", f"{p.dt:g}",
            str(p.num_stages), f"{p.mode.state.nx}/{p.mode.state.ndx}", str(p.mode.nu),
            "end" if p.transition is None else "reset" if p.resets else "joined",
        ]
        for p in compiled.phases
    ]  # fmt: skip
    head = ["phase", "mode", "model", "from [s]", "to [s]", "dt [s]", "stages", "nx/ndx", "nu", "then"]
    lines = _table(head, phases)
    total = compiled.phases[-1].times[-1] - compiled.phases[0].times[0]
    lines.append(f"{compiled.num_stages} stages over {total:.3f} s")
    terms = []
    for k, term in enumerate(compiled.terms):
        modes = dict.fromkeys(p.mode for p in compiled.phases)
        where, why, count = [], [], 0
        transitions = dict.fromkeys(p.transition for p in compiled.phases if p.transition is not None)
        at_resets = [each for each in transitions if k in each.bound]
        for mode in modes:
            if k in mode.bound:
                where.append(mode.model.name)
                count = max(count, *(sum(row.term == k for row in rows) for rows in mode.rows.values()))
            elif k in mode.unbound and not any(each.source is mode.model for each in at_resets):
                why.append(f"{mode.unbound[k]}")
        for each in at_resets:
            where.append(f"{each.source.name} (impacts)")
            count = max(count, sum(row.term == k for rows in each.rows.values() for row in rows))
        kind = _kind(term) if isinstance(term, Constraint) else "cost"
        scope = compiled.scopes[k]
        names = [p.name for p in compiled.phases if term.applies(p.name) and scope in (None, p.interval.phase)]
        span = "all phases" if len(names) == len(compiled.phases) else ", ".join(dict.fromkeys(names))
        terms.append([
            term.name, kind, term.at, term.unit or "-", str(count), ", ".join(dict.fromkeys(where)), span,
            "; ".join(dict.fromkeys(why)), str(term.source),
        ])  # fmt: skip
    lines.append("")
    lines += _table(
        ["term", "kind", "at", "unit", "rows", "bound in", "phases", "not bound because", "declared"], terms
    )
    warnings = find_warnings(compiled)
    if warnings:
        lines += ["", "warnings", "--------"] + [f"{n.where}: {n.text}" for n in warnings]
    return "\n".join(lines)
