"""Links lead somewhere, the pages build without a warning, and the code in them is the code that runs."""

import ast
import os
import re
import runpy
import subprocess
import sys
from pathlib import Path

import pytest

from piaffe import models, ocp
from piaffe.cli.app import main
from piaffe.models import robots
from piaffe.models.robots import known
from tests.api_names import FACES, INTERNAL

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


def blocks_of(page: str) -> dict[str, str]:
    """Return the Python blocks of a page by the heading that each stands under; there is one under each."""
    found: dict[str, str] = {}
    parts = re.split(r"^## (.+)$", (CHECKOUT / "docs" / page).read_text(), flags=re.MULTILINE)
    for heading, text in zip(parts[1::2], parts[2::2], strict=True):
        (found[heading],) = re.findall(r"^```python\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    return found


EXTENSIONS = blocks_of("extending.md")


@pytest.mark.parametrize("heading", EXTENSIONS)
def test_example_of_an_extension_runs(heading: str, tmp_path: Path) -> None:
    file = tmp_path / "extension.py"
    file.write_text(EXTENSIONS[heading])
    assert runpy.run_path(str(file), run_name="__main__")


def test_sampler_of_the_extensions_is_run_by_the_command_line(tmp_path: Path) -> None:
    (tmp_path / "my_sampler.py").write_text(EXTENSIONS["A sampler of your own"])
    code = main(["mppi", str(tmp_path / "my_sampler.py"), "--controller", "best-ten", "--steps", "50", "--seeds", "2"])
    assert code == 0


def test_robot_of_the_extensions_is_loaded_by_its_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "my_dog.py").write_text(EXTENSIONS["A robot"])
    monkeypatch.setattr(robots, "__path__", [*robots.__path__, str(tmp_path)])
    known._robots.cache_clear()
    try:
        assert models.load("my_dog").foot_radius == 0.02
        assert [str(finding) for finding in models.diagnose("my_dog") if finding.severity == "error"] == []
    finally:
        known._robots.cache_clear()
        sys.modules.pop(f"{robots.__name__}.my_dog")
        del robots.my_dog  # type: ignore[attr-defined]  # an import leaves it there


def test_gait_of_ones_own_in_authoring_is_a_gait() -> None:
    blocks = re.findall(r"^```python\n(.*?)^```$", (CHECKOUT / "docs" / "authoring.md").read_text(), re.M | re.S)
    (block,) = (block for block in blocks if "gaits.gait(" in block)
    names: dict[str, object] = {"models": models}
    exec(block, names)
    (amble,) = (value for value in names.values() if isinstance(value, ocp.Motion))
    body = models.SingleRigidBody(models.load("solo12"))
    problem = ocp.Problem(
        amble.cycles(1), body.until_end(dt=0.05), ocp.Objective(ocp.regularize("feet.force", 1.0)), initial=body.state()
    )
    assert ocp.compile_problem(problem).phases


def test_readme_shows_the_example_that_runs() -> None:
    (block,) = re.findall(r"^```python\n(.*?)^```$", (CHECKOUT / "README.md").read_text(), re.MULTILINE | re.DOTALL)
    assert block == (CHECKOUT / "examples" / "barrel_roll.py").read_text()


def test_first_maneuver_is_an_example() -> None:
    blocks = re.findall(r"^```python\n(.*?)^```$", (CHECKOUT / "docs" / "first_maneuver.md").read_text(), re.M | re.S)
    assert blocks == [(CHECKOUT / "examples" / "sideways_hop.py").read_text()]


def test_first_maneuver_shows_where_the_feet_are() -> None:
    robot = models.load("mini_cheetah")
    text = (CHECKOUT / "docs" / "first_maneuver.md").read_text()
    assert f"base {robot.base_height('stand'):.4f} m above the ground\n" in text
    for name, place in robot.forward_kinematics("stand", rpy=(0, 0, 0.2)).items():
        assert f"foot {name} at ({', '.join(f'{each:.4f}' for each in place)}) m\n" in text


def test_gallery_shows_every_example() -> None:
    examples = {page.name for page in (CHECKOUT / "examples").iterdir() if page.suffix in (".py", ".ipynb")}
    assert examples == set(re.findall(r"^## (\S+)$", (CHECKOUT / "examples" / "README.md").read_text(), re.MULTILINE))


def public_names(face: Path) -> set[str]:
    """Return what a package's front page imports for others, type checkers' imports included."""
    imports = (node for node in ast.walk(ast.parse(face.read_text())) if isinstance(node, ast.ImportFrom))
    return {alias.asname for node in imports for alias in node.names if alias.asname and alias.asname[0] != "_"}


@pytest.mark.parametrize("package", FACES)
def test_every_public_name_is_on_the_api_page_or_internal_for_a_reason(package: str) -> None:
    public = public_names(CHECKOUT / FACES[package] / "__init__.py")
    page = (CHECKOUT / "docs" / "api" / f"{package}.md").read_text()
    shown = {part for path in SHOWN.findall(page) for part in path.split(".")}
    assert public - shown - set(INTERNAL[package]) == set()
    assert set(INTERNAL[package]) - public == set(), "listed as internal, but gone"
    assert set(INTERNAL[package]) & shown == set(), "internal, and shown"
    assert all(len(reason) > 10 for reason in INTERNAL[package].values())


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
