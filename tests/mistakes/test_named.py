"""Every mistake is named by file and line before a solver iterates."""

import re
import warnings

import pytest

from piaffe import PiaffeWarning, ocp, solvers
from piaffe.cli.app import main
from piaffe.errors import PiaffeError
from tests.mistakes.mistakes import KINDS

HEAD = "from tests.mistakes.jump import *"
CASES = [pytest.param(each, id=f"{kind}: {each.name}") for kind, found in KINDS.items() for each in found]


def written(tmp_path, text):
    """Return a problem's file, and the number of the line at fault."""
    path = tmp_path / "declared.py"
    path.write_text(f"{HEAD}\n{text}\n")
    return path, path.read_text().split("# here")[0].count("\n") + 1


def messages(path, words):
    """Return what a solver says of a file before it iterates; it stops at a warning with these words."""
    with warnings.catch_warnings(record=True) as issued:
        warnings.simplefilter("always", PiaffeWarning)
        warnings.filterwarnings("error", f"(?s).*{re.escape(words)}", PiaffeWarning)
        try:
            solvers.MSiLQR(ocp.load_problem(str(path)), backend="numpy")
        except (PiaffeError, PiaffeWarning) as error:
            return [str(error)]
    return [str(each.message) for each in issued]


@pytest.mark.parametrize("mistake", CASES)
def test_a_mistake_is_named_with_its_line(mistake, tmp_path):
    path, line = written(tmp_path, mistake.text)
    found = messages(path, mistake.words)
    assert any(mistake.words in text and f"declared.py:{line}" in text for text in found), found


def test_every_kind_has_mistakes_and_there_are_sixty():
    assert min(map(len, KINDS.values())) >= 2
    assert sum(map(len, KINDS.values())) >= 60


def test_a_problem_without_a_mistake_gives_no_warning(tmp_path):
    for text in ("problem = jump()", "problem = drive()"):
        path, _ = written(tmp_path, text)
        assert messages(path, "nothing") == []


def test_solve_prints_a_warning_and_iterates(tmp_path, capsys):
    path, line = written(tmp_path, "problem = drive(ocp.Phase('go', 'roll', 0.2))  # here")
    assert main(["solve", str(path), "--backend", "numpy", "--no-save"]) == 0
    shown = capsys.readouterr()
    assert f"warning: phase 'go' (declared.py:{line}): the phase has few steps - got 2" in shown.err


def test_solve_refuses_an_error_with_its_line(tmp_path, capsys):
    path, line = written(tmp_path, "robot = models.load('go3')  # here")
    assert main(["solve", str(path)]) == 2
    assert f"error: declared.py:{line}: " in capsys.readouterr().err


def test_a_problem_lists_its_warnings_and_python_shows_each_once(tmp_path):
    path, line = written(tmp_path, "problem = drive(ocp.Phase('go', 'roll', 0.2))  # here")
    problem = ocp.load_problem(str(path))
    (warning,) = problem.warnings()
    assert (warning.source.file, warning.source.line) == (str(path), line)
    with warnings.catch_warnings(record=True) as issued:
        warnings.simplefilter("default", PiaffeWarning)
        for _ in range(3):
            assert solvers.MSiLQR(problem, backend="numpy").warnings == [warning]
    (shown,) = issued
    assert (shown.filename, shown.lineno, str(shown.message)) == (str(path), line, str(warning))
