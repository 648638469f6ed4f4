"""Run ticks of the receding horizon where errors of memory show: a part of ``make sanitize``.

The ticks, the solver and their generated functions are compiled with AddressSanitizer and UndefinedBehaviorSanitizer
and loaded into Python. Between two arrays of the solver's memory, which is laid out again at every tick, there are
bytes that nothing may touch. Ticks must be those of NumPy. Arguments are structures of ``schedules.py``, ``robot`` and
motions of ``many_ticks.py``; by default all.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from piaffe.codegen import Built, build
from piaffe.codegen.compilers import working
from piaffe.solvers.ilqr.native import library
from piaffe.solvers.receding import program

from .found import Found
from .many_ticks import MOTIONS, run
from .random_ticks import random_case
from .schedules import kinds

SANITIZE = ("-fsanitize=address,undefined", "-fno-sanitize-recover=all")
COMMON = ("-g", "-fno-omit-frame-pointer", "-fno-math-errno", "-ffp-contract=fast", "{native}", *SANITIZE)
STRAIGHT = ("-O0", *COMMON)
KERNELS = ("-O1", *COMMON)
CHILD, SPOILT = "PIAFFE_TESTS_SANITIZED", "PIAFFE_TESTS_SPOILT"
"""Variables of the environment: the process has the runtime; arrays are one number too short, to test the test."""
RIGHT, WRONG = "(n ? n : 1) * sizeof(double)", "(n > 1 ? n - 1 : 1) * sizeof(double)"
SEEDS = {"robot": 3}
TICKS = 12


def runtime() -> str | None:
    """Return the libraries that must be loaded before Python; None if the compiler has none, as others than gcc.

    They are AddressSanitizer, and that of C++, whose exceptions it follows.
    """
    found = []
    for name in ("libasan.so", "libstdc++.so.6"):
        command = [*working().command, f"-print-file-name={name}"]
        path = Path(subprocess.run(command, capture_output=True, text=True, check=False).stdout.strip())
        if not (path.is_absolute() and path.exists()):
            return None
        found.append(str(path.resolve()))
    return " ".join(found)


def sanitized(units: Any, *, flags_per_unit: Mapping[str, Sequence[str]] | None = None, **more: Any) -> Built:
    """Build a library with sanitizers."""
    kernels = dict.fromkeys(flags_per_unit or {}, KERNELS)
    headers = dict(more.pop("headers", None) or {})
    if os.environ.get(SPOILT) and "layout.inc" in headers:
        assert RIGHT in headers["layout.inc"]
        headers["layout.inc"] = headers["layout.inc"].replace(RIGHT, WRONG)
    options = {"flags": STRAIGHT, "flags_per_unit": kernels, "link": ("-lm", *SANITIZE), "headers": headers or None}
    return build(units, **{**more, **options})


def check(name: str) -> str:
    """Run the ticks of a structure or motion; return what was done."""
    if name in MOTIONS:
        shown = run(name, TICKS, seed=3)
        return f"{shown.ticks} ticks and {shown.controls} controls, nothing found"
    found = Found()
    for seed in range(SEEDS.get(name, 12)):
        random_case(seed, found, robot=name == "robot", kind=None if name == "robot" else name)
    return f"{found.ticks} ticks of {SEEDS.get(name, 12)} schedules, nothing found"


def child(names: Sequence[str]) -> int:
    """Check names, in a process that has the runtime."""
    program.build = library.build = sanitized  # type: ignore[attr-defined, assignment]
    library.KERNEL_FLAGS = KERNELS  # type: ignore[attr-defined, misc]
    for name in names:
        sys.stdout.write(f"receding horizon, {name}: {check(name)}\n")
        sys.stdout.flush()
    return 0


def checked(names: Sequence[str], before: str, *, spoil: bool = False) -> subprocess.CompletedProcess[str]:
    """Check names in a process of its own, which loads the runtime first.

    Args:
        names: structures and motions.
        before: see :func:`runtime`.
        spoil: whether arrays are one number too short.
    """
    environment = {
        **os.environ, CHILD: "1", "LD_PRELOAD": before, "PYTHONMALLOC": "malloc",
        "ASAN_OPTIONS": "detect_leaks=0", "UBSAN_OPTIONS": "print_stacktrace=1", **({SPOILT: "1"} if spoil else {}),
    }  # fmt: skip
    command = [sys.executable, "-m", "tests.solvers.receding.memory", *names]
    return subprocess.run(command, env=environment, check=False, capture_output=True, text=True)


def main() -> int:
    """Check ticks; return 1 if something is found, 2 if nothing could be checked."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", default=[*kinds(), "robot", *MOTIONS])
    names = parser.parse_args().names
    if os.environ.get(CHILD):
        return child(names)
    before, found = runtime(), 0
    if before is None:
        sys.stdout.write("nothing checked: the compiler has no runtime of AddressSanitizer to load\n")
        return 2
    for name in names:
        ran = checked([name], before)
        found |= ran.returncode != 0
        sys.stdout.write(ran.stdout if ran.returncode == 0 else f"{name}: FOUND\n{ran.stdout}{ran.stderr[:6000]}\n")
        sys.stdout.flush()
    return found


if __name__ == "__main__":
    sys.exit(main())
