"""Random schedules shifted by random times, and many random ticks: no crash, and C equals NumPy."""

import pytest

from piaffe import solvers

from .found import Found
from .many_ticks import MOTIONS, run
from .random_ticks import random_case

COUNT = 10_000
"""Random schedules of the slow test."""
ROBOTS = 50
"""One random schedule in so many is a robot's."""
TICKS = 1000
"""Random ticks of the slow test, of each motion."""

ADAPTING = solvers.Adapting(min_weight=0.005, max_defect=10.0)


def check(seeds: range, cycles: int) -> Found:
    found = Found()
    for seed in seeds:
        random_case(seed, found, robot=seed % ROBOTS == 0, cycles=cycles)
    return found


def test_random_schedules_shifted_by_random_times():
    found = check(range(COUNT, COUNT + 200), cycles=6)
    assert found.compiled > 200
    assert found.ticks > 400
    assert 0 < found.refused < 20


@pytest.mark.slow
def test_ten_thousand_random_schedules_shifted_by_random_times():
    found = check(range(COUNT), cycles=6)
    assert found.compiled > COUNT
    assert found.ticks > 2 * COUNT
    assert found.wild < COUNT


@pytest.mark.parametrize("name", MOTIONS)
def test_random_ticks_with_an_adapting_barrier_in_c_equal_those_in_numpy(name):
    shown = run(name, 40, seed=1, barrier=ADAPTING)
    assert shown.adapted > 10


@pytest.mark.slow
@pytest.mark.parametrize("name", MOTIONS)
def test_a_thousand_random_ticks_with_an_adapting_barrier_in_c_equal_those_in_numpy(name):
    shown = run(name, TICKS, seed=2, barrier=ADAPTING)
    assert shown.adapted > TICKS / 4


@pytest.mark.parametrize("name", MOTIONS)
def test_random_ticks_in_c_equal_those_in_numpy(name):
    shown = run(name, 40, seed=1)
    assert shown.controls > 50
    assert shown.limited > 0


@pytest.mark.slow
@pytest.mark.parametrize("name", MOTIONS)
def test_a_thousand_random_ticks_in_c_equal_those_in_numpy(name):
    shown = run(name, TICKS, seed=2)
    assert shown.controls > 2 * TICKS
    assert shown.limited > 0
