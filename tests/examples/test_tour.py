"""The notebook of the tour runs, and what its cells show is short."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

NOTEBOOK = Path(__file__).resolve().parents[2] / "examples" / "notebook_tour.ipynb"
RUN = """
import ast, contextlib, io, json, sys

names = {"__name__": "__main__"}
for cell in json.loads(open(sys.argv[1]).read())["cells"]:
    if cell["cell_type"] != "code":
        continue
    tree, shown = ast.parse("".join(cell["source"])), ""
    last = tree.body.pop() if isinstance(tree.body[-1], ast.Expr) else None
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        exec(compile(tree, cell["id"], "exec"), names)
        if last is not None:
            value = eval(compile(ast.Expression(last.value), cell["id"], "eval"), names)
            html = getattr(value, "_repr_html_", None)
            shown = "" if value is None else repr(value)
            if html is not None:
                assert html().count("<tr>") < 60, cell["id"]
    for text in (printed.getvalue(), shown):
        assert len(text.splitlines()) < 60 and len(text) < 4000, (cell["id"], len(text))
    print(cell["id"], "|", printed.getvalue().strip(), "|", shown)
"""


def test_the_tour_runs_in_ten_cells_with_short_outputs() -> None:
    cells = json.loads(NOTEBOOK.read_text())["cells"]
    assert sum(cell["cell_type"] == "code" for cell in cells) == 10
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", RUN, str(NOTEBOOK)], capture_output=True, text=True, check=False
    )
    if "DisplayError" in done.stderr:
        pytest.skip(done.stderr.splitlines()[-1])
    assert done.returncode == 0, done.stderr
    lines = done.stdout
    assert "Robot('mini_cheetah', 12 joints" in lines
    assert "Motion(3 phases, 0.74 s: push, flight, land)" in lines
    assert "Solution(CONVERGED" in lines
    assert "the simulation holds: True" in lines
    assert "Trajectory(3 phases, 0 to 0.74 s" in lines


def test_the_tour_is_kept_without_outputs() -> None:
    for cell in json.loads(NOTEBOOK.read_text())["cells"]:
        assert not cell.get("outputs")
        assert cell.get("execution_count") is None
