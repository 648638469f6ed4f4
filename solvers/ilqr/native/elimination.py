"""Elimination: in which order the unknowns of the implicit part are solved for, and in which blocks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import casadi as cs

from .tables import table

LARGEST_BLOCK = 3
"""Joints of a leg and forces of a foot come in threes; three rows of sums for 48 columns fill the registers."""

Place = tuple[int, int]


@dataclass(frozen=True)
class Elimination:
    """Block elimination of K without pivoting: K = (L + D) (I + D⁻¹ U), stored as the blocks of L, D⁻¹ and D⁻¹ U.

    Args:
        block: rows of a block, the same for all.
        order: unknown at each place, -1 where a block is filled up with a row of the identity.
        lower: per row of blocks the columns left of the diagonal that elimination leaves not zero.
        upper: those right of it.
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
        """Number of each block in memory: as substitution reads them, row by row forth, then back."""
        forth = [(i, j) for i, row in enumerate(self.lower) for j in (*row, i)]
        back = [(i, j) for i in reversed(range(len(self.upper))) for j in self.upper[i]]
        return {place: number for number, place in enumerate(forth + back)}

    @property
    def size(self) -> int:
        """Numbers in all blocks."""
        return len(self.stored) * self.block**2

    def at(self, row: int, column: int) -> int:
        """Return where an entry of the reordered matrix is stored."""
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
    """Return how to eliminate.

    The ``first`` unknowns, a definite block, go in the order of least degree on the pattern of K + Kᵀ; the others
    follow as they come. Neighbours that leave the same fill share a block.

    Args:
        K: pattern of the matrix.
        first: size of its definite block.
    """
    order, rows = _least_degree(K, first)
    upper = [[j for j in row if j > i] for i, row in enumerate(rows)]
    groups: list[list[int]] = []
    for i in range(len(order)):
        if groups and len(groups[-1]) < LARGEST_BLOCK and upper[i - 1] == [i, *upper[i]]:
            groups[-1].append(i)
        else:
            groups.append([i])
    block = max(map(len, groups), default=1)
    group_of = {i: number for number, group in enumerate(groups) for i in group}
    linked = [sorted({group_of[j] for i in group for j in rows[i]} - {g}) for g, group in enumerate(groups)]
    # a block is there if any of its entries is, on either side of the diagonal: the pattern is symmetric
    return Elimination(
        block,
        tuple(order[group[r]] if r < len(group) else -1 for group in groups for r in range(block)),
        tuple(tuple(j for j in row if j < i) for i, row in enumerate(linked)),
        tuple(tuple(j for j in row if j > i) for i, row in enumerate(linked)),
    )


def _least_degree(K: cs.Sparsity, first: int) -> tuple[list[int], list[list[int]]]:
    """Return an order of the unknowns, and per reordered row the entries off the diagonal with the fill it leaves."""
    n = K.size1()
    links: dict[int, set[int]] = {i: set() for i in range(n)}
    for r, c in zip(K.row(), K.get_col(), strict=True):
        if r != c:
            links[r].add(c)
            links[c].add(r)
    pattern = {i: set(neighbours) for i, neighbours in links.items()}
    order: list[int] = []
    rest = set(range(n))
    while rest:
        candidates = [i for i in rest if i < first] or [min(rest)]
        pick = min(candidates, key=lambda i: (len(links[i]), i))
        rest.remove(pick)
        for i in links[pick]:
            links[i] |= links[pick] - {i}
            links[i].discard(pick)
            pattern[i] |= links[pick] - {i}
        order.append(pick)
    at = {unknown: place for place, unknown in enumerate(order)}
    return order, [sorted(at[j] for j in pattern[i]) for i in order]
