"""One memory for many solves: a solve reads nothing that another left, so phases can be laid out anew in place."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from piaffe.ocp import CompiledProblem
from piaffe.solvers import MSiLQR, Options, Solution
from piaffe.solvers.ilqr.native import SolverMemory
from piaffe.solvers.ilqr.native import structs as s
from piaffe.solvers.ilqr.native.library import library_for

from .test_hybrid import mixture
from .test_solver import ALL, assert_equal_bits, compiled, pytestmark

__all__ = ["pytestmark"]
INPUTS = ("p", "weight", "g_mask", "h_mask", "relaxation", "shift", "multiplier", "penalty")
"""Arrays of a block that the caller writes; of a phase these are the trial's x and u."""
POOL = np.full(2_000_000, np.nan)


class Before:
    """A library that does something to the memory right before a solve, when the start is in it."""

    def __init__(self, memory: SolverMemory, action: Callable[[SolverMemory], None]) -> None:
        self.memory, self.action, self.library, self.count = memory, action, memory.library, 0

    def __getattr__(self, name: str) -> Any:
        return getattr(self.library, name)

    def piaffe_solve(self, *arguments: Any) -> int:
        self.action(self.memory)
        self.count += 1
        return int(self.library.piaffe_solve(*arguments))


def solve_after(
    solver: MSiLQR, action: Callable[[SolverMemory], None], warm_start: Solution | None = None, kind: str | None = None
) -> Solution:
    """Solve with something done to the memory before."""
    memory = solver.memory
    assert memory is not None
    before = Before(memory, action)
    memory.library = before  # type: ignore[assignment]  # a stand-in
    try:
        return solver.solve(warm_start, shooting=True if kind is None else mixture(solver.problem, kind))
    finally:
        memory.library = before.library
        assert before.count == 1


def poison(memory: SolverMemory) -> None:
    """Replace all numbers but those that a caller gives by NaN, and say that the matrices are not clear."""
    for i, arrays in enumerate(memory.arrays):
        given = [memory.trial(i, "x").ctypes.data, memory.trial(i, "u").ctypes.data]
        for array in arrays.values():
            if array.ctypes.data not in given:
                array[:] = np.nan
    for blocks in memory.blocks:
        for arrays in blocks.blocks:
            for name, array in arrays.items():
                if name not in INPUTS:
                    array[:] = np.nan
    memory.c.cleared = 0


def forget(memory: SolverMemory) -> None:
    """Replace the state of a cold solve, too."""
    poison(memory)
    for name in s.OF_SOLVE:
        setattr(memory.c, name, np.nan)
    for name in s.COUNTERS:
        setattr(memory.c, name, 77)
    memory.c.gains[:] = [np.nan] * len(memory.c.gains)


@pytest.mark.parametrize("kind", [None, "random"])
@pytest.mark.parametrize("name", ALL)
def test_cold_solve_reads_nothing_but_its_inputs(name: str, kind: str | None) -> None:
    solver = MSiLQR(compiled(name))
    expected = solver.solve(shooting=True if kind is None else mixture(solver.problem, kind))
    assert_equal_bits(solve_after(solver, forget, kind=kind), expected)


@pytest.mark.parametrize("name", ["hopper", "rope", "jerked rope"])
def test_warm_solve_reads_nothing_but_its_inputs_and_its_state(name: str) -> None:
    part = MSiLQR(compiled(name), Options(max_iterations=5)).solve()
    solver = MSiLQR(compiled(name))
    assert_equal_bits(solve_after(solver, poison, part), solver.solve(part))


@pytest.mark.parametrize("name", ["hopper", "jerked rope"])
def test_zeros_of_the_matrices_are_what_remains_from_solve_to_solve(name: str) -> None:
    """Set ``cleared`` to 0 after a new layout: without that, the zeros would be what lay there."""

    def keep_cleared(memory: SolverMemory) -> None:
        poison(memory)
        memory.c.cleared = 1

    solver = MSiLQR(compiled(name))
    solver.solve()
    assert not solve_after(solver, keep_cleared).converged


class Pooled(SolverMemory):
    """A memory in a common pool, whose numbers are as the memory before left them."""

    def __init__(self, problem: CompiledProblem) -> None:
        self.used = -POOL.ctypes.data // 8 % 8
        super().__init__(problem, library_for(problem)[0], Options())

    def _array(self, size: int, values: Any = None) -> np.ndarray:
        array = POOL[self.used : self.used + size]
        assert array.size == size
        self.used += -(-size // 8) * 8
        if values is not None:
            array[:] = np.ravel(values)
        return array


def test_problems_take_turns_in_one_memory() -> None:
    """Other phases, sizes and functions lie where others lay."""
    for name in [*ALL, *reversed(ALL)]:
        problem = compiled(name)
        solver = MSiLQR(problem, backend="numpy")
        solver.memory = Pooled(problem)
        assert solver.memory.c.cleared == 0
        assert_equal_bits(solver.solve(), MSiLQR(problem).solve())
