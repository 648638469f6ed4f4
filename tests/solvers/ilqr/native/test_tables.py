"""Tables of the kernels say what the sparsity says."""

import re

import casadi as cs
import numpy as np
import pytest

from piaffe.solvers.ilqr.native.tables import WIDTHS, dynamics_rows, finish_entries, lists


def parsed(lines: list[str]) -> dict[str, list[int]]:
    """Return defined numbers and arrays by name."""
    found: dict[str, list[int]] = {}
    for line in lines:
        if define := re.fullmatch(r"#define (\w+) (\d+)", line):
            found[define[1]] = [int(define[2])]
        else:
            name, numbers = re.findall(r"(\w+)\[\] = \{(.*)\};", line)[0]
            found[name] = [int(number) for number in numbers.split(",")]
    return found


def pattern(rows: list[list[int]], num_cols: int) -> cs.Sparsity:
    return cs.Sparsity.triplet(
        len(rows), num_cols, [r for r, own in enumerate(rows) for _ in own], [c for own in rows for c in own]
    )


EULER = [[0, 20], [1, 21], [2, 3, 22, 23], [2, 3, 22, 23], [4, 24], [], [6, 26], [7, 27], []]
"""Nine rows: positions with a turned pair, one row that is zero, and the last one of the acceleration."""


def test_rows_of_the_acceleration_and_full_rows_are_dense() -> None:
    implicit = pattern([[]] * 8 + [[0, 1]], 2)
    told = parsed(dynamics_rows(pattern(EULER, 30), implicit))
    assert told["NUM_DENSE"] == [1]
    assert told["dense_row"] == [8]
    assert told["NUM_SPARSE"] == [sum(map(len, EULER))]
    full = [*EULER[:5], list(range(0, 30, 3)), *EULER[6:]]
    assert parsed(dynamics_rows(pattern(full, 30), implicit))["dense_row"] == [5, 8]


@pytest.mark.parametrize("width", WIDTHS)
def test_entries_by_column_and_by_diagonal_make_up_the_sparse_rows(width: int) -> None:
    num_rows, num_cols = len(EULER), 30
    told = parsed(dynamics_rows(pattern(EULER, num_cols), pattern([[]] * num_rows, 1)))
    rng = np.random.default_rng(0)
    D = np.zeros((num_rows, num_cols))
    for r, own in enumerate(EULER):
        D[r, own] = rng.uniform(1, 2, len(own))
    by_column = np.zeros_like(D)
    for c in range(num_cols):
        for e in range(told["sparse_from"][c], told["sparse_from"][c + 1]):
            assert told["sparse_col"][e] == c
            by_column[told["sparse_row"][e], c] = D[told["sparse_row"][e], c]
    np.testing.assert_array_equal(by_column, D)
    values = [D[r, c] for r, c in zip(told["sparse_row"], told["sparse_col"], strict=True)]
    vector = rng.uniform(-1, 1, num_rows)
    product = by_diagonals(told, f"shift{width}", width, values, vector, num_cols)
    np.testing.assert_allclose(product, vector @ D, rtol=1e-12, atol=1e-12)


def by_diagonals(
    told: dict[str, list[int]], name: str, width: int, values: list[float], vector: np.ndarray, num_cols: int
) -> np.ndarray:
    """Return a vector times a matrix, by the diagonals of each vector of columns, as the C code does it."""
    starts, shifts = told[f"{name}_from"], told[f"{name}_row"]
    weights = np.zeros((starts[-1], width))
    weights.reshape(-1)[told[f"{name}_at"]] = values
    padded = np.concatenate([np.zeros(num_cols), vector, np.zeros(num_cols)])
    product = np.zeros((-(-num_cols // width), width))
    for j in range(len(product)):
        for e in range(starts[j], starts[j + 1]):
            first = num_cols + j * width - shifts[e]
            product[j] += weights[e] * padded[first : first + width]
    return product.reshape(-1)[:num_cols]


FINISH = [[6], [1, 2, 7, 8], [1, 2, 7, 8], [9], [], [11], [], [], [], [], [], []]
"""What the last part of a step adds to the identity: positions moved by velocities six columns on, a turned pair."""


@pytest.mark.parametrize("width", WIDTHS)
def test_entries_of_the_last_part_are_column_by_column_and_by_diagonal(width: int) -> None:
    size = len(FINISH)
    sparsity = pattern(FINISH, size)
    told, rng = parsed(finish_entries(sparsity)), np.random.default_rng(0)
    assert told["NUM_FINISH"] == [sum(map(len, FINISH))]
    matrix = cs.DM(sparsity, rng.uniform(1, 2, sparsity.nnz()))
    values, S = list(matrix.nonzeros()), np.array(matrix)
    found = np.zeros((size, size))
    for c in range(size):
        for e in range(told["finish_from"][c], told["finish_from"][c + 1]):
            assert told["finish_col"][e] == c
            found[told["finish_row"][e], c] = values[e]
    np.testing.assert_array_equal(found, S)
    vector = rng.uniform(-1, 1, size)
    product = by_diagonals(told, f"finish_shift{width}", width, values, vector, size)
    np.testing.assert_allclose(product, vector @ S, rtol=1e-12, atol=1e-12)


def test_empty_tables_are_still_c() -> None:
    assert [line.split(" = ")[1] for line in lists("none", [[], []])] == ["{0, 0, 0};", "{0};"]
