"""The study of rolls in a run: rows, their settings, and the causes of failures."""

import importlib
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from piaffe.errors import FileFormatError

STUDY = Path(__file__).resolve().parents[1] / "benchmarks" / "studies" / "cafe"


@pytest.fixture(scope="module")
def rolls():
    """Import the study as its script does."""
    sys.path.insert(0, str(STUDY))
    yield importlib.import_module("rolls")
    sys.path.remove(str(STUDY))


def test_rows_are_read_again_and_those_of_other_settings_are_refused(rolls, tmp_path):
    path = tmp_path / "episodes.csv"
    assert rolls.rows_so_far(path, "a") == []
    rolls.write_rows(path, [{"seed": 3, "success": 1, "settings": "a"}, {"seed": 0, "success": 0, "settings": "a"}])
    assert [row["seed"] for row in rolls.rows_so_far(path, "a")] == ["0", "3"]
    with pytest.raises(
        FileFormatError, match=r"^file 'episodes.csv': its rows are of other settings - got a, expected"
    ):
        rolls.rows_so_far(path, "b")


def test_committed_rows_are_of_the_examples_as_they_are(rolls):
    for name, task in rolls.TASKS.items():
        path = STUDY / name / "episodes.csv"
        rows = rolls.rows_so_far(path, rolls.digest(task))
        assert len({row["seed"] for row in rows}) == len(rows)
        summary = path.with_name("summary.md")
        if rows:
            good = sum(int(row["success"]) for row in rows)
            assert f"{good} of {len(rows)} seeds succeed." in summary.read_text(encoding="utf-8")


def test_times_of_a_roll_are_those_of_its_phases(rolls):
    roll_log = importlib.import_module("roll_log")
    phase = SimpleNamespace
    gait = SimpleNamespace(duration=2.0, phases=[])
    roll = [phase(name="lean", duration=0.2), phase(name="flight", duration=0.5), phase(name="land", duration=0.1)]
    problem = SimpleNamespace(motion=SimpleNamespace(pieces=(gait, SimpleNamespace(phases=roll))))
    found = roll_log.Roll.of(problem, 1)
    assert (found.begins, found.takes_off) == pytest.approx((2.0, 2.2))
    assert (found.lands, found.ends) == pytest.approx((2.7, 2.8))


@pytest.mark.parametrize(
    ("end", "success", "slip", "tilt", "touched", "expected"),
    [
        (6.0, True, 0.5, 3.0, {}, ""),
        (1.0, False, 0.5, 3.0, {}, "falls in the gait before"),
        (3.0, False, 0.05, 3.0, {}, "a foot slips by 50 mm before the take-off"),
        (2.5, False, 0.0, 3.0, {}, "falls before the landing"),
        (3.0, False, 0.0, 1.0, {}, "lands with a tilt of 1.00 rad"),
        (3.0, False, 0.0, 0.1, {"HL_KFE": 2.75}, "HL_KFE touches the ground in the landing"),
        (4.0, False, 0.0, 0.1, {"HL_KFE": 3.5}, "falls after the landing"),
    ],
)
def test_the_first_thing_that_explains_a_fall_is_its_cause(rolls, end, success, slip, tilt, touched, expected):
    roll_log = importlib.import_module("roll_log")
    roll = roll_log.Roll(begins=2.0, takes_off=2.2, lands=2.7, ends=2.8)
    episode = SimpleNamespace(success=success, end=end)
    assert roll_log.cause(episode, roll, slip, tilt, touched) == expected
