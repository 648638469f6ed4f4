"""Files of solutions: everything comes back, nothing half-written stays, and what is no solution is refused clearly."""

import json
import os
import stat
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from piaffe import ocp
from piaffe.errors import FileFormatError, FileWriteError
from piaffe.solvers import MSiLQR, Options, PhaseSolution, Solution, Violation
from piaffe.solvers.solution import file as solution_file

from ..problems import flying_body, rope


@pytest.fixture(scope="module")
def solution() -> Solution:
    return MSiLQR(rope(), Options(max_iterations=5)).solve()


@pytest.fixture
def saved(solution: Solution, tmp_path: Path) -> Path:
    return solution.save(tmp_path / "rope.npz")


def rewrite(path: Path, **changes: object) -> None:
    """Change entries of a saved file's header; an entry that becomes None is removed."""
    with np.load(path) as stored:
        arrays = {name: stored[name] for name in stored.files}
    header = {**json.loads(bytes(arrays["header"])), **changes}
    header = {k: v for k, v in header.items() if v is not None}
    arrays["header"] = np.frombuffer(json.dumps(header).encode(), dtype=np.uint8)
    np.savez_compressed(path, **arrays)


def assert_equal(a: Solution, b: Solution) -> None:
    simple = [
        f.name for f in fields(Solution) if f.name not in ("trajectory", "phases", "term_costs", "models", "limits")
    ]
    assert {n: getattr(a, n) for n in simple} == {n: getattr(b, n) for n in simple}
    assert dict(a.term_costs) == dict(b.term_costs)
    assert json.dumps(dict(a.models)) == json.dumps(dict(b.models))
    assert json.dumps(list(a.limits)) == json.dumps(list(b.limits))
    for p, q in zip(a.trajectory.phases, b.trajectory.phases, strict=True):
        assert (p.name, p.mode, p.model, p.ends_phase) == (q.name, q.mode, q.model, q.ends_phase)
        assert (p.state, p.control) == (q.state, q.control)
        assert list(p.outputs) == list(q.outputs)
        for x, y in ((p.times, q.times), (p.states, q.states), (p.controls, q.controls)):
            np.testing.assert_array_equal(x, y)
        for x, y in zip(p.outputs.values(), q.outputs.values(), strict=True):
            np.testing.assert_array_equal(x, y)
    for p, q in zip(a.phases, b.phases, strict=True):
        for name in (f.name for f in fields(PhaseSolution) if f.name != "multipliers"):
            np.testing.assert_array_equal(getattr(p, name), getattr(q, name))
        assert set(p.multipliers) == set(q.multipliers)
        for name, value in p.multipliers.items():
            np.testing.assert_array_equal(value, q.multipliers[name])


# ---- round trip


def test_every_field_comes_back(solution: Solution, saved: Path) -> None:
    assert_equal(solution, Solution.load(saved))


def test_rotations_and_unfinished_solves_come_back(tmp_path: Path) -> None:
    solution = MSiLQR(flying_body(), Options(time_limit_s=1e-9)).solve()
    assert solution.history == ()
    assert_equal(solution, Solution.load(solution.save(tmp_path / "body.npz")))


def test_solution_from_a_file_warm_starts(solution: Solution, saved: Path) -> None:
    problem = rope()
    direct, loaded = (MSiLQR(problem, Options(max_iterations=3)).solve(s) for s in (solution, Solution.load(saved)))
    assert [r.cost for r in direct.history] == [r.cost for r in loaded.history]


def test_suffix_is_added_and_folders_are_made(solution: Solution, tmp_path: Path) -> None:
    path = solution.save(str(tmp_path / "new" / "folder" / "v1.2"))
    assert path == tmp_path / "new" / "folder" / "v1.2.npz"
    assert path.is_file()


def test_file_is_readable_by_whoever_the_umask_allows(saved: Path) -> None:
    plain = saved.with_name("plain")
    plain.touch()
    assert stat.S_IMODE(saved.stat().st_mode) == stat.S_IMODE(plain.stat().st_mode)


