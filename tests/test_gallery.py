"""The gallery has every example, with a picture, and is what its script writes."""

import re
import runpy
from pathlib import Path

import pytest
from PIL import Image

ROOT = Path(__file__).parents[1]
MADE = runpy.run_path(str(ROOT / "docs" / "gallery" / "make.py"))
PAGE = ROOT / "docs" / "gallery" / "index.md"
PICTURES = ROOT / "docs" / "assets" / "gallery"
EXAMPLES = MADE["examples"]()


def test_the_page_is_what_the_script_writes() -> None:
    """If it is not: python docs/gallery/make.py --text."""
    assert PAGE.read_text(encoding="utf-8") == MADE["page"]()


def test_every_example_is_there_once() -> None:
    found = re.findall(r"^### (\S+)$", PAGE.read_text(encoding="utf-8"), re.MULTILINE)
    assert sorted(found) == EXAMPLES
    assert {path.name for path in (ROOT / "examples").glob("*.py")} <= set(found)
    assert {path.name for path in (ROOT / "examples").glob("*.ipynb")} <= set(found)


def test_an_example_that_no_heading_names_is_under_one_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(MADE["groups"].__globals__, "examples", lambda: [*EXAMPLES, "my_idea.py"])
    assert MADE["groups"]()[MADE["OTHERS"]] == ["my_idea.py"]
    assert [name for names in MADE["groups"]().values() for name in names].count("my_idea.py") == 1


@pytest.mark.parametrize("name", EXAMPLES)
def test_an_example_has_a_sentence_commands_and_code(name: str) -> None:
    text = "\n".join(MADE["entry"](name))
    assert MADE["sentence"](name).endswith(".")
    assert re.search(r"^```bash\n(.|\n)*examples(.|\n)*?^```$", text, re.MULTILINE)
    if name.endswith(".py"):
        assert f'    --8<-- "examples/{name}"' in text
    else:
        assert "from piaffe import" in text


@pytest.mark.parametrize("name", EXAMPLES)
def test_an_example_has_a_picture(name: str) -> None:
    """If it has none: python docs/gallery/make.py NAME."""
    path = PICTURES / MADE["picture"](name)
    assert path.stat().st_size < 60_000
    with Image.open(path) as picture:
        assert picture.format == "JPEG"
        assert picture.width == 956
        assert 150 < picture.height < 320
        assert len(set(picture.convert("L").resize((48, 12)).tobytes())) > 8  # it shows something


def test_pictures_are_few_and_small() -> None:
    files = sorted(PICTURES.iterdir())
    assert [path.name for path in files] == sorted(MADE["picture"](name) for name in EXAMPLES)
    assert sum(path.stat().st_size for path in files) < 2_500_000
