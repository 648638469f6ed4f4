"""Studies: grids of settings, and episodes that are kept as they are done."""

import threading
from collections.abc import Mapping
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from piaffe.errors import FileFormatError, SamplingError
from piaffe.sampling.study.records import load_episodes, save_episodes
from piaffe.sampling.study.study import Case, Study, grid, write_parquet
from piaffe.simulation.episode import Episode


def episode(seed: int = 0) -> Episode:
    random = np.random.default_rng(seed)
    return Episode(
        times=np.arange(4) * 0.02, states=random.normal(size=(4, 5)), actions=random.normal(size=(3, 2)),
        cost=random.uniform(size=3), reward=random.uniform(size=3), violation=random.uniform(size=(3, 3)),
        constraints=("hip", "hip", "height"), steps=3, fell=False, distance=0.5, commanded=0.6,
        plan_ms=random.uniform(size=3), effective_samples=random.uniform(size=3), failed_rollouts=seed,
    )  # fmt: skip


def cases(count: int = 4, **made_from: str) -> list[Case]:
    return [Case(f"H = {h}", {"horizon": h}, seed, made_from) for h in (4, 8) for seed in range(count // 2)]


def task(case: Case) -> tuple[Episode, Mapping[str, Any]]:
    return episode(case.seed), {"samples": 16}


class Immediate(Executor):
    """Runs a task when it is submitted."""

    def submit(self, task: Any, /, *given: Any, **named: Any) -> Future[Any]:
        future: Future[Any] = Future()
        try:
            future.set_result(task(*given, **named))
        except Exception as error:
            future.set_exception(error)
        return future


# ---- grids


def test_lists_are_varied_against_each_other_and_blocks_follow() -> None:
    found = grid([{"h": [1, 2], "n": [8, 9]}, {"h": 5}], {"n": 7, "c": "x"})
    assert [(each["h"], each["n"], each["c"]) for each in found] == [
        (1, 8, "x"), (1, 9, "x"), (2, 8, "x"), (2, 9, "x"), (5, 7, "x"),
    ]  # fmt: skip


def test_what_two_blocks_have_in_common_is_run_once() -> None:
    assert grid([{"h": [1, 2]}, {"h": [2, 3]}]) == [{"h": 1}, {"h": 2}, {"h": 3}]
    assert grid([{}], {"h": [1, 2]}) == [{"h": 1}, {"h": 2}]


def test_a_cell_is_its_settings_whatever_it_is_called() -> None:
    one, other = Case("a", {"h": 1, "n": 2}, 0), Case("b", {"n": 2, "h": 1}, 3)
    assert one.cell == other.cell != Case("a", {"h": 1, "n": 3}, 0).cell


# ---- files of episodes


def test_an_episode_is_read_as_it_was_written(tmp_path: Path) -> None:
    made = episode(3)
    save_episodes(tmp_path / "new" / "e.npz", {"seed 3": made}, {"horizon": 8})
    episodes, about = load_episodes(tmp_path / "new" / "e.npz")
    assert about == {"horizon": 8}
    read = episodes["seed 3"]
    np.testing.assert_array_equal(read.reward, made.reward)
    np.testing.assert_allclose(read.states, made.states, rtol=1e-6)
    assert read.constraints == made.constraints
    for key, value in made.summary().items():
        assert read.summary()[key] == pytest.approx(value, rel=1e-6)
    assert [path.name for path in (tmp_path / "new").iterdir()] == ["e.npz"]


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04 half a file", b"text"])
def test_a_foreign_file_is_refused(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "e.npz").write_bytes(content)
    with pytest.raises(FileFormatError, match=r"e.npz': holds no episodes that can be read - got .*, expected 'piaffe"):
        load_episodes(tmp_path / "e.npz")


# ---- running


def test_every_episode_is_run_once_and_kept(tmp_path: Path) -> None:
    study, heard = Study(cases(), tmp_path), []
    with ThreadPoolExecutor(2) as pool:
        assert study.run(task, pool, heard=lambda case, error: heard.append((case, error))) == {}
    assert {case for case, _ in heard} == set(study.cases)
    assert study.missing() == []
    rows = study.rows()
    assert [(row["label"], row["seed"], row["horizon"], row["samples"]) for row in rows] == [
        ("H = 4", 0, 4, 16), ("H = 4", 1, 4, 16), ("H = 8", 0, 8, 16), ("H = 8", 1, 8, 16),
    ]  # fmt: skip
    assert rows[1]["mean_reward"] == pytest.approx(episode(1).summary()["mean_reward"])
    assert rows[1]["missed_percent.hip"] == pytest.approx(episode(1).summary()["missed_percent"]["hip"], rel=1e-6)


def test_a_study_goes_on_where_it_was_left(tmp_path: Path) -> None:
    half = Study(cases()[:2], tmp_path)
    half.run(task, Immediate())
    ran = []

    def counted(case: Case) -> tuple[Episode, Mapping[str, Any]]:
        ran.append(case.settings["horizon"])
        return task(case)

    Study(cases(), tmp_path).run(counted, Immediate())
    assert ran == [8, 8]


def test_one_failure_does_not_stop_the_others(tmp_path: Path) -> None:
    def sometimes(case: Case) -> tuple[Episode, Mapping[str, Any]]:
        if case.settings["horizon"] == 4:
            raise SamplingError("no such controller")
        return task(case)

    study = Study(cases(), tmp_path)
    failures = study.run(sometimes, Immediate())
    assert [str(error) for error in failures.values()] == ["no such controller"] * 2
    assert set(failures) == set(study.missing()) == set(study.cases[:2])
    assert len(study.rows()) == 2


def test_a_worker_that_dies_is_told_with_what_to_do(tmp_path: Path) -> None:
    def dies(case: Case) -> tuple[Episode, Mapping[str, Any]]:
        raise BrokenProcessPool("killed")

    with pytest.raises(SamplingError, match="a worker died - got killed, expected it to run; .* fewer workers"):
        Study(cases(), tmp_path).run(dies, Immediate())


def test_ctrl_c_keeps_what_is_under_way(tmp_path: Path) -> None:
    begun, end = threading.Event(), threading.Event()

    def slow(case: Case) -> tuple[Episode, Mapping[str, Any]]:
        if case.seed == 1:
            begun.set()
            assert end.wait(10)
        return task(case)

    def interrupt(case: Case, error: BaseException | None) -> None:
        if case.seed == 0:
            assert begun.wait(10)
            end.set()
            raise KeyboardInterrupt

    study = Study(cases(), tmp_path)
    with ThreadPoolExecutor(1) as pool, pytest.raises(KeyboardInterrupt):
        study.run(slow, pool, heard=interrupt)
    assert study.cases[1] not in study.missing()
    assert study.cases[3] in study.missing()


def test_episodes_of_other_code_are_kept_or_redone_only_when_asked(tmp_path: Path) -> None:
    Study(cases(file="old"), tmp_path).run(task, Immediate())
    study = Study(cases(6, file="new"), tmp_path)
    with pytest.raises(SamplingError, match="got 4 of 6 from other contents of file, expected those of now; keep them"):
        study.run(task, Immediate())
    assert [case.seed for case in study.missing("keep")] == [2, 2]
    assert study.missing("redo") == list(study.cases)
    study.run(task, Immediate(), stale="redo")
    assert study.missing() == []


# ---- tables


def test_a_table_has_a_row_per_episode_and_plain_columns(tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    rows = [
        {"label": "a", "p": 1, "value": None, "mixed": 0.5},
        {"label": "b", "p": 2.5, "value": None, "mixed": {"hip": 1.0}, "late": True},
    ]
    table = parquet.read_table(write_parquet(tmp_path / "new" / "t.parquet", rows))
    assert table.to_pydict() == {
        "label": ["a", "b"], "p": [1.0, 2.5], "value": [None, None], "mixed": ["0.5", '{"hip": 1.0}'],
        "late": [None, True],
    }  # fmt: skip
    assert str(table.schema.field("value").type) == "string"
