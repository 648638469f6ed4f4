"""The parts of an iteration can be run one by one, as benchmarks do, and repeat what the solve has left behind."""

import ctypes as ct

import numpy as np
import pytest

from piaffe.ocp import compile_problem
from piaffe.solvers import MSiLQR, Options
from piaffe.solvers.ilqr.native.memory import SolverMemory

from .test_solver import ALL, GCC

pytestmark = pytest.mark.skipif(GCC is None, reason="no C compiler on the path")

NAMES = ["backward", "forward", "evaluation", "sums", "derivatives"]
WRITTEN = {
    "backward": ("k", "K", "V_x"), "forward": ("dx", "du"), "evaluation": ("x_next",),
    "derivatives": ("D", "H", "grad", "end_H", "end_grad"),
}  # fmt: skip


class Part(ct.Structure):
    _fields_ = (("name", ct.c_char_p), ("run", ct.CFUNCTYPE(None, ct.c_void_p)))


@pytest.fixture(scope="module")
def memory() -> SolverMemory:
    """A memory whose next iteration, at an iterate that is not yet a solution, is known."""
    solver = MSiLQR(compile_problem(ALL["swing up"]()), Options(max_iterations=3))
    solution = solver.solve()
    assert solver.memory is not None
    assert solution.iterations == 3
    return solver.memory


def parts(memory: SolverMemory) -> dict[str, Part]:
    table = (Part * (len(NAMES) + 1)).in_dll(memory.library, "piaffe_parts")
    assert table[len(NAMES)].name is None
    return {part.name.decode(): part for part in table[:-1]}


def test_parts_are_those_of_an_iteration_in_order(memory: SolverMemory) -> None:
    assert list(parts(memory)) == NAMES


@pytest.mark.parametrize("name", WRITTEN)
def test_part_writes_what_it_is_named_for(memory: SolverMemory, name: str) -> None:
    run = parts(memory)
    for each in NAMES:
        run[each].run(ct.addressof(memory.c))
    (own,) = memory.arrays
    before = {key: own[key].copy() for key in WRITTEN[name]}
    accepted = memory.accepted(0, "x").copy(), memory.accepted(0, "u").copy()
    for key, values in before.items():
        own[key][values != 0] = np.nan  # zeros that no iterate changes are not written
        assert np.any(np.isnan(own[key])), key
    run[name].run(ct.addressof(memory.c))
    for key, values in before.items():
        np.testing.assert_array_equal(own[key], values, err_msg=key)
    np.testing.assert_array_equal(memory.accepted(0, "x"), accepted[0])
    np.testing.assert_array_equal(memory.accepted(0, "u"), accepted[1])


def test_sums_are_of_the_accepted_iterate(memory: SolverMemory) -> None:
    run, cost = parts(memory), memory.history[2].cost
    memory.c.cost = np.nan
    for name in ("evaluation", "sums"):
        run[name].run(ct.addressof(memory.c))
    assert memory.c.cost == pytest.approx(cost, rel=1e-14)
