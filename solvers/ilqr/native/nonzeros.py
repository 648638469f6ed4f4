"""The nonzeros of a sparse matrix in a chosen order: outputs of a function, and tables of their positions for C."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import casadi as cs

from .tables import table


@dataclass(frozen=True)
class Nonzeros:
    """Nonzeros of a matrix.

    Args:
        values: a column of them.
        rows: row of each.
        columns: column of each.
    """

    values: cs.SX
    rows: tuple[int, ...]
    columns: tuple[int, ...]

    @staticmethod
    def of(matrix: cs.SX) -> Nonzeros:
        """Return a matrix's structural nonzeros, row by row."""
        matrix = cs.sparsify(matrix).T
        return Nonzeros(cs.vec(matrix.nz[:]) if matrix.nnz() else cs.SX(0, 1), tuple(matrix.sparsity().get_col()),
                       tuple(matrix.row()))  # fmt: skip

    def __len__(self) -> int:
        return len(self.rows)

    def __iter__(self) -> Iterator[tuple[int, int]]:
        return iter(zip(self.rows, self.columns, strict=True))

    def __neg__(self) -> Nonzeros:
        return Nonzeros(-self.values, self.rows, self.columns)

    def moved(self, rows: Sequence[int] | None = None, columns: Sequence[int] | None = None) -> Nonzeros:
        """Return the nonzeros with row i moved to ``rows[i]`` and column i to ``columns[i]``, sorted."""
        at = [
            (r if rows is None else rows[r], c if columns is None else columns[c], k) for k, (r, c) in enumerate(self)
        ]
        return self._picked(sorted(at))

    def where(self, holds: Callable[[int, int], bool]) -> Nonzeros:
        """Return the nonzeros for whose row and column a condition holds."""
        return self._picked([(r, c, k) for k, (r, c) in enumerate(self) if holds(r, c)])

    def _picked(self, at: list[tuple[int, int, int]]) -> Nonzeros:
        values = self.values.nz[[k for _, _, k in at]] if at else cs.SX(0, 1)
        return Nonzeros(cs.densify(values), tuple(r for r, _, _ in at), tuple(c for _, c, _ in at))

    def tables(self, name: str) -> list[str]:
        """Return the C tables of their rows and columns."""
        return [f"#define NNZ_{name} {len(self)}", table(f"{name}_row", self.rows), table(f"{name}_col", self.columns)]
