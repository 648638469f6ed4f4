"""The studies of published results: problems, kept results, counts, tables, and a short run of each."""

import importlib
import json
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from piaffe import ocp, simulation, solvers

FOLDER = Path(__file__).resolve().parents[2] / "benchmarks" / "studies" / "cafe"
NAMES = ("published", "fig6", "table2", "fig8", "fig9", "fig11")


@pytest.fixture(scope="module")
def studies():
    pytest.importorskip("daqp")
    sys.path.insert(0, str(FOLDER))
    yield SimpleNamespace(**{name: importlib.import_module(name) for name in NAMES})
    sys.path.remove(str(FOLDER))
    for name in NAMES:
        del sys.modules[name]


@pytest.fixture
def here(studies, tmp_path, monkeypatch):
    for name in NAMES:
        monkeypatch.setattr(getattr(studies, name), "HERE", tmp_path)
    monkeypatch.setattr(studies.published, "PICTURES", tmp_path)
    return tmp_path


@pytest.mark.parametrize(("tail", "dt", "nodes"), [(0.0, 0.05, 25), (0.5, 0.05, 35), (2.0, 0.01, 225)])
def test_schedules_have_the_published_nodes(studies, tail, dt, nodes):
    problem = studies.published.problem("bound", tail, dt)
    assert sum(round(segment.duration / segment.dt) for segment in problem.schedule.segments) == nodes


def test_the_cost_at_the_switch_is_the_terminal_cost_of_one_step(studies):
    own = {term.quantity: term for term in studies.published.terminal("end")}
    for term in studies.published.terminal(factor=1 / studies.published.HEAD_DT):
        labels = tuple(str(i) for i in range(3))
        if np.size(term.weight) == 3 or term.quantity.path.startswith("base"):
            expected = own[term.quantity].weights("", labels)
            assert studies.published.HEAD_DT * term.weights("", labels) == pytest.approx(expected)


def test_a_kept_result_is_not_made_again(studies, tmp_path):
    cells, made = studies.published.Cells(tmp_path / "a.work"), []

    def make(value):
        made.append(value)
        return {"value": value}

    assert [cells.get("seed 1", make, 3.5), cells.get("seed 1", make, 4.5)] == [{"value": 3.5}] * 2
    assert made == [3.5]


def test_a_study_that_was_stopped_leaves_no_half_result(studies, tmp_path):
    cells = studies.published.Cells(tmp_path)

    def stopped():
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        cells.get("seed1", stopped)
    assert not any(tmp_path.iterdir())


def test_trials_are_those_of_the_line_search(studies):
    options = solvers.Options()
    # a full step; half a step after it; from 8 times the last step (at most 1) again; none down to 1/1000
    assert studies.table2.trials_of([1.0], options) == 1
    assert studies.table2.trials_of([1.0, 0.25], options) == 1 + 3
    assert studies.table2.trials_of([0.0625, 0.5], options) == 5 + 1
    assert studies.table2.trials_of([0.0], options) == 10


def program(floor):
    """The point nearest to (1, 1) whose components are at least ``floor``."""
    return SimpleNamespace(H=np.eye(2), g=np.array([-1.0, -1.0]), C=np.eye(2), d=np.array(floor, dtype=float))


@pytest.mark.parametrize(
    ("floor", "first", "expected"),
    [
        ((0, 0), (False, False), (1, 1)), ((2, 0), (False, False), (2, 2)), ((2, 0), (True, False), (1, 2)),
        ((2, 3), (False, False), (3, 3)), ((0, 0), (True, False), (2, 1)), ((2, -np.inf), (False, False), (2, 2)),
    ],
)  # fmt: skip
def test_iterations_are_changes_of_the_active_rows_and_one(studies, floor, first, expected):
    found, active = studies.fig11.by_daqp(program(floor), np.array(first))
    assert (found, studies.fig11.by_own(program(floor), np.array(first))) == expected
    assert active.tolist() == [each > 1 for each in floor]


def test_programs_without_a_solution_are_counted_as_such(studies):
    impossible = program((2, 0))
    impossible.C = np.array([[1.0, 0.0], [-1.0, 0.0]])
    nothing = np.zeros(2, dtype=bool)
    assert studies.fig11.by_daqp(impossible, nothing)[0] == studies.fig11.by_own(impossible, nothing) == 0


def test_feedback_is_not_kept_within_limits(studies):
    low = SimpleNamespace()
    u = np.array([100.0, -100.0])
    assert np.array_equal(studies.fig9.FreeRiccati.bounded(low, None, None, u), u)


def test_tables_are_those_of_their_numbers_and_of_enough_seeds():
    found = {path.stem: json.loads(path.read_text(encoding="utf-8"))["rows"] for path in FOLDER.glob("*[0-9].json")}
    assert found.keys() >= {"fig6", "fig8", "fig9", "fig11"}
    for name in found.keys() & {*NAMES}:
        header, *lines = (FOLDER / f"{name}.csv").read_text(encoding="utf-8").splitlines()
        assert header == ",".join(found[name][0])
        assert lines == [",".join(str(value) for value in row.values()) for row in found[name]]
    assert all(row["seeds"] >= 10 for name in ("fig6", "fig8") for row in found[name])
    assert all(row["pushes"] >= 20 for row in found["fig9"])


@pytest.mark.slow
def test_studies_run_from_episodes_to_figures(studies, here):
    runs = studies.published.Runs("bound", 0.1)
    run = runs(500, 0.2)
    assert isinstance(run, simulation.OnlineEpisode)
    assert studies.fig6.of_episode(run)["end"] == pytest.approx(0.2)
    rows = studies.fig6.main(1, tails=(0.0, 0.1), seconds=0.2)
    assert [(row["schedule"], row["dt_s_ms"]) for row in rows] == [("S0", 50), ("S1", 50), ("S1", 10)]
    assert studies.fig8.main(1, tails=(0.1,), seconds=0.2)[0]["speed_m_per_s"] < 0.5
    assert {path.name for path in here.iterdir()} >= {
        "fig6.csv",
        "fig6.json",
        "cafe_fig6.png",
        "fig8.csv",
        "cafe_fig8.png",
    }
    told = studies.fig11.of_seed(runs, 500, 0.2)["early"]
    assert all(sum(told[name].values()) == len(run.times) - 10 for name in studies.fig11.METHODS)  # while a plan acts
    for name in studies.fig9.LOWS:
        pushed = studies.fig9.run_of(runs, name, "y", 500, 2.8)
        assert studies.fig9.of_episode(pushed)["slip"] >= 0
    measured = studies.table2.measure("bound", 0.05, (0.1,), 0.2)
    assert measured[0]["iterations"] <= 4 <= measured[0]["trials"] + 3


def test_every_problem_of_the_table_compiles(studies):
    for gait in studies.table2.TABLE:
        problem = studies.published.problem(gait, 0.1)
        assert isinstance(problem, ocp.Problem)
