"""Elimination in blocks: nothing fills in where no block is stored, and entries keep their places."""

import casadi as cs
import numpy as np
import pytest

from piaffe.solvers.ilqr.native.elimination import LARGEST_BLOCK, Elimination, eliminate
from piaffe.solvers.ilqr.native.nonzeros import Nonzeros


def limbs(num_limbs: int, joints: int) -> np.ndarray:
    """Return a matrix with the pattern of limbs on a base of six, and a foot's force for each limb."""
    n = 6 + num_limbs * joints
    K = np.zeros((n + 3 * num_limbs,) * 2)
    K[:6, :6] = 1
    for limb in range(num_limbs):
        own, foot = slice(6 + limb * joints, 6 + (limb + 1) * joints), slice(n + 3 * limb, n + 3 * limb + 3)
        for block in (slice(0, 6), own, foot):
            K[own, block] = K[block, own] = 1
        K[:6, foot] = K[foot, :6] = K[foot, foot] = 1
    return K


def scattered(seed: int) -> np.ndarray:
    """Return a sparse pattern without any order in it, not symmetric."""
    rng = np.random.default_rng(seed)
    return np.eye(11) + (rng.random((11, 11)) < 0.15)


CASES = {
    "quadruped": (limbs(4, 3), 18), "planar legs": (limbs(2, 2), 10), "six joints": (limbs(2, 6), 18),
    "scattered": (scattered(0), 11), "half definite": (scattered(1), 5), "one unknown": (np.ones((1, 1)), 1),
}  # fmt: skip


@pytest.mark.parametrize("name", CASES)
def test_factors_fit_into_the_stored_blocks(name: str) -> None:
    pattern, first = CASES[name]
    rng = np.random.default_rng(3)
    K = pattern * rng.random(pattern.shape) + 10 * np.eye(len(pattern))
    how = eliminate(cs.DM(cs.sparsify(cs.DM(pattern))).sparsity(), first)
    assert how.block <= LARGEST_BLOCK
    assert sorted(unknown for unknown in how.order if unknown >= 0) == list(range(len(K)))
    full = np.eye(len(how.order))
    full[np.ix_(how.place, how.place)] = K
    expected = np.linalg.inv(full)
    np.testing.assert_allclose(solved_in_blocks(how, full), expected, rtol=0, atol=1e-12)


def solved_in_blocks(how: Elimination, K: np.ndarray) -> np.ndarray:
    """Return the inverse by the stored blocks alone, as ``kkt.inc`` goes about it."""
    b = how.block
    F = {(i, j): K[i * b : i * b + b, j * b : j * b + b].copy() for i, j in how.stored}
    for i, row in enumerate(how.lower):
        for j in (*row, i, *how.upper[i]):
            for k in row:
                if k < j and (k, j) in F:
                    F[i, j] -= F[i, k] @ F[k, j]
            if j == i:
                F[i, i] = np.linalg.inv(F[i, i])
            elif j > i:
                F[i, j] = F[i, i] @ F[i, j]
    x = np.eye(len(K)).reshape(-1, b, len(K))
    for i, row in enumerate(how.lower):
        x[i] = F[i, i] @ (x[i] - sum(F[i, k] @ x[k] for k in row))
    for i in reversed(range(len(how.upper))):
        x[i] -= sum(F[i, k] @ x[k] for k in how.upper[i])
    return x.reshape(len(K), len(K))


def test_limbs_and_feet_of_a_quadruped_come_in_full_blocks_of_three() -> None:
    how = eliminate(cs.DM(cs.sparsify(cs.DM(CASES["quadruped"][0]))).sparsity(), 18)
    assert how.block == 3
    assert min(how.order) == 0
    assert how.lower[:4] == ((), (), (), ())  # legs first, none of which touches another
    assert len(how.stored) == 64


def test_entries_are_row_by_row_and_keep_their_values_when_moved() -> None:
    matrix = cs.SX(cs.DM(cs.Sparsity.triplet(3, 4, [2, 0, 1, 0], [1, 3, 0, 0]), [1.0, 2.0, 3.0, 4.0]))
    dense = np.array(cs.DM(matrix))
    entries = Nonzeros.of(matrix)
    assert list(entries) == [(0, 0), (0, 3), (1, 0), (2, 1)]
    moved = (-entries).moved(rows=[2, 0, 1], columns=[3, 2, 1, 0])
    assert list(moved) == [(0, 3), (1, 2), (2, 0), (2, 3)]
    numbers = np.array(cs.DM(moved.values)).ravel()
    assert [-dense[[1, 2, 0][r], 3 - c] for r, c in moved] == list(numbers)
    assert list(entries.where(lambda r, c: c > 0)) == [(0, 3), (2, 1)]
