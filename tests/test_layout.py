"""The four folders are reached as piaffe.*, and only so."""

import ast
import importlib
import importlib.util
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

import piaffe

CHECKOUT = Path(__file__).resolve().parents[1]
FOLDERS = ("ocp", "models", "solvers", "sampling")
PACKAGE = CHECKOUT / "src" / "piaffe"


def modules_on_disk() -> list[str]:
    """Return the dotted name of every module of the checkout."""
    roots = [PACKAGE, *(PACKAGE / folder for folder in FOLDERS)]  # rglob does not follow links
    files = {file for root in roots for file in root.rglob("*.py")}
    names = {".".join(("piaffe", *file.relative_to(PACKAGE).with_suffix("").parts)) for file in files}
    return sorted(name.removesuffix(".__init__") for name in names if not name.endswith(".__main__"))


@pytest.mark.parametrize("folder", FOLDERS)
def test_folder_is_a_relative_link(folder: str) -> None:
    link = PACKAGE / folder
    assert link.is_symlink(), "git needs core.symlinks=true to check the four links out"
    assert link.readlink() == Path("..", "..", folder)
    assert (CHECKOUT / folder / "__init__.py").is_file()


@pytest.mark.parametrize("folder", FOLDERS)
def test_bare_folder_name_is_not_importable(folder: str) -> None:
    assert importlib.util.find_spec(folder) is None


@pytest.mark.parametrize("name", modules_on_disk())
def test_module_imports_under_piaffe(name: str) -> None:
    assert importlib.import_module(name).__name__ == name


def test_every_nested_folder_with_code_is_a_package() -> None:
    roots = [PACKAGE, *(PACKAGE / folder for folder in FOLDERS)]
    folders = {file.parent for root in roots for file in root.rglob("*.py")}
    assert [str(folder) for folder in folders if not (folder / "__init__.py").is_file()] == []


def imports_of(name: str, file: Path, known: set[str]) -> set[str]:
    """Return the modules of Piaffe that a module imports anywhere: for typing and within functions, too."""
    package = name if file.name == "__init__.py" else name.rpartition(".")[0]
    found = set()
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            above = package.split(".")[: len(package.split(".")) - node.level + 1] if node.level else []
            base = ".".join([*above, *([node.module] if node.module else [])])
            found |= {f"{base}.{alias.name}" if f"{base}.{alias.name}" in known else base for alias in node.names}
    return found & known - {name}


def circle_in(graph: dict[str, set[str]]) -> list[str]:
    """Return modules that import each other in a circle, none if there is no circle."""
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        circle: list[str] = error.args[1]
        return circle[::-1]
    return []


def test_no_modules_import_each_other_in_a_circle() -> None:
    files = {}
    for name in modules_on_disk():
        path = PACKAGE.joinpath(*name.split(".")[1:])
        files[name] = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
    graph = {name: imports_of(name, file, set(files)) for name, file in files.items()}
    assert len(graph) > 200
    assert sum(map(len, graph.values())) > 600
    upward = {"piaffe.ocp.compiler", "piaffe.ocp.reports", "piaffe.ocp.reports.describe"}
    graph["piaffe.ocp.language.problem"] -= upward  # print(problem) and problem.warnings()
    graph["piaffe.models.robot"] -= {"piaffe.models.inverse_kinematics"}  # robot.inverse_kinematics(...)
    assert circle_in(graph) == []


def test_a_circle_is_found() -> None:
    assert circle_in({"a": {"b", "d"}, "b": {"c"}, "c": {"b"}, "d": set()}) == ["b", "c", "b"]
    assert circle_in({"a": {"b", "c"}, "b": {"c"}, "c": {"d"}, "d": set()}) == []


def test_version_is_a_release_number() -> None:
    assert all(part.isdigit() for part in piaffe.__version__.split("."))
    assert len(piaffe.__version__.split(".")) == 3
