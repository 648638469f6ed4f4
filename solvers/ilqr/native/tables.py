"""Tables: sizes and sparsity patterns of a kernel as C constants and constant arrays."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as cs
import numpy as np
from numpy.typing import NDArray

TABLE = "static const int __attribute__((unused))"  # a mode without implicit variables does not use all of them
WIDTHS = (2, 4, 8)
"""Doubles per vector that ``tiles.inc`` works with."""


def defines(**values: int) -> list[str]:
    """Return a ``#define`` of each value."""
    return [f"#define {name} {value}" for name, value in values.items()]


def table(name: str, numbers: Sequence[int]) -> str:
    """Return a constant array; C does not allow an empty one, so it has at least one entry."""
    return f"{TABLE} {name}[] = {{{', '.join(map(str, numbers)) or '0'}}};"


def lists(name: str, entries: Sequence[Sequence[int]]) -> list[str]:
    """Return lists of numbers as one array, ``name_row``, and the index at which each list begins, ``name_from``."""
    ends = [0]
    for own in entries:
        ends.append(ends[-1] + len(own))
    return [table(f"{name}_from", ends), table(f"{name}_row", [k for own in entries for k in own])]


def dynamics_rows(d_w: cs.Sparsity, d_z: cs.Sparsity) -> list[str]:
    """Return the tables of ``riccati.inc``: the dense rows of D, and the positions of the nonzeros of the other rows.

    A row is dense if it depends on implicit variables, or has nonzeros in more than half of its vectors of 8 columns.
    """
    num_rows, num_cols = d_w.size1(), d_w.size2()
    columns: list[list[int]] = [[] for _ in range(num_rows)]
    for r, c in zip(d_w.row(), d_w.get_col(), strict=True):
        columns[r].append(c)
    implicit, vectors = set(d_z.row()), -(-num_cols // 8)
    dense = [r for r in range(num_rows) if r in implicit or 2 * len({c // 8 for c in columns[r]}) > vectors]
    by_column = [[r for r in range(num_rows) if r not in dense and c in columns[r]] for c in range(num_cols)]
    entries = [(r, c) for c, rows in enumerate(by_column) for r in rows]
    lines = [*defines(NUM_DENSE=len(dense), NUM_SPARSE=len(entries)), table("dense_row", dense)]
    lines += [*lists("sparse", by_column), table("sparse_col", [c for _, c in entries])]
    return lines + diagonals("shift", entries, num_cols)


def natural_sizes(states: NDArray[np.float64], controls: NDArray[np.float64]) -> list[str]:
    """Return the tables of natural sizes of the states, and of 1 / sizes² of states and controls; none if all are 1."""
    sizes = np.concatenate([states, controls])
    if np.all(sizes == 1.0):
        return []
    tables = {"state_size": states, "ridge": sizes**-2.0}
    return [
        "#define SIZED",
        *(f"static const double {name}[] = {{{', '.join(map(repr, t.tolist()))}}};" for name, t in tables.items()),
    ]


def finish_entries(finish: cs.Sparsity) -> list[str]:
    """Return the tables of ``finish.inc``: entries of S, column by column as CasADi stores them."""
    columns, size = finish.get_col(), finish.size2()
    by_column = [[r for r, c in zip(finish.row(), columns, strict=True) if c == column] for column in range(size)]
    lines = [*defines(NUM_FINISH=finish.nnz()), *lists("finish", by_column), table("finish_col", columns)]
    return lines + diagonals("finish_shift", list(zip(finish.row(), columns, strict=True)), size)


def diagonals(name: str, entries: Sequence[tuple[int, int]], num_cols: int) -> list[str]:
    """Return, for each width of a vector, the diagonals of a sparse matrix per vector of its columns.

    ``name`` with the width has the distance of each diagonal from the main one, ``_at`` the place of each entry among
    the diagonals.
    """
    lines = []
    for width in WIDTHS:
        known = sorted({(c // width, c - r) for r, c in entries})
        by_vector = [[shift for v, shift in known if v == vector] for vector in range(-(-num_cols // width))]
        at = {diagonal: k * width for k, diagonal in enumerate(known)}
        lines += lists(f"{name}{width}", by_vector)
        lines.append(table(f"{name}{width}_at", [at[c // width, c - r] + c % width for r, c in entries]))
    return lines
