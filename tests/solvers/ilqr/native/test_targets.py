"""What is compiled for processors with narrower registers computes the same."""

import ctypes as ct
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from piaffe.solvers import MSiLQR, Options
from piaffe.solvers.ilqr.native.backend import run_native
from piaffe.solvers.ilqr.native.memory import SolverMemory
from piaffe.solvers.ilqr.native.program import TEMPLATES
from piaffe.solvers.ilqr.result import assemble
from piaffe.solvers.ilqr.run import Run

from .targets import TARGETS, library_at
from .test_solver import ALL, GCC, assert_same_result, by_numpy, compiled

pytestmark = pytest.mark.skipif(GCC is None, reason="no C compiler on the path")

OLD_GCC = "gcc without __builtin_shufflevector"
COMPILERS = {
    "gcc": (shutil.which("gcc"),), OLD_GCC: (shutil.which("gcc"), "-U__GNUC__", "-D__GNUC__=11"),
    "clang": (shutil.which("clang"),),
    "zig": (sys.executable if find_spec("ziglang") else None, "-m", "ziglang", "cc", "-fno-sanitize=undefined"),
}  # fmt: skip
"""By the ways that ``tiles.inc`` takes: of gcc, of gcc before version 12, of clang twice."""

TILES = """
#include <stddef.h>
#include <string.h>
#define NW 19 /* the largest row */
#include "tiles.inc"

int doubles(void) { return VL; }

void transposed(double *a)
{
    vn v[VL];
    for (int r = 0; r < VL; r++) v[r] = vn_load(a + r * VL);
    transpose(v);
    for (int r = 0; r < VL; r++) vn_store(a + r * VL, v[r]);
}

void summed(const double *a, double *sums)
{
    vn v[VL];
    for (int r = 0; r < VL; r++) v[r] = vn_load(a + r * VL);
    vn_store(sums, sums_of(v));
}

/* to += A^T B: A of 5 rows and 7 columns, B of 5 rows and 20 columns, of which 19 are of use */
void multiplied(const double *A, const double *B, double *to)
{
    double padded[5 * PADDED(19)] = {0}, sum[7 * PADDED(19)] = {0};
    for (int r = 0; r < 5; r++) memcpy(padded + r * PADDED(19), B + r * 20, sizeof(double) * 19);
    for (int r = 0; r < 7; r++) memcpy(sum + r * PADDED(19), to + r * 20, sizeof(double) * 19);
    for (int i = 0; i < 7; i += VL)
        IN_ROW(tile_of_sum, 7, i, 0, VECTORS(19), sum, PADDED(19), A, 7, padded, PADDED(19), 5, sum, PADDED(19))
    for (int r = 0; r < 7; r++) memcpy(to + r * 20, sum + r * PADDED(19), sizeof(double) * 19);
}

/* to = A w, A of 7 rows and 19 columns */
void applied(const double *A, const double *w, double *to)
{
    double padded[PADDED(19)] = {0};
    memcpy(padded, w, sizeof(double) * 19);
    for (int i = 0; i + VL <= 7; i += VL) vn_store(to + i, rows_times(VL, 19, A + i * 19, 19, NULL, padded));
    for (int i = 7 / VL * VL; i < 7; i++) to[i] = rows_times(1, 19, A + i * 19, 19, NULL, padded)[0];
}
"""


def tiles(compiler: str, target: str, folder: Path) -> ct.CDLL:
    """Return a library of ``tiles.inc``."""
    command = [word for word in COMPILERS[compiler] if word is not None]
    if len(command) < len(COMPILERS[compiler]):
        pytest.skip(f"{compiler} is not installed")
    if "ziglang" in command:
        target = target.replace("x86-64", "x86_64").replace("-v", "_v").replace("-march", "-mcpu")
    (folder / "tiles.inc").write_text(TEMPLATES["tiles.inc"], encoding="utf-8")
    (folder / "tiles.c").write_text(TILES, encoding="utf-8")
    flags = ["-std=gnu11", "-O2", "-w", "-ffp-contract=off", target, "-fPIC", "-shared", "tiles.c", "-o", "tiles.so"]
    done = subprocess.run([*command, *flags], cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[:3000]
    return ct.CDLL(str(folder / "tiles.so"))


def given(values: np.ndarray) -> ct.c_void_p:
    assert values.flags.c_contiguous
    return ct.c_void_p(values.ctypes.data)


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("compiler", COMPILERS)
def test_tiles_are_as_wide_as_a_register_and_compute_products(compiler: str, target: str, tmp_path: Path) -> None:
    library = tiles(compiler, target, tmp_path)
    n, rng = TARGETS[target], np.random.default_rng(0)
    assert library.doubles() == n
    a = rng.integers(-99, 99, (n, n)).astype(float)  # whole numbers, whose sums and products are exact in any order
    b, sums = a.copy(), np.zeros(n)
    library.transposed(given(b))
    np.testing.assert_array_equal(b, a.T)
    library.summed(given(a), given(sums))
    np.testing.assert_array_equal(sums, a.sum(axis=1))
    A, B, to = (rng.integers(-99, 99, shape).astype(float) for shape in ((5, 7), (5, 20), (7, 20)))
    expected = to + np.hstack([A.T @ B[:, :19], np.zeros((7, 1))])
    library.multiplied(given(A), given(B), given(to))
    np.testing.assert_array_equal(to, expected)
    rows, w, product = (
        rng.integers(-99, 99, (7, 19)).astype(float),
        rng.integers(-99, 99, 19).astype(float),
        np.zeros(7),
    )
    library.applied(given(rows), given(w), given(product))
    np.testing.assert_array_equal(product, rows @ w)


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("name", ALL)
def test_policy_and_expansions_are_those_of_numpy(name: str, target: str) -> None:
    problem, doubles = compiled(name), TARGETS[target]
    by_c = MSiLQR(problem, Options(max_iterations=3), backend="numpy")
    memory = SolverMemory(problem, library_at(problem, target, doubles), by_c.options)
    run = Run(by_c.functions, by_c.scaled_options(), by_c.start(None), by_c.flags(True), None)
    status = run_native(memory, run, None, None)
    got = assemble(run, status, 0.0)
    run.policy = None
    expected = assemble(run, status, 0.0)
    for p, q in zip(got.phases, expected.phases, strict=True):
        for field in ("feedforward", "feedback", "V_x", "V_xx", "Q_x", "Q_u", "Q_xx", "Q_ux", "Q_uu"):
            a, b = getattr(p, field), getattr(q, field)
            close = 1e-8 * (1 + np.max(np.abs(b), initial=0.0))
            np.testing.assert_allclose(a, b, rtol=1e-8, atol=close, err_msg=field)


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("name", ["flying body", "rope", "landing"])
def test_solution_is_that_of_numpy(name: str, target: str) -> None:
    problem = compiled(name)
    solver = MSiLQR(problem, backend="numpy")
    solver.memory = SolverMemory(problem, library_at(problem, target, TARGETS[target]), solver.options)
    solution = solver.solve()
    assert solution.status is by_numpy(name).status
    assert_same_result(solution, by_numpy(name))
