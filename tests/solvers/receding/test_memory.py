"""Ticks run clean where errors of memory show, and such errors would show."""

import pytest

from piaffe.codegen.compilers import NoCompilerError

from .memory import checked, runtime


def before() -> str:
    try:
        found = runtime()
    except NoCompilerError as error:
        pytest.skip(str(error))
    if found is None:
        pytest.skip("the compiler has no runtime of AddressSanitizer to load")
    return found


@pytest.mark.parametrize("name", ["first uncut", pytest.param("rope", marks=pytest.mark.slow)])
def test_nothing_is_found(name):
    ran = checked([name], before())
    assert ran.returncode == 0, ran.stderr[:6000]
    assert "nothing found" in ran.stdout


def test_an_array_that_is_too_short_would_be_found():
    ran = checked(["first uncut"], before(), spoil=True)
    assert ran.returncode != 0
    assert "use-after-poison" in ran.stderr
