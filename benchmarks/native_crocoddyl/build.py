"""Build the timing program ``standing.cpp``: with Crocoddyl compiled from source for a target, or with its wheel.

The sources are the distributions of the versions that the benchmarks' environment has as wheels. Pinocchio is used as
headers alone, so that its algorithms are compiled for the target too. Of Crocoddyl the classes are compiled that the
program needs, each in a unit of its own and with the headers compiled first, as Crocoddyl's own build does it.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache
from hashlib import sha256
from importlib.metadata import version
from pathlib import Path

import crocoddyl

HERE = Path(__file__).parent
PROGRAM = HERE / "standing.cpp"
WORK = HERE.parents[1] / ".native-crocoddyl"
WHEELS = Path(crocoddyl.__file__).parents[4]  # what the wheels share: headers, and libraries in lib
SDISTS = {"libcrocoddyl": version("libcrocoddyl"), "libpinocchio": version("libpinocchio")}
EIGEN = "cmeel-eigen==3.4.1"
VERSIONS = tuple(f"{name}=={version(name)}" for name in (*SDISTS, "cmeel-boost"))
"""Of the wheels whose headers are used; where they lie makes no difference to what is compiled."""

WHEEL = "wheel"
OPTIMISATION = ("-O3", "-DNDEBUG")
LANGUAGE = ("-std=c++17", "-fPIC", "-w")
DEFINITIONS = (  # those that the CMake targets of Crocoddyl and of Pinocchio's headers export
    "-DPINOCCHIO_ENABLE_COMPATIBILITY_WITH_VERSION_2", "-DBOOST_MPL_LIMIT_LIST_SIZE=30",
    "-DBOOST_MPL_LIMIT_VECTOR_SIZE=30", "-DBOOST_MPL_CFG_NO_PREPROCESSED_HEADERS", "-DBOOST_FUSION_INVOKE_MAX_ARITY=12",
    "-DBOOST_BIND_GLOBAL_PLACEHOLDERS",
)  # fmt: skip
WHEEL_DEFINITIONS = (  # as the wheels were built; they use threads unless they are told not to
    "-DPINOCCHIO_ENABLE_TEMPLATE_INSTANTIATION", "-DPINOCCHIO_WITH_COLLISION", "-DCROCODDYL_WITH_MULTITHREADING",
    "-DCROCODDYL_WITH_NTHREADS=1", "-fopenmp",
)  # fmt: skip
WHEEL_LIBRARIES = ("crocoddyl", "pinocchio_default", "boost_serialization", "boost_filesystem")

PLAIN_UNITS = ("core/solver-base", "core/solvers/ddp", "core/solvers/fddp", "core/utils/exception",
               "core/utils/stop-watch", "core/utils/callbacks")  # fmt: skip
CLASSES = (  # units that Crocoddyl makes for each scalar type
    "core/action-base", "core/activation-base", "core/activations/quadratic", "core/activations/weighted-quadratic",
    "core/actuation-base", "core/constraint-base", "core/constraints/constraint-manager", "core/control-base",
    "core/controls/poly-zero", "core/cost-base", "core/costs/cost-sum", "core/costs/residual", "core/data/actuation",
    "core/data/joint", "core/data-collector-base", "core/diff-action-base", "core/integ-action-base",
    "core/integrator/euler", "core/optctrl/shooting", "core/residual-base", "core/residuals/control", "core/state-base",
    "multibody/actions/contact-fwddyn", "multibody/actuations/floating-base", "multibody/contact-base",
    "multibody/contacts/contact-3d", "multibody/contacts/multiple-contacts", "multibody/data/contacts",
    "multibody/data/multibody", "multibody/force-base", "multibody/residuals/state", "multibody/states/multibody",
)  # fmt: skip
LONGEST = "multibody_actions_contact-fwddyn"  # to compile; begun first
HEADERS = ("crocoddyl/core/pch.hpp", "crocoddyl/multibody/pch.hpp")


def program_for(target: str) -> Path:
    """Return the timing program, linked anew from objects that are compiled unless that was done.

    Args:
        target: what ``-march`` takes, for a Crocoddyl compiled from source; or ``"wheel"``, to use the wheel's.
    """
    folder = WORK / target
    folder.mkdir(parents=True, exist_ok=True)
    (_with_wheel if target == WHEEL else _from_source)(folder, target)
    return folder / "standing"


def flags_of(target: str) -> tuple[str, ...]:
    """Return how the program is compiled, and Crocoddyl where it is compiled from source."""
    return (*OPTIMISATION, f"-march={'x86-64' if target == WHEEL else target}")


@cache
def compiler() -> str:
    """Return the first line that the compiler says about itself."""
    try:
        told = subprocess.run([_cxx(), "--version"], capture_output=True, text=True, check=True).stdout
    except OSError as error:
        raise SystemExit(
            f"timing program: no C++ compiler - got {error.strerror} for {_cxx()!r}, expected g++; install it, or set "
            "CXX to another"
        ) from error
    return told.splitlines()[0]


def _cxx() -> str:
    return os.environ.get("CXX", "g++")


def _from_source(folder: Path, target: str) -> None:
    sources = {name: _unpacked(name) for name in SDISTS}
    headers = sources["libpinocchio"] / "include"
    flags = (
        *LANGUAGE, *flags_of(target), *DEFINITIONS, f"-I{sources['libcrocoddyl'] / 'include'}", f"-I{headers}",
        f"-I{headers / 'pinocchio/deprecated'}", f"-I{_eigen()}",
        "-isystem", str(WHEELS / "include"),  # Boost, and the headers that configuring writes
    )  # fmt: skip
    source, units = sources["libcrocoddyl"] / "src", {"standing": PROGRAM}
    units |= {name.replace("/", "_"): source / f"{name}.cpp" for name in PLAIN_UNITS}
    for name in CLASSES:
        template = next(path for kind in ("cpp", "cpp_fptype") if (path := source / f"{name}.{kind}.in").exists())
        unit = folder / f"{name.replace('/', '_')}.cpp"
        unit.write_text(template.read_text(encoding="utf-8").replace("@SCALAR_TYPE@", "double"), encoding="utf-8")
        units[unit.stem] = unit
    first = folder / "first.hpp"
    first.write_text("".join(f'#include "{header}"\n' for header in HEADERS), encoding="utf-8")
    flags_of_unit = (*flags, "-include", str(first))
    objects = {name: _Object(folder / f"{name}.o", unit, flags_of_unit) for name, unit in units.items()}
    stale = [objects[name] for name in sorted(units, key=lambda name: name != LONGEST) if not objects[name].made]
    if len(stale) > 1:
        print(f"Compiling Crocoddyl, {target}; this takes minutes.", file=sys.stderr, flush=True)
        _run([*flags, "-x", "c++-header", str(first), "-o", f"{first}.gch"])
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        list(pool.map(_Object.make, stale))
    Path(f"{first}.gch").unlink(missing_ok=True)  # half a gigabyte
    _link(folder, objects.values(), ("boost_serialization", "boost_filesystem"))


def _with_wheel(folder: Path, target: str) -> None:
    include = WHEELS / "include"
    flags = (
        *LANGUAGE, *flags_of(target), *DEFINITIONS, *WHEEL_DEFINITIONS, f"-I{_eigen()}", "-isystem", str(include),
        "-isystem", str(include / "pinocchio/deprecated"),
    )  # fmt: skip
    program = _Object(folder / "standing.o", PROGRAM, flags)
    if not program.made:
        program.make()
    _link(folder, [program], WHEEL_LIBRARIES)


@dataclass(frozen=True)
class _Object:
    """A compiled unit, with the digest of what it was made from beside it."""

    path: Path
    source: Path
    flags: Sequence[str]

    @property
    def recipe(self) -> str:
        flags = [flag.replace(str(WORK), "WORK").replace(str(WHEELS), "WHEELS") for flag in self.flags]
        parts = (compiler(), EIGEN, *VERSIONS, *flags, self.source.read_text(encoding="utf-8"))
        return sha256("\0".join(parts).encode()).hexdigest()

    @property
    def made(self) -> bool:
        stamp = self.path.with_suffix(".recipe")
        return self.path.exists() and stamp.exists() and stamp.read_text() == self.recipe

    def make(self) -> None:
        stamp = self.path.with_suffix(".recipe")
        stamp.unlink(missing_ok=True)
        _run([*self.flags, "-c", str(self.source), "-o", str(self.path)])
        stamp.write_text(self.recipe)


def _link(folder: Path, objects: Iterable[_Object], libraries: Iterable[str]) -> None:
    """Link, without the copies of Crocoddyl's classes in single precision that theirs can be turned into.

    They would double the time to compile, and nothing here turns one into the other. What is missing of them gets the
    address zero, in a program that is loaded where it was linked for.
    """
    place = WHEELS / "lib"
    paths = (f"-L{place}", "-Wl,--disable-new-dtags", f"-Wl,-rpath,{place}")  # also for what the libraries need
    named = [f"-l{name}" for name in libraries]
    linked = [str(made.path) for made in objects]
    leniently = ("-no-pie", "-Wl,--warn-unresolved-symbols")
    said = _run([*linked, *paths, *named, *leniently, "-o", str(folder / "standing")])
    missing = [line for line in said.splitlines() if "undefined reference" in line and "Tpl<float" not in line]
    if missing:
        raise SystemExit("timing program: not linked - add the units of these to build.py:\n" + "\n".join(missing[:20]))


def _run(arguments: Sequence[str]) -> str:
    """Run the compiler; return what it says."""
    done = subprocess.run([_cxx(), *arguments], capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"timing program: not built - got this from {_cxx()}:\n{done.stderr[-4000:]}")
    return done.stderr


def _unpacked(name: str) -> Path:
    """Return the folder of a source distribution, downloaded and unpacked now unless that was done."""
    folder = WORK / f"{name}-{SDISTS[name]}"
    if not folder.exists():
        _pip(
            "download", "--no-deps", "--no-build-isolation", "--no-binary", ":all:", "--dest", str(WORK),
            f"{name}=={SDISTS[name]}", PYTHONPATH=str(HERE / "metadata_only"),
        )  # fmt: skip
        shutil.unpack_archive(WORK / f"{folder.name}.tar.gz", WORK)
    return folder


def _eigen() -> Path:
    folder = WORK / "eigen"
    if not folder.exists():
        _pip("install", "--no-deps", "--target", str(folder), EIGEN)
    return folder / "cmeel.prefix" / "include" / "eigen3"


def _pip(*arguments: str, **environment: str) -> None:
    command = [sys.executable, "-m", "pip", "-q", "--disable-pip-version-check", *arguments]
    subprocess.run(command, env={**os.environ, **environment}, check=True)


if __name__ == "__main__":
    for wanted in sys.argv[1:]:
        print(program_for(wanted))
