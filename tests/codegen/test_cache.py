"""The cache: whole or absent, never of another processor, bounded, and shared by processes that may die."""

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path

import pytest

from piaffe.cli.app import main
from piaffe.codegen.cache import LIBRARY, MANIFEST, Cache, Entry, default_folder, fault_of
from piaffe.codegen.cpu import this_cpu
from piaffe.errors import SolverError

CPU = this_cpu()
KEYS = tuple(f"{i:02x}" * 32 for i in range(1, 6))
HOLDER = """
import sys, time
from pathlib import Path
from piaffe.codegen.cache import Cache
with Cache(Path(sys.argv[1])).building(sys.argv[2]) as folder:
    (folder / "half.so").write_bytes(b"x" * 100)
    print(folder, flush=True)
    sys.stdin.readline()
"""


@pytest.fixture
def cache(tmp_path: Path) -> Cache:
    return Cache(tmp_path / "cache")


def put(
    cache: Cache, key: str, content: bytes = b"library", cpu: str = CPU.fingerprint, unused_s: float = 0.0
) -> Entry:
    """Store what stands for a library."""
    with cache.building(key) as folder:
        (folder / "made.so").write_bytes(content)
        entry = cache.store(key, folder / "made.so", {"cpu": cpu, "cpu_name": "Some CPU", "label": f"for {key[:2]}"})
    if unused_s:
        then = time.time() - unused_s
        os.utime(entry.folder / MANIFEST, (then, then))
    return entry


def keys(cache: Cache) -> list[str]:
    return [entry.folder.name for entry in cache.entries()]


def private(cache: Cache) -> list[str]:
    folder = cache.folder / "building"
    return [path.name for path in folder.iterdir()] if folder.exists() else []


@contextmanager
def holder(cache: Cache, key: str) -> Iterator[subprocess.Popen[str]]:
    """Run a process that is building a library until a line comes or it is killed."""
    process = subprocess.Popen(
        [sys.executable, "-c", HOLDER, str(cache.folder), key],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd="/",
    )  # fmt: skip
    assert process.stdout is not None
    process.stdout.readline()
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


# ---- where


