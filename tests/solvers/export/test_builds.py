"""Builds of an exported controller for other processors, and under sanitizers."""

import re
import shlex
import shutil
import sys
from importlib.util import find_spec

import pytest

from tests.solvers.export.conftest import WARNINGS, Trot

pytestmark = pytest.mark.slow
QEMU = shutil.which("qemu-aarch64-static") or shutil.which("qemu-aarch64")
"""Debian: apt install qemu-user-static."""


def digest(output: str) -> str:
    found = re.search(r"digest of all numbers: (\w+)", output)
    assert found is not None, output
    return found[1]


def checked(trot: Trot, *words: str) -> str:
    done = trot.make("-j2", *words, "check")
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    assert done.stdout.rstrip().splitlines()[-1].startswith(("passed", "make"))
    return done.stdout


@pytest.mark.parametrize(
    "words", [("ARCH=", "W=1"), ("ARCH=", "W=2"), ("ARCH=", "W=4"), ("W=8",), ("CFLAGS=-DNDEBUG -fno-inline",)]
)
def test_other_flags_and_widths_pass_the_check(trot: Trot, words: tuple[str, ...]) -> None:
    assert "passed" in checked(trot, "BUILD=other", *words)
    assert trot.make("BUILD=other", "clean").returncode == 0


def test_reproducible_builds_compute_the_same_bits(trot: Trot) -> None:
    words = ("REPRODUCIBLE=1", f"CFLAGS={WARNINGS}")
    builds = (("W=2", "ARCH="), ("W=4", "ARCH=native"))
    digests = {digest(checked(trot, f"BUILD=same{i}", *build, *words)) for i, build in enumerate(builds)}
    assert len(digests) == 1
    assert digests != {digest(checked(trot))}


@pytest.mark.skipif(QEMU is None or find_spec("ziglang") is None, reason="needs qemu-user and ziglang")
def test_aarch64_computes_the_same_bits(trot: Trot) -> None:
    zig = shlex.join([sys.executable, "-m", "ziglang"])
    cross = (
        f"CC={zig} cc -target aarch64-linux-musl -fno-sanitize=undefined -g0", f"AR={zig} ar", "LDFLAGS=-static",
        f"RUN={QEMU}",
    )  # fmt: skip
    here = digest(checked(trot, "BUILD=same", "REPRODUCIBLE=1", "ARCH=", "W=2"))
    assert digest(checked(trot, "BUILD=arm", "REPRODUCIBLE=1", "ARCH=", "W=2", *cross)) == here


@pytest.mark.parametrize("target", ["sanitize", "threads"])
def test_random_ticks_under_sanitizers(trot: Trot, target: str) -> None:
    done = trot.make("-j2", target, "FUZZ=5000")
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-4000:]
    assert " 0 wrong outputs" in done.stdout


def test_threads_run_against_the_clock(trot: Trot) -> None:
    assert trot.make("build/loop").returncode == 0
    done = trot.make("loop")
    assert done.returncode == 0
    assert " 0 faults" in done.stdout


@pytest.mark.skipif(shutil.which("cppcheck") is None, reason="needs cppcheck")
def test_cppcheck_finds_nothing(trot: Trot) -> None:
    done = trot.make("cppcheck")
    assert done.returncode == 0, done.stderr[-3000:]
