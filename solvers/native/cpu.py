"""This machine's processor: how many doubles it takes at once, and a fingerprint that no other kind shares."""

from __future__ import annotations

import hashlib
import os
import platform
from dataclasses import dataclass
from functools import cache
from pathlib import Path

_IDENTITY = (
    "vendor_id", "cpu family", "model",  # x86
    "CPU implementer", "CPU architecture", "CPU variant", "CPU part",  # ARM
)  # fmt: skip
_FEATURES = ("flags", "Features")


@dataclass(frozen=True)
class Cpu:
    """A processor, as far as compiled code depends on it.

    Args:
        machine: the architecture, e.g. ``"x86_64"``.
        name: for people.
        identity: vendor, family and model: what ``-march=native`` tunes for.
        features: those that every core has, e.g. ``"avx2"``.
        libc: the C library's version; code linked against a newer one does not load.
    """

    machine: str
    name: str
    identity: tuple[str, ...]
    features: frozenset[str]
    libc: str = ""

    @property
    def lanes(self) -> int:
        """Doubles per vector: 8 with AVX-512, 4 with AVX2 or as pairs of NEON registers, 2 with SSE2, else 1."""
        for lanes, features in ((8, {"avx512f"}), (4, {"avx2", "asimd"}), (2, {"sse2"})):
            if self.features & features:
                return lanes
        return 1

    @property
    def native(self) -> str:
        """The compiler's flag for code that only this processor has to run."""
        return "-mcpu=native" if self.machine in ("aarch64", "arm64") else "-march=native"

    @property
    def fingerprint(self) -> str:
        """Hexadecimal digits that differ wherever compiled code might not run."""
        parts = (self.machine, self.libc, *self.identity, *sorted(self.features))
        return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:32]

    def __str__(self) -> str:
        return self.name


def parse(cpuinfo: str, machine: str, libc: str = "") -> Cpu:
    """Return the processor that a text like ``/proc/cpuinfo`` describes."""
    name = ""
    identity: set[str] = set()
    cores: set[frozenset[str]] = set()
    for line in cpuinfo.splitlines():
        key, colon, value = line.partition(":")
        key, value = key.strip(), value.strip()
        if not colon:
            continue
        if key in _FEATURES:
            cores.add(frozenset(value.split()))
        elif key in _IDENTITY:
            identity.add(f"{key}: {value}")
        elif key == "model name":
            name = value
    features = frozenset.intersection(*cores) if cores else frozenset()
    return Cpu(machine, name or machine, tuple(sorted(identity)), features, libc)


@cache
def this_cpu() -> Cpu:
    """Return the processor of this machine."""
    source = Path("/proc/cpuinfo")
    try:
        libc = os.confstr("CS_GNU_LIBC_VERSION") or ""
    except (ValueError, OSError):  # not the GNU C library
        libc = ""
    return parse(source.read_text(encoding="utf-8") if source.exists() else "", platform.machine(), libc)


def available_cores() -> int:
    """Return the number of cores that this process may run on."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
