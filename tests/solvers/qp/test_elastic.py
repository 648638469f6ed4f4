"""Programs whose soft rows give way: the conditions of their minimum, and the least excess."""

import numpy as np
import pytest

from piaffe.errors import ShapeError
from piaffe.solvers import QpStatus, solve_qp
from tests.solvers.qp.programs import random_program


def _infeasible(seed):
    """Return programs that no point meets, with the rows that may give way."""
    rng = np.random.default_rng(seed)
    for i in range(1, 8 * 60, 8):  # the kind that is often infeasible
        H, g, A, b, C, d = random_program(rng, i)
        scale = np.trace(H) / len(g)
        program = H / scale, g / scale, A, b, C, d  # an ordinary size of multipliers
        soft = rng.uniform(size=len(d)) < 0.7
        if len(d) and soft.any() and solve_qp(H, g, A=A, b=b, C=C, d=d).status is QpStatus.INFEASIBLE:
            yield program, soft


def _elastic(program, soft, method):
    H, g, A, b, C, d = program
    return solve_qp(H, g, A=A, b=b, C=C, d=d, soft=soft, method=method)


@pytest.mark.parametrize("method", ["own", "numpy"])
def test_the_excess_meets_the_conditions_of_a_minimum_and_is_the_least_one_within_its_price(method):
    linprog = pytest.importorskip("scipy.optimize").linprog
    found = least_ones = 0
    for program, soft in _infeasible(3):
        H, g, A, b, C, d = program
        n = len(g)
        equal = np.hstack([A, np.zeros((len(b), 1))]) if len(b) else None
        least = linprog(
            np.eye(n + 1)[n], np.hstack([-C, -soft[:, None].astype(float)]), -d, equal, b if len(b) else None,
            [(None, None)] * n + [(0, None)],
        )  # fmt: skip
        result = _elastic(program, soft, method)
        if least.status == 2:
            assert result.status is QpStatus.INFEASIBLE
            continue
        found += 1
        assert result.status is QpStatus.RELAXED
        size = 1 + np.abs(result.x).max() + result.excess
        slack = C @ result.x + soft * result.excess - d
        assert slack.min() > -1e-7 * size
        assert result.excess >= least.fun - 1e-7 * size
        price = result.inequality[soft].sum()
        forces = A.T @ result.equality + C.T @ result.inequality
        assert np.abs(H @ result.x + g - forces).max() < 1e-6 * (1 + np.abs(forces).max())
        assert np.abs(result.inequality * slack).max() < 1e-6 * size * (1 + price)
        assert price == pytest.approx(100.0 + 1e-3 * result.excess, rel=1e-6)  # the mean diagonal of H is 1
        least_ones += result.excess < least.fun * (1 + 1e-6) + 1e-7
    assert found > 20
    assert least_ones > 0.8 * found


def test_a_program_with_a_solution_does_not_change():
    rng = np.random.default_rng(4)
    for i in range(80):
        H, g, A, b, C, d = random_program(rng, i)
        plain = solve_qp(H, g, A=A, b=b, C=C, d=d)
        if plain.status is QpStatus.SOLVED:
            result = solve_qp(H, g, A=A, b=b, C=C, d=d, soft=np.ones(len(d), dtype=bool))
            assert (result.status, result.excess) == (QpStatus.SOLVED, 0.0)
            np.testing.assert_array_equal(result.x, plain.x)


def test_hard_rows_hold_and_without_soft_rows_there_is_no_solution():
    rows, levels = [[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0]], [2.0, 1.0, 3.0]  # x ≥ 2, x ≤ −1, y ≥ 3
    result = solve_qp(np.eye(2), np.zeros(2), C=rows, d=levels, soft=[True, False, False])
    assert result.status is QpStatus.RELAXED
    np.testing.assert_allclose(result.x, [-1.0, 3.0], atol=1e-9)
    assert result.excess == pytest.approx(3.0)
    result = solve_qp(np.eye(2), np.zeros(2), C=rows, d=levels, soft=[True, True, True])
    assert result.excess == pytest.approx(1.5, rel=1e-6)
    np.testing.assert_allclose(result.x, [0.5, 1.5], atol=1e-9)
    assert solve_qp(np.eye(2), np.zeros(2), C=rows, d=levels, soft=[False, False, True]).status is QpStatus.INFEASIBLE


def test_flags_that_do_not_fit_are_named():
    with pytest.raises(ShapeError, match="'soft' does not fit - got shape .2,., expected .1,."):
        solve_qp(np.eye(1), np.zeros(1), C=[[1.0]], d=[0.0], soft=[True, False])
