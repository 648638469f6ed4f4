"""Links lead somewhere, the pages build without a warning, and the code in them is the code that runs."""

import ast
import os
import re
import runpy
import subprocess
import sys
from pathlib import Path

import pytest

from piaffe import ocp

CHECKOUT = Path(__file__).resolve().parents[1]
PAGES = sorted([*CHECKOUT.glob("*.md"), *(CHECKOUT / "docs").rglob("*.md"), *(CHECKOUT / "examples").glob("*.md")])
CODE = re.compile(r"^```.*?^```$|`[^`\n]*`", re.MULTILINE | re.DOTALL)
SHOWN = re.compile(r"^::: (\S+)$", re.MULTILINE)  # an object whose documentation is drawn in here
LINK = re.compile(r"\[[^]]*\]\(\s*([^)\s]+)[^)]*\)")


def anchors(page: Path) -> set[str]:
    """Return the anchors of a page: of its headings, as GitHub and MkDocs form them, and of the API it shows."""
    text = CODE.sub("", page.read_text())
    headings = {re.sub(r"[^\w\- ]", "", heading) for heading in re.findall(r"^#+ (.+)$", text, re.MULTILINE)}
    return {heading.strip().lower().replace(" ", "-") for heading in headings} | set(SHOWN.findall(text))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(CHECKOUT)))
def test_links_lead_somewhere(page: Path) -> None:
    dead = []
    for target in LINK.findall(CODE.sub("", page.read_text())):
        if re.match(r"https?://|mailto:", target):
            continue  # the outside world is not ours to test
        path, _, anchor = target.partition("#")
        file = (page.parent / path).resolve() if path else page
        if not file.exists() or (anchor and anchor not in anchors(file)):
            dead.append(target)
    assert dead == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(CHECKOUT)))
def test_python_in_pages_is_python(page: Path) -> None:
    for block in re.findall(r"^```python\n(.*?)^```$", page.read_text(), re.MULTILINE | re.DOTALL):
        ast.parse(block)


@pytest.mark.parametrize(("page", "landmark"), [("quickstart.md", "hop = "), ("authoring.md", "def fall")])
def test_declaration_in_page_compiles(page: str, landmark: str, tmp_path: Path) -> None:
    blocks = re.findall(r"^```python\n(.*?)^```$", (CHECKOUT / "docs" / page).read_text(), re.MULTILINE | re.DOTALL)
    (block,) = (block for block in blocks if landmark in block)
    file = tmp_path / "declaration.py"
    file.write_text(block if "import" in block else f"from piaffe import ocp\n{block}")
    assert ocp.compile_problem(runpy.run_path(str(file))["problem"]).phases


def test_readme_shows_the_example_that_runs() -> None:
    (block,) = re.findall(r"^```python\n(.*?)^```$", (CHECKOUT / "README.md").read_text(), re.MULTILINE | re.DOTALL)
    assert block == (CHECKOUT / "examples" / "barrel_roll.py").read_text()


def test_gallery_shows_every_example() -> None:
    examples = {page.name for page in (CHECKOUT / "examples").iterdir() if page.suffix in (".py", ".ipynb")}
    assert examples == set(re.findall(r"^## (\S+)$", (CHECKOUT / "examples" / "README.md").read_text(), re.MULTILINE))


@pytest.mark.parametrize("package", ["ocp", "models", "solvers"])
def test_every_public_name_is_on_the_api_page(package: str) -> None:
    front_page = ast.parse((CHECKOUT / package / "__init__.py").read_text())
    imports = (node for node in front_page.body if isinstance(node, ast.ImportFrom))
    public = {alias.asname for node in imports for alias in node.names if alias.asname}
    page = (CHECKOUT / "docs" / "api" / f"{package}.md").read_text()
    shown = {part for path in SHOWN.findall(page) for part in path.split(".")}
    assert public - shown == set()


def test_every_decision_is_listed() -> None:
    folder = CHECKOUT / "docs" / "adr"
    listed = re.findall(r"\((\d{4}-[\w-]+\.md)\)", (folder / "index.md").read_text())
    assert listed == sorted(page.name for page in folder.glob("[0-9]*.md"))


def test_pages_build_without_a_warning(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path)]
    quiet = {**os.environ, "NO_MKDOCS_2_WARNING": "1"}  # the theme announces its successor at every build
    done = subprocess.run(command, cwd=CHECKOUT, env=quiet, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    assert (tmp_path / "api" / "ocp" / "index.html").is_file()
