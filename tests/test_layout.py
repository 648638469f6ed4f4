"""The four folders are reached as piaffe.*, and only so."""

import importlib
import importlib.util
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


def test_version_is_a_release_number() -> None:
    assert all(part.isdigit() for part in piaffe.__version__.split("."))
    assert len(piaffe.__version__.split(".")) == 3