def test_the_users_folder_follows_the_environment(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.delenv("PIAFFE_CACHE", raising=False)
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    assert default_folder() == tmp_path / ".cache" / "piaffe" / "native"
    monkeypatch.setenv("XDG_CACHE_HOME", "not/absolute")
    assert default_folder() == tmp_path / ".cache" / "piaffe" / "native"
    monkeypatch.setenv("XDG_CACHE_HOME", "/xdg")
    assert default_folder() == Path("/xdg/piaffe/native")
    monkeypatch.setenv("PIAFFE_CACHE", "~/own")
    assert default_folder() == tmp_path / "own" / "native"


def test_looking_makes_no_folder(cache: Cache) -> None:
    assert cache.find(KEYS[0], CPU) is None
    assert cache.entries() == []
    assert cache.size() == 0
    assert cache.clear() == (0, 0)
    assert not cache.folder.exists()


def test_a_folder_that_cannot_be_written_is_reported_with_advice(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(SolverError) as error, Cache(tmp_path / "file" / "cache").building(KEYS[0]):
        pass
    assert f"cache '{tmp_path / 'file' / 'cache'}': cannot be written - got Not a directory" in str(error.value)
    assert "set PIAFFE_CACHE" in str(error.value)


# ---- finding and storing


def test_what_is_stored_is_found(cache: Cache) -> None:
    stored = put(cache, KEYS[0])
    found = cache.find(KEYS[0], CPU)
    assert found is not None
    assert found.library == stored.library
    assert found.library.read_bytes() == b"library"
    assert found.manifest["label"] == "for 01"
    assert cache.find(KEYS[1], CPU) is None
    assert private(cache) == []


def test_a_library_for_another_processor_is_not_found(cache: Cache) -> None:
    entry = put(cache, KEYS[0])
    other = replace(CPU, features=CPU.features | {"avx1024"})
    assert cache.find(KEYS[0], other) is None
    assert fault_of(entry, other) == "it was built for another processor (Some CPU)"
    put(cache, KEYS[1], cpu=other.fingerprint)
    assert cache.find(KEYS[1], CPU) is None


@pytest.mark.parametrize("damage", ["truncated", "changed", "absent", "manifest", "empty manifest", "newer", "moved"])
def test_a_damaged_library_is_not_found_and_can_be_replaced(cache: Cache, damage: str) -> None:
    entry = put(cache, KEYS[0], b"a library of some length")
    about = entry.folder / MANIFEST
    if damage == "truncated":
        entry.library.write_bytes(b"a library")
    elif damage == "changed":
        entry.library.write_bytes(b"a library of some LENGTH")
    elif damage == "absent":
        entry.library.unlink()
    elif damage == "manifest":
        about.write_text(about.read_text()[:30])
    elif damage == "empty manifest":
        about.write_text("[]")
    elif damage == "newer":
        about.write_text(json.dumps({**json.loads(about.read_text()), "format": 99}))
    else:
        about.write_text(json.dumps({**json.loads(about.read_text()), "key": KEYS[1]}))
    assert cache.find(KEYS[0], CPU) is None
    put(cache, KEYS[0])
    assert cache.find(KEYS[0], CPU) is not None
    assert private(cache) == []


def test_an_error_while_building_leaves_nothing(cache: Cache) -> None:
    with pytest.raises(IsADirectoryError), cache.building(KEYS[0]) as folder:
        folder.read_bytes()
    assert private(cache) == []
    assert keys(cache) == []


# ---- bounded


def test_what_was_not_used_for_longest_goes_first(cache: Cache) -> None:
    for key, unused in zip(KEYS[:3], (5000.0, 9000.0, 7000.0), strict=True):
        put(cache, key, b"x" * 10_000, unused_s=unused)
    cache.limit = 35_000
    put(cache, KEYS[3], b"x" * 10_000)
    assert keys(cache) == [KEYS[3], KEYS[0], KEYS[2]]


def test_finding_counts_as_use(cache: Cache) -> None:
    put(cache, KEYS[0], b"x" * 10_000, unused_s=9000.0)
    put(cache, KEYS[1], b"x" * 10_000, unused_s=5000.0)
    cache.find(KEYS[0], CPU)
    cache.limit = 15_000
    assert cache.trim() == 1
    assert keys(cache) == [KEYS[0]]


def test_what_may_be_about_to_be_loaded_stays(cache: Cache) -> None:
    cache.limit = 1
    put(cache, KEYS[0])
    put(cache, KEYS[1])
    assert set(keys(cache)) == set(KEYS[:2])
    put(cache, KEYS[1], unused_s=100.0)
    put(cache, KEYS[2])
    assert set(keys(cache)) == {KEYS[0], KEYS[2]}


# ---- clearing


def test_clear_removes_libraries_and_leftovers_and_nothing_else(cache: Cache) -> None:
    for key in KEYS[:2]:
        put(cache, key, b"x" * 1000)
    with holder(cache, KEYS[2]) as process:
        process.kill()
        process.wait()
        assert len(private(cache)) == 1
    (cache.folder / "notes.txt").write_text("mine")
    removed, freed = cache.clear()
    assert removed == 2
    assert freed > 2000
    assert keys(cache) == private(cache) == []
    assert (cache.folder / "notes.txt").read_text() == "mine"


def test_clear_leaves_a_build_under_way_alone(cache: Cache) -> None:
    put(cache, KEYS[0])
    with holder(cache, KEYS[1]):
        assert cache.clear()[0] == 1
        assert len(private(cache)) == 1


# ---- several processes


def test_a_second_builder_waits_for_the_first(cache: Cache) -> None:
    told = []
    with holder(cache, KEYS[0]) as process:

        def waiting() -> None:
            told.append(time.monotonic())
            assert process.stdin is not None
            process.stdin.write("\n")
            process.stdin.flush()

        with cache.building(KEYS[0], waiting):
            assert len(told) == 1
            assert len(private(cache)) == 1
            assert process.wait(5) == 0


def test_another_library_need_not_wait(cache: Cache) -> None:
    with holder(cache, KEYS[0]), cache.building(KEYS[1], lambda: pytest.fail("it waits")):
        assert len(private(cache)) == 2


def test_what_a_killed_builder_leaves_is_swept_by_the_next(cache: Cache) -> None:
    with holder(cache, KEYS[0]) as process:
        process.kill()
        process.wait()
    assert len(private(cache)) == 1
    with cache.building(KEYS[0]) as folder:
        assert private(cache) == [folder.name]
    assert private(cache) == []


def test_old_leftovers_of_any_library_are_swept(cache: Cache) -> None:
    with holder(cache, KEYS[0]) as process:
        process.kill()
        process.wait()
    left = cache.folder / "building" / private(cache)[0]
    os.utime(left, (0, 0))
    with cache.building(KEYS[1]):
        assert not left.exists()


def test_a_builder_that_takes_too_long_is_waited_for_no_more(cache: Cache, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("piaffe.codegen.cache.PATIENCE_S", 0.1)
    with holder(cache, KEYS[0]):
        put(cache, KEYS[0])
        assert len(private(cache)) == 1  # that of the slow one
    assert keys(cache) == [KEYS[0]]


def test_a_file_system_without_locks_will_do(cache: Cache, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(descriptor: int, operation: int) -> None:
        raise OSError("No locks available")

    monkeypatch.setattr("piaffe.codegen.cache.fcntl.flock", refuse)
    put(cache, KEYS[0])
    put(cache, KEYS[0], b"again")
    assert cache.find(KEYS[0], CPU) is not None
    assert private(cache) == []


def test_readers_never_see_half_a_library(cache: Cache) -> None:
    content = b"x" * 2_000_000
    writer = (
        "import sys; from pathlib import Path; from piaffe.codegen.cache import Cache, MANIFEST\n"
        "from piaffe.codegen.cpu import this_cpu\n"
        "cache, key = Cache(Path(sys.argv[1])), sys.argv[2]\n"
        "for _ in range(20):\n"
        "    with cache.building(key) as folder:\n"
        "        (folder / 'made.so').write_bytes(b'x' * 2_000_000)\n"
        "        cache.store(key, folder / 'made.so', {'cpu': this_cpu().fingerprint})\n"
    )
    seen = 0
    path = cache.folder / KEYS[0] / LIBRARY
    with subprocess.Popen([sys.executable, "-c", writer, str(cache.folder), KEYS[0]], cwd="/") as process:
        while process.poll() is None:
            with suppress(FileNotFoundError):  # between two of them
                assert path.read_bytes() == content
                seen += 1
    assert process.returncode == 0
    assert seen
    assert cache.find(KEYS[0], CPU) is not None


# ---- the command


def run(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    capsys.readouterr()
    assert main(["cache", *arguments]) == 0
    return capsys.readouterr().out


@pytest.fixture
def users(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Cache:
    """Return the user's cache, with two libraries."""
    monkeypatch.setenv("PIAFFE_CACHE", str(tmp_path))
    cache = Cache()
    put(cache, KEYS[0], b"x" * 2**20, unused_s=3 * 3600.0)
    put(cache, KEYS[1], b"x" * 2**21, cpu="other")
    return cache


def test_cache_shows_sizes_ages_and_purposes(users: Cache, capsys: pytest.CaptureFixture[str]) -> None:
    lines = run(capsys).splitlines()
    assert lines[0] == str(users.folder)
    assert lines[1] == "2 libraries, 3.0 MiB of at most 1.0 GiB"
    assert "0202020202" in lines[3]
    assert "for 02" in lines[3]
    assert "2.0 MiB" in lines[3]
    assert "not used here: it was built for another processor (Some CPU)" in lines[3]
    assert "3 h ago" in lines[4]
    assert "not used" not in lines[4]


def test_cache_as_json(users: Cache, capsys: pytest.CaptureFixture[str]) -> None:
    values = json.loads(run(capsys, "--json"))
    assert values["folder"] == str(users.folder)
    assert [entry["key"] for entry in values["entries"]] == [KEYS[1], KEYS[0]]
    assert values["entries"][1]["unused_s"] == pytest.approx(3 * 3600.0, abs=60.0)


def test_cache_clears(users: Cache, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(capsys, "--clear") == "libraries removed: 2, freed: 3.0 MiB\n"
    assert json.loads(run(capsys, "--clear", "--json")) == {"removed": 0, "freed": 0}
    assert run(capsys).splitlines()[1] == "0 libraries, 0.0 MiB of at most 1.0 GiB"
    assert users.entries() == []


def test_showing_is_no_use(users: Cache, capsys: pytest.CaptureFixture[str]) -> None:
    before = [entry.used for entry in users.entries()]
    run(capsys)
    assert [entry.used for entry in users.entries()] == before
