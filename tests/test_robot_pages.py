"""Each robot that is known by name has a page, whose numbers are those of its URDF."""

import runpy
from pathlib import Path

import pytest

from piaffe.models.robots import names

ROOT = Path(__file__).parents[1]
MADE = runpy.run_path(str(ROOT / "docs" / "robots" / "make.py"))


def test_every_legged_robot_has_a_page() -> None:
    assert set(MADE["NAMES"]) == set(names())


@pytest.mark.parametrize("name", MADE["NAMES"])
def test_a_page_is_what_the_robot_is(name: str) -> None:
    """If it is not: python docs/robots/make.py."""
    assert (ROOT / "docs" / "robots" / f"{name}.md").read_text(encoding="utf-8") == MADE["page"](name)
    assert (ROOT / "docs" / "assets" / "robots" / f"{name}.png").exists()
    assert f"robots/{name}.md" in (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
