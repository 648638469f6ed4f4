"""What a build of an exported controller is like on this machine: sizes, equality with the record, times."""

from __future__ import annotations

import hashlib
import json
import platform
import re
import shutil
import subprocess
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from piaffe.codegen import run_make, this_cpu
from piaffe.errors import SolverError
from piaffe.files import whole_file

from .readme import MEASURED

_CHECK = re.compile(r"(\d+) plans, (\d+) ticks; vectors of (\d+) numbers, .*; (\d+) bytes of memory")
_TIMES = re.compile(r"(plans|ticks) \[(?:ms|us)\]: (\d+), median (\S+), 99 % (\S+), worst (\S+)")
_LOOP = re.compile(r"(\d+) of \d+ plans missed, (\d+) of \d+ ticks late, (\d+) faults")


@dataclass(frozen=True)
class Measured:
    """What the checks of a build find.

    Args:
        library_bytes: size of the shared library.
        stripped_bytes: the same without its table of symbols; None if there is no ``strip``.
        memory_bytes: memory of a controller.
        width: doubles per vector.
        bitwise: whether all numbers are those of the record, bit for bit.
        plans: in the record.
        ticks: in the record.
        seconds: duration of the run against the clock [s].
        plan_ms: median, 99 % and worst time of a plan [ms].
        tick_us: the same of a tick [µs].
        missed_plans: plans that began a period late or more.
        late_ticks: ticks that began half a tick late or more.
        faults: plans and ticks with a status that is not ok.
        processor: of this machine.
    """

    library_bytes: int
    stripped_bytes: int | None
    memory_bytes: int
    width: int
    bitwise: bool
    plans: int
    ticks: int
    seconds: float
    plan_ms: tuple[float, float, float]
    tick_us: tuple[float, float, float]
    missed_plans: int
    late_ticks: int
    faults: int
    processor: str

    def told(self) -> dict[str, Any]:
        """Return the entries of a manifest."""
        return asdict(self)

    def words(self) -> str:
        """Return the result in a line."""
        same = "bitwise equal to the record" if self.bitwise else "equal to the record within rounding"
        return (
            f"{same}; plan {self.plan_ms[0]:.3g} ms, worst {self.plan_ms[2]:.3g} ms; "
            f"tick {self.tick_us[0]:.3g} µs, worst {self.tick_us[2]:.3g} µs"
        )

    def section(self) -> str:
        """Return the section of a README."""
        size = self.library_bytes if self.stripped_bytes is None else self.stripped_bytes
        stripped = "" if self.stripped_bytes is None else " without its table of symbols"
        same = "all numbers equal the record, bit for bit" if self.bitwise else "differences are as small as allowed"
        rows = ((f"{what} [{unit}]", *(f"{each:.3g}" for each in times)) for what, unit, times in (
            ("plan", "ms", self.plan_ms), ("tick", "µs", self.tick_us)))  # fmt: skip
        table = "".join(f"| {' | '.join(row)} |\n" for row in rows)
        return (
            f"## Measured\n\nOn the machine of the export ({self.processor}), vectors of {self.width} numbers.\n"
            f"`make check` of {self.plans} plans and {self.ticks} ticks: {same}.\n"
            f"`make loop` for {self.seconds:g} s, the measured state that of the motion's start: "
            f"{self.missed_plans} plans missed, {self.late_ticks} ticks late, {self.faults} faults.\n\n"
            f"| time | median | 99 % | worst |\n|---|---|---|---|\n{table}\n"
            f"The shared library has {size} bytes{stripped}, a controller {self.memory_bytes} bytes.\n\n"
        )


def measure(folder: Path, name: str, seconds: float) -> Measured:
    """Build, run the checks, and write what they find into ``manifest.json`` and ``README.md``.

    Args:
        folder: of the controller, with ``check.bin``.
        name: of the controller.
        seconds: duration of the run against the clock [s].

    Raises:
        SolverError: a build or a check fails.
    """
    if not seconds > 0:
        raise SolverError(f"export: seconds is out of range - got {seconds:g} s, expected a positive number; change it")
    if not (folder / "check.bin").is_file():
        raise SolverError(
            f"export '{folder}': there is no record - got no check.bin; write the file of a recorder there first"
        )
    run_make(folder, "all")
    checked = run_make(folder, "check")
    run_make(folder, "build/loop")
    words = [str((folder / "build" / "loop").resolve()), repr(float(seconds))]
    looped = subprocess.run(words, capture_output=True, text=True, check=False).stdout  # faults are a result, too
    found, times, loop = _CHECK.search(checked), _TIMES.findall(looped), _LOOP.search(looped)
    if found is None or loop is None or len(times) != 2:
        raise SolverError(
            f"export '{folder}': the checks print something else - got '{checked[-200:]}{looped[-200:]}', expected the "
            "figures of examples/main.c and loop.c of this version; export into a new folder, or run for longer"
        )
    library = folder / "build" / f"lib{name}.so"
    plan, tick = ((float(a), float(b), float(c)) for _, _, a, b, c in times)
    missed, late, faults = map(int, loop.groups())
    measured = Measured(
        library.stat().st_size, _stripped(library), int(found[4]), int(found[3]), "bitwise equal" in checked,
        int(found[1]), int(found[2]), seconds, plan, tick, missed, late, faults, str(this_cpu()) or platform.machine(),
    )  # fmt: skip
    _write(folder, measured)
    return measured


def _stripped(library: Path) -> int | None:
    program = shutil.which("strip")
    if program is None:
        return None
    copy = library.with_suffix(".stripped")
    try:
        done = subprocess.run([program, "-o", str(copy), str(library)], capture_output=True, check=False)
        return None if done.returncode else copy.stat().st_size
    finally:
        copy.unlink(missing_ok=True)


def _write(folder: Path, measured: Measured) -> None:
    readme, manifest = folder / "README.md", folder / "manifest.json"
    begin, middle = MEASURED.splitlines()[0], readme.read_text(encoding="utf-8")
    first = middle.index(begin)
    last = middle.index("\n## ", first) + 1
    text = middle[:first] + measured.section() + middle[last:]
    told = json.loads(manifest.read_text(encoding="utf-8"))
    told["measured"] = measured.told()
    told["files"]["README.md"] = hashlib.sha256(text.encode()).hexdigest()
    told["check_bin"] = hashlib.sha256((folder / "check.bin").read_bytes()).hexdigest()
    for path, content in ((readme, text), (manifest, json.dumps(told, indent=2) + "\n")):
        with whole_file(path) as temporary:
            temporary.write_text(content, encoding="utf-8")
