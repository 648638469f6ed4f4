"""What `pip install piaffe` gives: built from the sdist, installed with its dependencies into an empty environment."""

import os
import shutil
import subprocess
import sys
import venv
import zipfile
from collections.abc import Iterator
from email.parser import Parser
from pathlib import Path

import pytest

CHECKOUT = Path(__file__).resolve().parents[1]

# Learning is built on JAX and Flax, which the sampling extra brings; without them, the error says so.
IMPORT_ALL = """
import importlib, pkgutil, piaffe
learning = {"piaffe.sampling.learning." + name for name in ("checkpoints", "learn", "modules")}
for module in pkgutil.walk_packages(piaffe.__path__, "piaffe."):
    if not module.name.endswith("__main__") and module.name not in learning:
        importlib.import_module(module.name)
        print(module.name)
"""


def run(*command: str | Path, cwd: Path) -> str:
    """Run a command outside of this process' Python settings and return what it printed."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "PYTEST"))}
    done = subprocess.run(list(map(str, command)), cwd=cwd, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, f"{' '.join(map(str, command))}\n{done.stdout}\n{done.stderr}"
    return done.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build sdist and wheel from a copy: leftovers of earlier builds in the checkout stay out of it."""
    folder = tmp_path_factory.mktemp("wheel")
    leftovers = shutil.ignore_patterns(".*", "results", "build", "dist", "site", "*.egg-info", "__pycache__")
    copy = shutil.copytree(CHECKOUT, folder / "checkout", symlinks=True, ignore=leftovers)
    run(sys.executable, "-m", "build", "--no-isolation", "--outdir", folder / "dist", copy, cwd=folder)
    (built,) = (folder / "dist").glob("*.whl")
    return built


@pytest.fixture(scope="module")
def empty_environment(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Install the wheel and the dependencies that it declares, no others; return the folder of its programs."""
    folder = tmp_path_factory.mktemp("environment")
    venv.create(folder, with_pip=True)
    run(folder / "bin" / "python", "-m", "pip", "install", "--no-compile", wheel, cwd=folder)
    yield folder / "bin"
    shutil.rmtree(folder)  # more than a gigabyte


def test_wheel_needs_no_compiler(wheel: Path) -> None:
    assert wheel.name.endswith("-py3-none-any.whl")


def test_wheel_holds_the_package_and_nothing_else(wheel: Path) -> None:
    tops = {name.split("/")[0] for name in zipfile.ZipFile(wheel).namelist()}
    assert {top for top in tops if not top.endswith(".dist-info")} == {"piaffe"}


def test_wheel_holds_every_module_and_data_file(wheel: Path) -> None:
    folders = {"": CHECKOUT / "src" / "piaffe"}
    folders |= {f"{name}/": CHECKOUT / name for name in ("ocp", "models", "solvers", "sampling")}
    expected = {
        f"piaffe/{prefix}{file.relative_to(folder)}"
        for prefix, folder in folders.items()
        for file in folder.rglob("*")
        if file.is_file() and "__pycache__" not in file.parts
    }
    assert {"piaffe/py.typed", "piaffe/models/robots/urdf/mini_cheetah.urdf", "piaffe/ocp/__init__.py"} <= expected
    assert expected - set(zipfile.ZipFile(wheel).namelist()) == set()


def test_metadata_names_licence_and_python(wheel: Path) -> None:
    archive = zipfile.ZipFile(wheel)
    (path,) = (name for name in archive.namelist() if name.endswith(".dist-info/METADATA"))
    metadata = Parser().parsestr(archive.read(path).decode())
    assert metadata["License-Expression"] == "BSD-3-Clause"
    assert metadata["Requires-Python"] == ">=3.11"
    extras = {"sampling", "compiler", "log", "qp", "bench", "docs", "dev", "all"}
    assert set(metadata.get_all("Provides-Extra", [])) == extras


def test_every_module_imports_in_an_empty_environment(empty_environment: Path) -> None:
    imported = run(empty_environment / "python", "-c", IMPORT_ALL, cwd=empty_environment).split()
    assert {"piaffe.ocp", "piaffe.models", "piaffe.solvers", "piaffe.sampling", "piaffe.cli"} <= set(imported)


def test_command_line_runs_in_an_empty_environment(empty_environment: Path) -> None:
    assert "solve" in run(empty_environment / "piaffe", "--help", cwd=empty_environment)
