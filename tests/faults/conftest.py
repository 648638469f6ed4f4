"""A small file system of its own, which fills up or becomes read-only; and the table of faults and their outcomes."""

import re
import subprocess
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest

FAULTS = (
    ("a killed writer, compiler or user of the cache", "a whole file; rests go with the next process", r"kill"),
    ("a full disk", "told before work begins, or the result is kept elsewhere", r"full_(?!.*read_only)|no_place"),
    ("a read-only disk", "told before work begins; libraries are used, or compiled elsewhere", r"read_only"),
    ("a noexec disk, or no folder at all", "a temporary folder, else NumPy, with one warning",
     r"noexec|no_folder|without_a_home"),
    ("a library that others could plant", "not loaded",
     r"another_user|others_can_write|umask|parents|root_is|out_of_the_root|shell|manifest"),
    ("destinations that cannot be", "refused before work begins", r"destination|within_a_film|files_of_others"),
    ("damaged, foreign, newer, oversized, nested files", "FileFormatError, or the same numbers",
     r"mutated|header|arrays|weights|bomb|memory|declared_size|nested|digest|toml|version|released"),
    ("Ctrl-C at random moments of compile, solve, plan, study", "exit 130; nothing is lost",
     r"interrupt|handler|another_thread|workers"),
    ("plans at late times", "the time and memory of early ones", r"late|grow|forgotten"),
)  # fmt: skip
"""Fault, what has to come of it, and a pattern for the names of its tests; the first pattern counts."""


def fault_of(name: str) -> str:
    """Return the fault of a test, by its name."""
    return next((fault for fault, _, pattern in FAULTS if re.search(pattern, name)), "other")


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Print the faults, their outcomes and the tests that passed, if only tests of this folder ran."""
    found: dict[str, Counter[str]] = {}
    for outcome in ("passed", "failed", "skipped", "error"):
        for report in terminalreporter.stats.get(outcome, []):
            path, _, name = report.nodeid.partition("::")
            if "tests/faults/" not in path:
                return
            found.setdefault(fault_of(name), Counter())[outcome] += 1
    if not found:
        return
    terminalreporter.section("faults and outcomes")
    for fault, expected, _ in (*FAULTS, ("other", "", "")):
        if fault in found:
            counts = ", ".join(f"{count} {outcome}" for outcome, count in found[fault].items())
            terminalreporter.write_line(f"{fault:56} {expected:68} {counts}")


@pytest.fixture
def mounted(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[Path]:
    """Return a file system of the size of the module's ``DISK``; the test is skipped where none can be mounted."""
    place, size = tmp_path / "mounted", request.module.DISK
    place.mkdir()
    done = subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(place)], capture_output=True)
    if done.returncode:
        pytest.skip("needs the right to mount a file system")
    try:
        yield place
    finally:
        subprocess.run(["umount", "-l", str(place)], check=True)
