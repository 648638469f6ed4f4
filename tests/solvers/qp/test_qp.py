"""The dual active-set method: the conditions of a minimum, its twin, other packages, and errors."""

import re

import numpy as np
import pytest

from piaffe.errors import ShapeError, SolverError
from piaffe.solvers import QpStatus, solve_qp
from piaffe.solvers.qp import QP_METHODS, QpMemory, qp_library
from tests.solvers.qp.programs import KINDS, distance_from_minimum, random_program


def _solved(program, method="own", **options):
    H, g, A, b, C, d = program
    return solve_qp(H, g, A=A, b=b, C=C, d=d, method=method, **options)


def test_ten_thousand_random_programs_meet_the_conditions_of_a_minimum():
    rng, statuses = np.random.default_rng(0), {}
    for i in range(10_000):
        program = random_program(rng, i)
        result = _solved(program)
        counts = statuses.setdefault(KINDS[i % 8], {})
        counts[result.status] = counts.get(result.status, 0) + 1
        if result.status is QpStatus.SOLVED:
            assert distance_from_minimum(program, result) < 1e-8, (i, KINDS[i % 8])
    for kind, counts in statuses.items():
        may_fail = kind in ("often infeasible", "zero rows", "dependent equalities")
        assert set(counts) == {QpStatus.SOLVED} | ({QpStatus.INFEASIBLE} if may_fail else set()), (kind, counts)


def test_c_and_numpy_agree():
    rng = np.random.default_rng(1)
    for i in range(800):
        program = random_program(rng, i)
        compiled, readable = _solved(program), _solved(program, "numpy")
        assert compiled.status is readable.status, i
        if compiled.status is QpStatus.SOLVED:
            size = 1 + np.abs(readable.x).max()
            np.testing.assert_allclose(compiled.x, readable.x, rtol=0, atol=1e-9 * size, err_msg=str(i))
            assert distance_from_minimum(program, readable) < 1e-8, i


def test_an_infeasible_program_has_a_proof():
    """Minimising the largest violation is a linear program; its minimum is positive if no point meets all rows."""
    linprog = pytest.importorskip("scipy.optimize").linprog
    rng, infeasible = np.random.default_rng(2), 0
    for i in range(1, 8 * 40, 8):  # the kind that is often infeasible
        _, g, A, b, C, d = program = random_program(rng, i)
        if not len(d):
            continue
        n, norm = len(g), np.linalg.norm(C, axis=1, keepdims=True)
        rows = np.hstack([-C / norm, -np.ones((len(d), 1))])
        equal = np.hstack([A, np.zeros((len(b), 1))]) if len(b) else None
        least = linprog(
            np.eye(n + 1)[n], rows, -d / norm[:, 0], equal, b if len(b) else None, [(None, None)] * n + [(0, None)]
        )
        assert (least.fun > 1e-7) == (_solved(program).status is QpStatus.INFEASIBLE), i
        infeasible += least.fun > 1e-7
    assert 5 < infeasible < 40


@pytest.mark.parametrize("method", ["daqp", "osqp"])
def test_other_packages_agree(method):
    pytest.importorskip(method)
    rng, compared = np.random.default_rng(3), 0
    for i in range(400):
        if KINDS[i % 8] == "badly scaled" or (method == "osqp" and KINDS[i % 8] not in ("feasible", "equal rows")):
            continue
        program = random_program(rng, i)
        own, other = _solved(program), _solved(program, method)
        if other.status is QpStatus.ITERATION_LIMIT:
            continue  # not an answer
        assert own.status is other.status, (i, KINDS[i % 8])
        if own.status is QpStatus.SOLVED:
            tolerance = 1e-6 if method == "daqp" else 1e-3
            np.testing.assert_allclose(own.x, other.x, rtol=0, atol=tolerance * (1 + np.abs(own.x).max()))
            compared += 1
    assert compared > 60


def test_closed_form_of_a_projection():
    """The nearest point of x + y ≥ 2 to the origin, and the multiplier of the row."""
    for method in ("own", "numpy"):
        result = solve_qp(np.eye(2), [0.0, 0.0], C=[[1.0, 1.0]], d=[2.0], method=method)
        np.testing.assert_allclose(result.x, [1.0, 1.0], atol=1e-14)
        np.testing.assert_allclose(result.inequality, [1.0], atol=1e-14)
        assert result.active.all()
        assert result.iterations == 1


def test_rows_that_were_active_are_tried_first():
    rng = np.random.default_rng(4)
    fewer = same = 0
    for i in range(0, 400, 8):
        program = random_program(rng, i)
        cold = _solved(program)
        warm = _solved(program, first=cold.active)
        np.testing.assert_allclose(warm.x, cold.x, atol=1e-9 * (1 + np.abs(cold.x).max()))
        assert (warm.active == cold.active).all()
        fewer += warm.iterations < cold.iterations
        same += warm.iterations == cold.iterations
    assert fewer > 0
    assert fewer + same > 40


@pytest.mark.parametrize("method", ["own", "numpy"])
def test_status_says_what_is_wrong(method):
    eye, zero = np.eye(3), np.zeros(3)
    bad = eye.copy()
    bad[1, 1] = np.nan
    indefinite = np.diag([1.0, -1.0, 1.0])
    assert solve_qp(bad, zero, method=method).status is QpStatus.NOT_FINITE
    assert solve_qp(eye, [0, np.inf, 0], method=method).status is QpStatus.NOT_FINITE
    assert solve_qp(eye, zero, C=[[1, np.nan, 0]], d=[0], method=method).status is QpStatus.NOT_FINITE
    assert solve_qp(eye, zero, C=[[1, 0, 0]], d=[np.nan], method=method).status is QpStatus.NOT_FINITE
    assert solve_qp(indefinite, zero, method=method).status is QpStatus.NOT_CONVEX
    assert solve_qp(eye, zero, C=[[0, 0, 0]], d=[1], method=method).status is QpStatus.INFEASIBLE
    assert solve_qp(eye, zero, C=[[1, 0, 0]], d=[np.inf], method=method).status is QpStatus.NOT_FINITE
    assert solve_qp(eye, zero, A=[[0, 0, 0]], b=[1], method=method).status is QpStatus.INFEASIBLE
    failed = solve_qp(indefinite, zero, method=method)
    assert np.isnan(failed.x).all()


def test_bad_input_is_named():
    with pytest.raises(ShapeError, match=re.escape("got H, g, A, b, C, d of shapes (2, 2), (3,)")):
        solve_qp(np.eye(2), np.zeros(3))
    with pytest.raises(ShapeError, match="'first' does not fit - got shape \\(1,\\), expected \\(0,\\)"):
        solve_qp(np.eye(2), np.zeros(2), first=np.zeros(1, dtype=bool))
    with pytest.raises(SolverError, match=f"got 'simplex', expected one of {', '.join(QP_METHODS)}"):
        solve_qp(np.eye(2), np.zeros(2), method="simplex")


def test_memory_is_used_again():
    library = qp_library()
    if library is None:
        pytest.skip("no compiler")
    memory = QpMemory(2, 0, 1, library)
    memory.H[:], memory.C[:] = np.eye(2), [[1.0, 0.0]]
    for level in (1.0, -1.0, np.inf, 3.0):
        memory.d[:] = level
        result = memory.solve()
        expected = QpStatus.NOT_FINITE if level == np.inf else QpStatus.SOLVED
        assert result.status is expected
        if expected is QpStatus.SOLVED:
            np.testing.assert_allclose(result.x, [max(level, 0.0), 0.0], atol=1e-14)
