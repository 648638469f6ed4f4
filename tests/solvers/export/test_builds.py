"""Builds of an exported controller for other processors, and under sanitizers."""

import re
import shlex
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest

from piaffe import simulation, solvers
from tests.solvers.export.conftest import HORIZONTAL, WARNINGS, Trot, load_module, vwbc

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
    if shutil.which("nm") is not None:
        library = str(trot.folder / "same0" / "libtrot.a")
        told = subprocess.run(["nm", "-u", library], capture_output=True, text=True, check=True).stdout
        needed = {line.split()[-1] for line in told.splitlines() if line.strip().startswith("U ")}
        assert "memcpy" in needed
        assert not needed & set(LIBM.split())


LIBM = "sin cos tan sincos asin acos atan atan2 sinh cosh tanh asinh acosh atanh exp expm1 log log1p pow hypot erf"


@pytest.mark.skipif(find_spec("ziglang") is None, reason="needs ziglang")
def test_clang_has_no_warnings_and_passes_the_check(trot: Trot) -> None:
    zig = shlex.join([sys.executable, "-m", "ziglang"])
    words = (f"CC={zig} cc -fno-sanitize=undefined -g0", f"AR={zig} ar", f"CFLAGS={WARNINGS}")
    assert "passed" in checked(trot, "BUILD=clang", *words)


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


@pytest.mark.parametrize("kind", ["adapting barrier", "riccati", "latency and retiming"])
def test_other_planners_and_low_levels_pass_the_check(trot: Trot, tmp_path: Path, kind: str) -> None:
    options: dict[str, Any] = {
        "adapting barrier": {"barrier": solvers.Adapting()}, "riccati": {},
        "latency and retiming": {"latency": 0.01, "retiming": solvers.Retiming()},
    }[kind]  # fmt: skip
    exported = solvers.export_controller(
        trot.exported.mpc.problem, tmp_path, name="other", options=options,
        low=solvers.Riccati if kind == "riccati" else vwbc,
    )  # fmt: skip
    recorder = exported.recorder()
    simulation.run_online(recorder, recorder, trot.plant, seconds=0.3, latency=options.get("latency", 0.0))
    (tmp_path / "check.bin").write_bytes(recorder.file())
    done = subprocess.run(["make", "-j2", "-C", str(tmp_path), "check"], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-2000:]
    assert "bitwise equal to the record" in done.stdout


def test_measured_contacts_are_given_in_c_and_in_python(trot: Trot, tmp_path: Path) -> None:
    exported = solvers.export_controller(
        trot.exported.mpc.problem, tmp_path, name="feeling",
        low=lambda plan: solvers.Vwbc(plan, leave_out=HORIZONTAL, contacts="measured"),
    )  # fmt: skip
    assert "`feeling_contacts(controller, flags)`" in (tmp_path / "README.md").read_text()
    made = subprocess.run(
        ["make", "-j2", "-C", str(tmp_path), f"CFLAGS={WARNINGS}", "all", "build/fuzz"], capture_output=True, text=True
    )
    assert made.returncode == 0, made.stderr[-2000:]
    controller = load_module(tmp_path / "python" / "feeling.py").Controller()
    start, mpc, low = exported.mpc.initial, exported.mpc, exported.low
    mpc.reset()
    low.follow(mpc.plan(start, 0.0))
    assert controller.reset(start, 0.0) == 0
    torques = []
    for k, flags in enumerate(([1, 0, 0, 1], [1, 1, 1, 1], [0, 0, 0, 0], [0, 0, 0, 0])):
        assert controller.contacts(flags) == 0
        torques.append(controller.tick(start, 0.002 * k).torque[:])
        assert torques[-1] == low.control(start, 0.002 * k, flags).tolist()
    assert torques[1] != torques[3]
