"""The face of the figures imports what it shows when it is asked for it, and not before."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

from piaffe import viz

HEAVY = ("matplotlib", "mujoco", "imageio_ffmpeg", "PIL", "pinocchio", "casadi", "rich")


def declared() -> dict[str, str]:
    """Return name → module of the imports that type checkers read."""
    tree = ast.parse(Path(viz.__file__).read_text())
    (block,) = (node for node in tree.body if isinstance(node, ast.If))
    imports = [node for node in block.body if isinstance(node, ast.ImportFrom)]
    return {alias.asname or alias.name: str(node.module) for node in imports for alias in node.names}


def loaded(code: str) -> set[str]:
    """Return the heavy packages that are imported after some code."""
    code += "\nimport sys\nprint(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return {name for name in done.stdout.split() if name in HEAVY}


def test_type_checkers_and_python_read_the_same_names() -> None:
    assert vars(viz)["_MODULES"] == declared()


@pytest.mark.parametrize("name", declared())
def test_every_name_is_the_one_of_its_module(name: str) -> None:
    found = getattr(viz, name)
    assert found.__name__ == name
    assert found.__module__ == f"piaffe.viz.{declared()[name]}"
    assert name in dir(viz)


def test_the_face_alone_imports_nothing_heavy() -> None:
    assert loaded("import piaffe.viz") == set()


def test_the_table_of_a_solve_imports_neither_figures_nor_a_simulator() -> None:
    assert loaded("from piaffe.viz import LiveTable") & {"matplotlib", "mujoco", "PIL", "imageio_ffmpeg"} == set()


def test_checks_of_a_films_arguments_do_not_import_mujoco() -> None:
    # how MuJoCo renders is settled by its import, so gl.prepare() comes first
    assert "mujoco" not in loaded("from piaffe.viz import gl, is_sheet, picture_size\nfrom piaffe.viz import Studio")


def test_an_unknown_name_is_refused_as_python_does() -> None:
    with pytest.raises(AttributeError, match=r"module 'piaffe\.viz' has no attribute 'draw_everything'"):
        _ = viz.draw_everything  # type: ignore[attr-defined]  # that is the test
