"""The page of troubleshooting has every status and every warning."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

from piaffe.solvers import Status

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "troubleshooting.md").read_text(encoding="utf-8")
FORWARDED = {"models/legged.py"}  # it passes on what the doctor says about a URDF


def constant(node: ast.expr) -> Iterator[str]:
    """Yield the parts of a text that do not change."""
    if isinstance(node, ast.Constant):
        yield node.value
    elif isinstance(node, ast.JoinedStr):
        for value in node.values:
            yield from constant(value) if isinstance(value, ast.Constant) else ("\0",)
    elif isinstance(node, ast.BinOp | ast.Call):  # a sum of texts, or text.rstrip()
        for child in ast.iter_child_nodes(node):
            yield from constant(child)
    elif isinstance(node, ast.Attribute):
        yield from constant(node.value)


def warnings() -> list[tuple[str, str]]:
    """Return file and text of every warning, up to what was got."""
    found = []
    for folder in ("ocp", "models", "solvers"):
        for path in sorted((ROOT / folder).rglob("*.py")):
            tree = ast.parse(path.read_text(encoding="utf-8"))
            assigned = {
                node.targets[0].id: node.value
                for node in ast.walk(tree)
                if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name)
            }
            for node in ast.walk(tree):
                if not (isinstance(node, ast.Call) and getattr(node.func, "id", "") == "ProblemWarning"):
                    continue
                text = node.args[1]
                text = assigned.get(text.id, text) if isinstance(text, ast.Name) else text
                said = "".join(constant(text)).partition(" - got")[0]
                name = str(path.relative_to(ROOT))
                if name not in FORWARDED:
                    found.append((name, max(said.split("\0"), key=len).strip(" '")))
    return found


@pytest.mark.parametrize("status", Status)
def test_every_status_has_a_line(status) -> None:
    assert f"| `{status.name}` |" in PAGE


def test_there_are_warnings() -> None:
    assert len(warnings()) >= 18
    assert ("ocp/reports/grid.py", "the phase has few steps") in warnings()


@pytest.mark.parametrize(("file", "text"), sorted(set(warnings())))
def test_every_warning_has_a_line(file, text) -> None:
    assert len(text) > 10, f"{file}: write the warning so that its beginning does not change"
    assert f"| {text} |" in PAGE
