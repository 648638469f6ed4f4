"""The functions in place of those of libm, against libm."""

import shlex
import shutil
import subprocess
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest

from piaffe.codegen import NoCompilerError, simd
from piaffe.codegen.compilers import working

FUNCTIONS = {
    "sin": (-1e3, 1e3), "cos": (-1e3, 1e3), "tan": (-1.5, 1.5), "asin": (-1.0, 1.0), "acos": (-1.0, 1.0),
    "atan": (-50.0, 50.0), "atan2": (-3.0, 3.0), "exp": (-700.0, 700.0), "log": (1e-300, 1e3), "pow": (0.01, 20.0),
    "hypot": (-10.0, 10.0), "log1p": (-0.9, 5.0), "expm1": (-5.0, 5.0), "sinh": (-30.0, 30.0), "cosh": (-30.0, 30.0),
    "tanh": (-25.0, 25.0), "asinh": (-50.0, 50.0), "acosh": (1.0, 50.0), "atanh": (-0.999, 0.999), "erf": (-7.0, 7.0),
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


@pytest.mark.parametrize("name", ["log1p", "expm1", "sinh", "tanh", "asinh", "atanh", "erf"])
def test_small_numbers_keep_their_digits(program: Path, name: str) -> None:
    x = 10.0 ** np.random.default_rng(2).uniform(-300, -1, 500)
    own, libm = values(program, [(name, float(s * each), 0.0) for each in x for s in (-1, 1)]).T
    assert (np.abs(own - libm) <= 2e-15 * np.abs(libm)).all()


EXACT = {"sqrt", "floor", "ceil", "fmod", "remainder"}
TWO = {"pow", "fmod", "remainder", "hypot", "atan2"}


@pytest.mark.skipif(shutil.which("nm") is None, reason="needs nm")
@pytest.mark.parametrize("width", [1, 2])
def test_no_function_of_generated_code_is_left_to_libm(program: Path, tmp_path: Path, width: int) -> None:
    """The operations of the generator, compiled with the functions of our own: what remains for libm is exact."""
    names = sorted(set(simd._CALLS.split()) & (set(FUNCTIONS) | EXACT))
    assert len(names) > 20
    calls = [
        f"vd {n}_(vd x, vd y) {{ return lane_{n}(x, y); }}" if n in TWO else f"vd {n}_(vd x) {{ return lane_{n}(x); }}"
        for n in names
    ]
    text = [f"#define PIAFFE_W {width}", '#include "own_math.h"', simd.SIMD_H, *calls, ""]
    (tmp_path / "all.c").write_text("\n".join(text))
    compiler = working()
    words = ["-std=c11", "-O2", "-fno-math-errno", "-c", "-fPIC", f"-I{program.parent}", "all.c", "-o", "all.o"]
    subprocess.run([*compiler.command, *compiler.flags, *words], cwd=tmp_path, check=True)
    told = subprocess.run(["nm", "-u", "all.o"], cwd=tmp_path, capture_output=True, text=True, check=True).stdout
    left = {line.split()[-1] for line in told.splitlines()}
    assert "fmod" in left
    assert {name for name in left if not name.startswith("_")} <= EXACT


def test_every_operation_of_the_generator_is_ours_or_exact() -> None:
    """A function that the generator learns needs one here."""
    exact = EXACT | {"fmin", "fmax", "fabs", "copysign", "sign"}
    logic = {"lt", "le", "eq", "ne", "not", "and", "or", "if_else_zero"}
    assert set(simd._CALLS.split()) <= set(FUNCTIONS) | exact | logic


def test_powers_with_whole_exponents_are_products(program: Path) -> None:
    own, libm = values(program, [("pow", x, n) for x in (0.5, -3.0, 7.0) for n in (-2.0, 0.0, 1.0, 3.0)]).T
    assert np.array_equal(own, libm)
    own, libm = values(program, [("pow", x, n) for x in (-1.5, 1.5) for n in (-66.0, 65.0, 66.0, 101.0)]).T
    assert np.allclose(own, libm, rtol=1e-13, atol=0.0)


def test_ends_of_the_range_are_those_of_libm(program: Path) -> None:
    points = [
        ("exp", 710.0, 0.0), ("exp", -800.0, 0.0), ("exp", -740.0, 0.0), ("exp", np.inf, 0.0), ("log", 0.0, 0.0),
        ("log", 5e-324, 0.0), ("log", np.inf, 0.0), ("atan2", 0.0, 0.0), ("atan2", -0.0, 0.0),
        ("atan2", -1.0, -0.0),
        ("log1p", -1.0, 0.0), ("log1p", np.inf, 0.0), ("log1p", -0.0, 0.0), ("expm1", 800.0, 0.0),
        ("expm1", -800.0, 0.0),
        ("expm1", -0.0, 0.0), ("sinh", 710.2, 0.0), ("sinh", -800.0, 0.0), ("cosh", 710.2, 0.0), ("cosh", np.inf, 0.0),
        ("tanh", -800.0, 0.0), ("tanh", -0.0, 0.0), ("asinh", -1e300, 0.0), ("asinh", np.inf, 0.0),
        ("acosh", 1e300, 0.0),
        ("acosh", 1.0, 0.0), ("atanh", 1.0, 0.0), ("atanh", -1.0, 0.0), ("erf", np.inf, 0.0), ("erf", -np.inf, 0.0),
        ("erf", -0.0, 0.0),
    ]  # fmt: skip
    own, libm = values(program, points).T
    assert np.allclose(own, libm, rtol=2e-15, atol=5e-324)
    assert np.array_equal(np.signbit(own), np.signbit(libm))
    assert np.isnan(
        values(
            program,
            [("log", -1.0, 0.0), ("exp", np.nan, 0.0), ("sin", np.inf, 0.0)]
            + [
                (name, np.nan, 0.0)
                for name in ("log1p", "expm1", "sinh", "cosh", "tanh", "asinh", "acosh", "atanh", "erf")
            ]
            + [("log1p", -2.0, 0.0), ("acosh", 0.5, 0.0), ("atanh", 1.5, 0.0)],
        )[:, 0]
    ).all()
