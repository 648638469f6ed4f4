"""The compiled solver runs clean where errors of memory show, and such errors would show."""

import shutil

import numpy as np
import pytest

from piaffe.codegen.compilers import NoCompilerError
from piaffe.ocp import compile_problem

from .image import UNTOUCHED, ImageMemory
from .memory import NATIVE, PLAIN, SMALL, TOOLS, Case, check, missing
from .test_solver import ALL, GCC

pytestmark = pytest.mark.skipif(GCC is None, reason="no C compiler on the path")

ODD = ("rope", "flying body")
"""Problems of odd sizes and of more than one mode."""
CASES = [(tool, name, TOOLS[tool].example) for tool in TOOLS for name in SMALL]
CASES += [("sanitizers", "rope", (1, NATIVE)), *((tool, name, (2, PLAIN)) for tool in TOOLS for name in ODD)]


def needs(tool: str) -> None:
    try:
        lacking = missing(tool)
    except NoCompilerError as error:
        lacking = str(error)
    if lacking:
        pytest.skip(lacking)


@pytest.mark.parametrize(("tool", "name", "case"), CASES)
def test_nothing_is_found(tool: str, name: str, case: Case) -> None:
    needs(tool)
    cold, warm = check(compile_problem(ALL[name]()), TOOLS[tool], case)
    assert cold.converged
    assert warm.converged
    assert warm.iterations < cold.iterations


def short(memory: ImageMemory) -> None:
    memory.shorten(memory.arrays[0]["D"])


def forgotten(memory: ImageMemory) -> None:
    memory.blocks[0].blocks[0]["weight"].view(np.uint64)[:] = UNTOUCHED


@pytest.mark.parametrize(
    ("tool", "spoil", "told"),
    [
        ("sanitizers", short, "heap-buffer-overflow"),
        ("sanitizers", forgotten, "5"),  # NOT_FINITE, as what has not been written is NaN there
        ("valgrind", short, "Invalid (read|write) of size"),
        ("valgrind", forgotten, "depends on uninitialised value"),
    ],
)
def test_error_would_be_found(tool: str, spoil: object, told: str) -> None:
    needs(tool)
    with pytest.raises(AssertionError, match=told):
        check(compile_problem(ALL["rope"]()), TOOLS[tool], TOOLS[tool].cases[0], spoil=spoil)


def test_what_is_missing_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shutil, "which", lambda name: None)
    missing.cache_clear()
    assert missing("valgrind") == "valgrind is not installed"
    missing.cache_clear()