def test_arrays_are_plain_numpy(saved: Path) -> None:
    with np.load(saved, allow_pickle=False) as stored:
        assert stored["0/states"].shape == (21, 4)
        header = json.loads(bytes(stored["header"]))
    assert (header["format"], header["version"]) == (solution_file.FORMAT, solution_file.VERSION)


# ---- atomic


@pytest.mark.parametrize("error", [OSError("no space left"), KeyboardInterrupt()])
def test_write_that_breaks_off_leaves_the_old_file(
    solution: Solution,
    saved: Path,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path_factory: pytest.TempPathFactory,
    error: BaseException,
) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path_factory.mktemp("rescued")))
    before = saved.read_bytes()

    def half(descriptor: int) -> None:
        raise error

    monkeypatch.setattr(os, "fsync", half)
    with pytest.raises(OSError if isinstance(error, OSError) else type(error)):
        solution.save(saved)
    assert saved.read_bytes() == before
    assert [p.name for p in saved.parent.iterdir()] == [saved.name]


def test_broken_rename_leaves_the_old_file(solution: Solution, saved: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = saved.read_bytes()

    def fail(*arguments: object) -> None:
        raise PermissionError("no")

    monkeypatch.setattr(Path, "replace", fail)
    with pytest.raises(FileWriteError, match="cannot be written - got no, expected .* holds the content") as caught:
        solution.save(saved)
    kept = Path(str(caught.value).split("move '")[1].split("'")[0])
    assert_equal(Solution.load(kept), solution)
    kept.unlink()
    assert saved.read_bytes() == before
    assert [p.name for p in saved.parent.iterdir()] == [saved.name]


def test_saving_again_replaces_the_file(solution: Solution, saved: Path) -> None:
    saved.write_bytes(b"something else")
    solution.save(saved)
    assert_equal(solution, Solution.load(saved))


# ---- what is refused


@pytest.mark.parametrize("share", [0.0, 0.001, 0.1, 0.5, 0.9, 0.99, 0.9999])
def test_truncated_file(saved: Path, share: float) -> None:
    data = saved.read_bytes()
    saved.write_bytes(data[: int(share * len(data))])
    with pytest.raises(
        FileFormatError, match=r"file 'rope.npz': truncated or not an archive .*expected a .npz saved by"
    ):
        Solution.load(saved)


def test_damaged_file_is_refused_or_whole(solution: Solution, saved: Path) -> None:
    rng, data, refused = np.random.default_rng(0), saved.read_bytes(), 0
    for place in rng.integers(len(data), size=60):
        damaged = bytearray(data)
        damaged[place] ^= 0xFF
        saved.write_bytes(damaged)
        try:
            loaded = Solution.load(saved)
        except FileFormatError:
            refused += 1
        else:
            assert_equal(solution, loaded)  # a byte that nobody reads, such as a date
    assert refused > 30


@pytest.mark.parametrize(
    "content",
    [b"", b"PK", b"hello, world\n" * 50, b"\x89PNG\r\n\x1a\n" + bytes(100), b"\x93NUMPY\x01\x00", b"\x80\x04N."],
)
def test_file_of_another_kind(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "strange.npz"
    path.write_bytes(content)
    with pytest.raises(FileFormatError, match=r"file 'strange.npz': .*got .*expected a .npz saved by Piaffe"):
        Solution.load(path)


def test_single_array(tmp_path: Path) -> None:
    path = tmp_path / "array.npz"
    with path.open("wb") as stream:
        np.save(stream, np.zeros(3))
    with pytest.raises(FileFormatError, match=r"file 'array.npz'"):
        Solution.load(path)


def test_archive_of_another_program(tmp_path: Path) -> None:
    path = tmp_path / "foreign.npz"
    np.savez(path, a=np.zeros(3))
    with pytest.raises(FileFormatError, match=r"file 'foreign.npz': foreign archive - got no readable header"):
        Solution.load(path)


@pytest.mark.parametrize(
    "header", [b"", b"not json", b"[1, 2]", b'{"format": "other"}', b'"piaffe-solution"', b"\xff\xfe"]
)
def test_archive_with_another_header(tmp_path: Path, header: bytes) -> None:
    path = tmp_path / "foreign.npz"
    np.savez(path, header=np.frombuffer(header, dtype=np.uint8))
    with pytest.raises(FileFormatError, match=r"file 'foreign.npz': foreign archive .*expected"):
        Solution.load(path)


def test_pickled_objects_are_never_loaded(tmp_path: Path) -> None:
    path = tmp_path / "evil.npz"
    np.savez(path, header=np.array([{"format": "piaffe-solution"}], dtype=object))
    with pytest.raises(FileFormatError, match=r"file 'evil.npz'"):
        Solution.load(path)


def test_newer_version(saved: Path) -> None:
    rewrite(saved, version=solution_file.VERSION + 1)
    with pytest.raises(FileFormatError, match=r"newer Piaffe - got version 2, expected at most 1; upgrade Piaffe"):
        Solution.load(saved)


@pytest.mark.parametrize("version", [None, "two", [1]])
def test_version_that_is_no_number(saved: Path, version: object) -> None:
    rewrite(saved, version=version)
    with pytest.raises(FileFormatError, match=r"file 'rope.npz': .*version"):
        Solution.load(saved)


def test_violations_of_a_file_of_version_1_load(saved: Path) -> None:
    """The entries as version 1 has always written them, in its order."""
    entry = {
        "name": "force limit x upper", "phase": "throw", "node": 3, "amount": 0.25, "unit": "N", "kind": "inequality",
        "source": "problems.py:12", "multiplier": 1.5,
    }  # fmt: skip
    rewrite(saved, violations=[entry])
    loaded = Solution.load(saved)
    assert loaded.violations == (Violation(**entry),)
    assert Violation is ocp.Violation
    assert "violated by 0.25 N; its multiplier is 1.5" in loaded.explain()


@pytest.mark.parametrize("entry", ["status", "phases", "history", "cost", "models", "violations"])
def test_header_without_an_entry(saved: Path, entry: str) -> None:
    rewrite(saved, **{entry: None})
    with pytest.raises(FileFormatError, match=rf"file 'rope.npz': incomplete - .*{entry}"):
        Solution.load(saved)


def test_unknown_status(saved: Path) -> None:
    rewrite(saved, status="SPLENDID")
    with pytest.raises(FileFormatError, match=r"file 'rope.npz': incomplete - .*SPLENDID"):
        Solution.load(saved)


@pytest.mark.parametrize(("entry", "value"), [("phases", 3), ("phases", ["push"]), ("history", ["cost"]), ("cost", {})])
def test_header_with_an_entry_of_another_kind(saved: Path, entry: str, value: object) -> None:
    rewrite(saved, **{entry: value})
    with pytest.raises(FileFormatError, match=r"file 'rope.npz': in(consistent|complete) - got"):
        Solution.load(saved)


def test_array_that_is_not_there(saved: Path) -> None:
    with np.load(saved) as stored:
        arrays = {name: stored[name] for name in stored.files if name != "1/feedback"}
    np.savez_compressed(saved, **arrays)
    with pytest.raises(FileFormatError, match=r"file 'rope.npz': incomplete - got no '1/feedback'"):
        Solution.load(saved)


def test_missing_file_and_folder(tmp_path: Path) -> None:
    with pytest.raises(FileFormatError, match=r"file 'nowhere.npz': does not exist - got no file"):
        Solution.load(tmp_path / "nowhere.npz")
    with pytest.raises(FileFormatError, match="does not exist - got"):
        Solution.load(tmp_path)
