"""Order and blocks of the elimination in the linear solve of the implicit dynamics."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import casadi as cs

from .tables import table

LARGEST_BLOCK = 3
"""A leg has three joints, a foot three force components; three rows with 48 columns of sums fill the registers."""

Place = tuple[int, int]


@dataclass(frozen=True)
class Elimination:
    """Block elimination of K without pivoting: K = (L + D) (I + D⁻¹ U), stored as the blocks of L, D⁻¹ and D⁻¹ U.

    Args:
        block: number of rows of a block, the same for all.
        order: index of the unknown at each place; -1 for a row of the identity that fills up a block.
        lower: per block row, the block columns left of the diagonal that are nonzero after the elimination.
        upper: per block row, those right of the diagonal.
    """

    block: int
    order: tuple[int, ...]
    lower: tuple[tuple[int, ...], ...]
    upper: tuple[tuple[int, ...], ...]

    @cached_property
    def place(self) -> list[int]:
        """Place of each unknown."""
        place = [0] * sum(unknown >= 0 for unknown in self.order)
        for at, unknown in enumerate(self.order):
            if unknown >= 0:
                place[unknown] = at
        return place

    @cached_property
    def stored(self) -> dict[Place, int]:
        """Index of each block in memory, in the order in which forward and backward substitution read them."""
        forward = [(i, j) for i, row in enumerate(self.lower) for j in (*row, i)]
        backward = [(i, j) for i in reversed(range(len(self.upper))) for j in self.upper[i]]
        return {place: number for number, place in enumerate(forward + backward)}

    @property
    def size(self) -> int:
        """Number of entries of all blocks."""
        return len(self.stored) * self.block**2

    def at(self, row: int, column: int) -> int:
        """Return the index in memory of an entry of the reordered matrix."""
        (i, r), (j, c) = divmod(row, self.block), divmod(column, self.block)
        return self.stored[i, j] * self.block**2 + r * self.block + c

    def tables(self) -> list[str]:
        """Return the constants of ``kkt.inc``."""
        targets, pivots, ends, left, right = [], [], [], [], []
        for i in range(len(self.lower)):
            for j in (*self.lower[i], i, *self.upper[i]):
                common = [k for k in self.lower[i] if k < j and (k, j) in self.stored]
                targets.append(self.stored[i, j])
                pivots.append(self.stored[i, i] if j >= i else -1)
                left += [self.stored[i, k] for k in common]
                right += [self.stored[k, j] for k in common]
                ends.append(len(left))
        return [
            f"#define BK {self.block}",
            f"#define NB {len(self.lower)}",
            f"#define NUM_BLOCKS {len(self.stored)}",
            *(
                table(name, values)
                for name, values in {
                    "order": self.order, "target": targets, "pivot": pivots, "last_term": ends, "left": left,
                    "right": right, "lower_end": _ends(self.lower), "lower_at": _flat(self.lower),
                    "upper_end": _ends(self.upper[::-1])[::-1], "upper_at": _flat(self.upper[::-1]),
                }.items()
            ),
        ]  # fmt: skip


def _flat(rows: Sequence[Sequence[int]]) -> list[int]:
    return [k for row in rows for k in row]


def _ends(rows: Sequence[Sequence[int]]) -> list[int]:
    ends = [0]
    for row in rows:
        ends.append(ends[-1] + len(row))
    return ends[1:]


def eliminate(K: cs.Sparsity, first: int) -> Elimination:
    """Return the elimination of a matrix.

    The ``first`` unknowns, whose block is definite, are in minimum-degree order on the pattern of K + Kᵀ. The others
    follow in their own order. Consecutive unknowns with the same fill share a block.

    Args:
        K: sparsity pattern of the matrix.
        first: size of its leading definite block.
    """
    order, rows = _minimum_degree(K, first)
    upper = [[j for j in row if j > i] for i, row in enumerate(rows)]
    groups: list[list[int]] = []
    for i in range(len(order)):
        if groups and len(groups[-1]) < LARGEST_BLOCK and upper[i - 1] == [i, *upper[i]]:
            groups[-1].append(i)
        else:
            groups.append([i])
    block = max(map(len, groups), default=1)
    group_of = {i: number for number, group in enumerate(groups) for i in group}
    nonzero = [sorted({group_of[j] for i in group for j in rows[i]} - {g}) for g, group in enumerate(groups)]
    # a block is stored if any of its entries is nonzero; the pattern of the blocks is symmetric
    return Elimination(
        block,
        tuple(order[group[r]] if r < len(group) else -1 for group in groups for r in range(block)),
        tuple(tuple(j for j in row if j < i) for i, row in enumerate(nonzero)),
        tuple(tuple(j for j in row if j > i) for i, row in enumerate(nonzero)),
    )


def _minimum_degree(K: cs.Sparsity, first: int) -> tuple[list[int], list[list[int]]]:
    """Return an order of the unknowns, and per reordered row its nonzero columns off the diagonal, fill included."""
    n = K.size1()
    neighbours: dict[int, set[int]] = {i: set() for i in range(n)}
    for r, c in zip(K.row(), K.get_col(), strict=True):
        if r != c:
            neighbours[r].add(c)
            neighbours[c].add(r)
    pattern = {i: set(columns) for i, columns in neighbours.items()}
    order: list[int] = []
    rest = set(range(n))
    while rest:
        candidates = [i for i in rest if i < first] or [min(rest)]
        pick = min(candidates, key=lambda i: (len(neighbours[i]), i))
        rest.remove(pick)
        for i in neighbours[pick]:
            neighbours[i] |= neighbours[pick] - {i}
            neighbours[i].discard(pick)
            pattern[i] |= neighbours[pick] - {i}
        order.append(pick)
    at = {unknown: place for place, unknown in enumerate(order)}
    return order, [sorted(at[j] for j in pattern[i]) for i in order]
