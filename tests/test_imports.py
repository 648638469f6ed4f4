"""What an import brings in: the packages of figures, films, simulators and learning come when they are used."""

import subprocess
import sys

HEAVY = ("matplotlib", "mujoco", "jax", "rich", "PIL", "pandas", "mcap", "typer", "pyarrow")


def modules_after(code: str) -> set[str]:
    line = [sys.executable, "-c", f"{code}\nimport sys\nprint(*sys.modules)"]
    return set(subprocess.run(line, capture_output=True, text=True, check=True).stdout.split())


def test_the_import_of_the_language_and_the_solvers_is_light() -> None:
    found = modules_after("from piaffe import models, ocp, solvers")
    assert [name for name in HEAVY if name in found] == []


def test_viz_loads_figures_when_one_is_made() -> None:
    found = modules_after("from piaffe import viz")
    assert [name for name in HEAVY if name in found] == []
    assert "matplotlib" in modules_after("from piaffe import viz\nviz.plot")
