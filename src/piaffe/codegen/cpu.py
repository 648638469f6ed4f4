"""This machine's processor: its vector width, and a fingerprint that identifies its kind."""

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
    """The properties of a processor that compiled code depends on.

    Args:
        machine: the architecture, e.g. ``"x86_64"``.
        name: the name to show.
        identity: vendor, family and model, for which ``-march=native`` optimises.
        features: the features of every core, e.g. ``"avx2"``.
        libc: version of the C library; code that was linked with a newer version does not load.
    """

    machine: str
    name: str
    identity: tuple[str, ...]
    features: frozenset[str]
    libc: str = ""

    @property
    def vector_width(self) -> int:
        """Doubles per vector: 8 with AVX-512, 4 with AVX2 or as pairs of NEON registers, 2 with SSE2, else 1."""
        for width, features in ((8, {"avx512f"}), (4, {"avx2", "asimd"}), (2, {"sse2"})):
            if self.features & features:
                return width
        return 1

    @property
    def native(self) -> str:
        """The compiler's flag for code that runs on this processor only."""
        return "-mcpu=native" if self.machine in ("aarch64", "arm64") else "-march=native"

    @property
    def fingerprint(self) -> str:
        """Hexadecimal digits; compiled code runs on processors with the same fingerprint."""
        parts = (self.machine, self.libc, *self.identity, *sorted(self.features))
        return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:32]

    def __str__(self) -> str:
        return self.name


def parse(cpuinfo: str, machine: str, libc: str = "") -> Cpu:
    """Return the processor that the text of ``/proc/cpuinfo`` describes."""
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
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
