"""The functions in place of those of libm, against libm."""

import shlex
import subprocess
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest

from piaffe.codegen import NoCompilerError
from piaffe.codegen.compilers import working

FUNCTIONS = {
    "sin": (-1e3, 1e3), "cos": (-1e3, 1e3), "tan": (-1.5, 1.5), "asin": (-1.0, 1.0), "acos": (-1.0, 1.0),
    "atan": (-50.0, 50.0), "atan2": (-3.0, 3.0), "exp": (-700.0, 700.0), "log": (1e-300, 1e3), "pow": (0.01, 20.0),
    "hypot": (-10.0, 10.0),
}  # fmt: skip


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("own_math")
    try:
        compiler = working()
    except NoCompilerError:
        pytest.skip("needs a C compiler")
    header = files("piaffe.codegen").joinpath("own_math.h").read_text(encoding="utf-8")
    (folder / "own_math.h").write_text(header)
    source = Path(__file__).with_name("own_math.c")
    words = ["-std=c11", "-O2", "-ffp-contract=off", f"-I{folder}", str(source), "-o", str(folder / "values"), "-lm"]
    subprocess.run([*compiler.command, *compiler.flags, *words], check=True)
    return folder / "values"


def values(program: Path, points: list[tuple[str, float, float]]) -> np.ndarray:
    given = "".join(f"{shlex.quote(name)} {x!r} {y!r}\n" for name, x, y in points)
    told = subprocess.run([str(program)], input=given, capture_output=True, text=True, check=True).stdout
    return np.array([[float(word) for word in line.split()] for line in told.splitlines()])


@pytest.mark.parametrize("name", FUNCTIONS)
def test_values_are_those_of_libm_up_to_the_last_bits(program: Path, name: str) -> None:
    rng, (low, high) = np.random.default_rng(1), FUNCTIONS[name]
    points = [
        (name, float(x), float(y)) for x, y in zip(rng.uniform(low, high, 2000), rng.uniform(-3, 3, 2000), strict=True)
    ]
    own, libm = values(program, points).T
    assert np.isfinite(own).all()
    assert np.abs(own - libm).max() <= 1e-15 or (np.abs(own - libm) <= 2e-15 * np.abs(libm)).all()


def test_powers_with_whole_exponents_are_products(program: Path) -> None:
    own, libm = values(program, [("pow", x, n) for x in (0.5, -3.0, 7.0) for n in (-2.0, 0.0, 1.0, 3.0)]).T
    assert np.array_equal(own, libm)


def test_ends_of_the_range_are_those_of_libm(program: Path) -> None:
    points = [
        ("exp", 710.0, 0.0), ("exp", -800.0, 0.0), ("exp", -740.0, 0.0), ("exp", np.inf, 0.0), ("log", 0.0, 0.0),
        ("log", 5e-324, 0.0), ("log", np.inf, 0.0), ("atan2", 0.0, 0.0), ("atan2", -0.0, 0.0), ("atan2", -1.0, -0.0),
    ]  # fmt: skip
    own, libm = values(program, points).T
    assert np.allclose(own, libm, rtol=1e-15, atol=5e-324)
    assert np.array_equal(np.signbit(own), np.signbit(libm))
    assert np.isnan(values(program, [("log", -1.0, 0.0), ("exp", np.nan, 0.0), ("sin", np.inf, 0.0)])[:, 0]).all()
