"""A cache that is planted, full, read-only, noexec or missing: a library of the user's own or NumPy, with a warning."""

import ast
import hashlib
import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

import piaffe
from piaffe.cli.app import main
from piaffe.codegen import Cache, CacheWarning, build, fault_of, load, this_cpu
from piaffe.codegen.cache import LIBRARY, MANIFEST
from piaffe.codegen.trust import _private, distrust, make_private

ROOT = pytest.mark.skipif(os.geteuid() != 0, reason="needs root: files of another user, and mounts")
UNIT = [("answer", "int answer(void) { return 42; }")]
EVIL = [("answer", "int answer(void) { return 13; }")]
SOLVE = """
import json, sys, warnings
import casadi
from piaffe import ocp, solvers
def fall(s): return {"z": s.vz, "vz": s.thrust - 9.81}
ball = ocp.Model("ball", state={"z": 1, "vz": 1}, control={"thrust": 1}, modes={"fall": fall})
problem = ocp.Problem(
    ocp.Motion(ocp.Phase("drop", "fall", 0.1, target={"z": 0.6})), ball.until_end(dt=0.01),
    ocp.Objective(ocp.track("z", weight=10.0), ocp.regularize("thrust", weight=0.1)), initial=[1.0, 0.0],
)
with warnings.catch_warnings(record=True) as caught:
    warnings.simplefilter("always")
    solver = solvers.MSiLQR(problem)
    status = solver.solve().status.name
print(json.dumps({"status": status, "warnings": [[w.category.__name__, str(w.message)] for w in caught]}))
"""


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the root of an empty cache, which the environment names."""
    monkeypatch.setenv("PIAFFE_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr("piaffe.codegen.trust._private", [])
    return tmp_path / "cache"


DISK = "128k"  # size of `mounted`


def answer() -> int:
    return int(load(build(UNIT)).answer())


def solved(**environment: str) -> dict[str, object]:
    """Solve a problem in a process of its own; return its status and the warnings."""
    source = str(Path(piaffe.__file__).parent.parent)
    given = {**os.environ, "PYTHONPATH": source, **environment}
    given = {name: value for name, value in given.items() if value}
    done = subprocess.run([sys.executable, "-c", SOLVE], capture_output=True, text=True, env=given, check=True, cwd="/")
    found: dict[str, object] = json.loads(done.stdout)
    return found


def planted(cache: Path) -> Path:
    """Replace the library of the cache by another with its own hash; return the folder of the library."""
    built = build(UNIT)
    evil = build(EVIL, cache=Cache(cache.parent / "other"))
    built.path.write_bytes(evil.path.read_bytes())
    manifest = json.loads((built.path.parent / MANIFEST).read_text())
    manifest |= {"sha256": hashlib.sha256(built.path.read_bytes()).hexdigest(), "size": built.path.stat().st_size}
    (built.path.parent / MANIFEST).write_text(json.dumps(manifest))
    return built.path.parent


# ---- what others may have written


@ROOT
@pytest.mark.parametrize("name", [LIBRARY, MANIFEST])
def test_a_file_of_another_user_is_not_loaded(cache: Path, name: str) -> None:
    folder = planted(cache)
    assert fault_of(Cache().entries()[0], this_cpu()) == ""  # it is taken for the user's own, as long as it is
    os.chown(folder / name, 1234, 1234)
    assert "belongs to another user" in fault_of(Cache().entries()[0], this_cpu())
    assert answer() == 42


@ROOT
def test_a_folder_of_another_user_is_not_used(cache: Path) -> None:
    folder = planted(cache)
    for path in (cache, *cache.rglob("*")):
        os.chown(path, 1234, 1234)
    with pytest.warns(CacheWarning, match=r"is not safe, '.*' belongs to another user; remove it") as caught:
        assert answer() == 42
    assert len(caught) == 1
    assert answer() == 42  # without another warning
    assert (folder / LIBRARY).exists()


@pytest.mark.parametrize("of", ["cache", "native", "key", LIBRARY, MANIFEST])
def test_what_others_can_write_is_not_loaded(cache: Path, of: str) -> None:
    folder = planted(cache)
    {"cache": cache, "native": cache / "native", "key": folder}.get(of, folder / of).chmod(0o777)
    if of in ("cache", "native"):
        with pytest.warns(CacheWarning, match="everybody can write"):
            assert answer() == 42
    else:
        assert answer() == 42


def test_folders_are_the_users_alone_whatever_the_umask(cache: Path) -> None:
    before = os.umask(0)
    try:
        assert answer() == 42
        make_private(cache / "a" / "b")
    finally:
        os.umask(before)
    for path in (cache, *cache.rglob("*")):
        if path.is_dir():
            assert path.stat().st_mode & 0o777 == 0o700, path
    (entry,) = Cache().entries()
    assert entry.library.stat().st_mode & 0o077 == 0
    assert answer() == 42


def test_parents_are_examined_up_to_the_declared_root(tmp_path: Path) -> None:
    inner = tmp_path / "root" / "a" / "b"
    inner.mkdir(parents=True, mode=0o755)
    assert distrust(inner, tmp_path / "root") == ""
    (tmp_path / "root" / "a").chmod(0o777)
    assert distrust(inner, tmp_path / "root") == f"everybody can write '{tmp_path / 'root' / 'a'}'"
    assert distrust(inner, inner) == ""
    (tmp_path / "root" / "a").chmod(0o1777)  # others cannot rename what is not theirs
    assert distrust(inner, tmp_path / "root") == ""
    assert distrust(inner / "later" / "file", tmp_path / "root") == ""


def test_a_link_out_of_the_root_is_followed_up_to_the_top(tmp_path: Path) -> None:
    root, outside = tmp_path / "root", tmp_path / "open" / "mine"
    root.mkdir(mode=0o700)
    outside.mkdir(parents=True, mode=0o700)
    (root / "native").symlink_to(outside)
    assert distrust(root / "native", root) == ""
    (tmp_path / "open").chmod(0o777)
    assert distrust(root / "native", root) == f"everybody can write '{tmp_path / 'open'}'"
    (root / "circle").symlink_to(root / "circle")
    assert "cannot be examined" in distrust(root / "circle", root)


@pytest.mark.parametrize(
    "entry",
    [{"label": ["a"]}, {"built_at": "now"}, {"seconds": {}}, {"compiler": 3}, {"cpu_name": None}, "[" * 100_000],
)
def test_a_damaged_manifest_is_shown_as_one_that_is_not_used(
    entry: object, cache: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = build(UNIT).path.parent / MANIFEST
    if isinstance(entry, dict):
        path.write_text(json.dumps(json.loads(path.read_text()) | entry))
    else:
        path.write_text(str(entry))
    assert main(["cache"]) == 0
    assert "not used here" in capsys.readouterr().out
    assert main(["cache", "--json"]) == 0
    assert answer() == 42


def test_no_compiler_is_called_by_a_shell() -> None:
    folder = Path(piaffe.__file__).parent
    for file in sorted(folder.rglob("*.py")):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.keyword):
                assert node.arg != "shell", file
            if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "os":
                assert node.attr not in ("system", "popen"), file


# ---- a cache that cannot be used


@ROOT
def test_a_full_disk_leads_to_a_temporary_folder(mounted: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PIAFFE_CACHE", str(mounted / "cache"))
    (mounted / "ballast").write_bytes(bytes(118_000))
    with pytest.warns(CacheWarning, match="cannot be written - got .*set PIAFFE_CACHE"):
        assert answer() == 42


@ROOT
def test_a_read_only_cache_leads_to_a_temporary_folder(mounted: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PIAFFE_CACHE", str(mounted / "cache"))
    subprocess.run(["mount", "-o", "remount,ro", str(mounted)], check=True)
    with pytest.warns(CacheWarning, match="cannot be written - got Read-only file system"):
        assert answer() == 42


@ROOT
def test_a_library_in_a_read_only_cache_is_used(mounted: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PIAFFE_CACHE", str(mounted / "cache"))
    assert answer() == 42
    subprocess.run(["mount", "-o", "remount,ro", str(mounted)], check=True)
    assert answer() == 42


@ROOT
def test_a_noexec_cache_leads_to_a_temporary_folder(mounted: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PIAFFE_CACHE", str(mounted / "cache"))
    subprocess.run(["mount", "-o", "remount,noexec", str(mounted)], check=True)
    with pytest.warns(CacheWarning, match="may not run \\(noexec\\); set PIAFFE_CACHE") as caught:
        assert answer() == 42
    assert answer() == 42
    assert len(caught) == 1
    assert _private == []  # the list of this module is empty: the fixture has replaced that of the package


@ROOT
def test_numpy_solves_where_no_folder_can_be_used(mounted: Path) -> None:
    subprocess.run(["mount", "-o", "remount,ro,noexec", str(mounted)], check=True)
    found = solved(PIAFFE_CACHE=str(mounted / "cache"), TMPDIR=str(mounted))
    assert found["status"] == "CONVERGED"
    kinds = [kind for kind, _ in found["warnings"]]  # type: ignore[attr-defined]  # a list of pairs
    assert kinds in (["NoCompilerWarning"], ["CacheWarning"])  # the second: there is another temporary folder


def test_a_user_without_a_home_has_a_temporary_folder(tmp_path: Path) -> None:
    code = "import os, pwd\ndef no(*a): raise KeyError('uid not found')\npwd.getpwuid = no\n"
    source = str(Path(piaffe.__file__).parent.parent)
    removed = ("HOME", "PIAFFE_CACHE", "XDG_CACHE_HOME")
    environment = {name: value for name, value in os.environ.items() if name not in removed}
    done = subprocess.run(
        [sys.executable, "-c", code + SOLVE], capture_output=True, text=True, cwd="/",
        env={**environment, "PYTHONPATH": source, "TMPDIR": str(tmp_path)},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["status"] == "CONVERGED"
    ((kind, text),) = found["warnings"]
    assert (kind, "there is no home folder; set HOME" in text) == ("CacheWarning", True)
    assert list(tmp_path.glob("piaffe-cache-*")) == []  # it goes with the process


KILLED = """
import os, signal, sys
from pathlib import Path
from piaffe.codegen.trust import private_folder
private_folder("of a test")
print("ready", flush=True)
sys.stdin.readline()
os.kill(os.getpid(), signal.SIGKILL)
"""


def test_the_next_process_removes_the_temporary_folders_of_killed_ones(tmp_path: Path) -> None:
    source = str(Path(piaffe.__file__).parent.parent)
    environment = {**os.environ, "PYTHONPATH": source, "TMPDIR": str(tmp_path)}

    def folders() -> set[Path]:
        return set(tmp_path.glob("piaffe-cache-*"))

    def started() -> tuple[subprocess.Popen[str], Path]:
        before = folders()
        process = subprocess.Popen(
            [sys.executable, "-W", "ignore", "-c", KILLED], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
            env=environment,
        )  # fmt: skip
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        (own,) = folders() - before
        os.utime(own, (0, 0))  # created long ago
        return process, own

    def killed(process: subprocess.Popen[str]) -> None:
        process.communicate("now\n")
        assert process.returncode == -signal.SIGKILL

    (first, old), (second, kept) = started(), started()
    killed(first)
    assert folders() == {old, kept}
    third, own = started()
    assert folders() == {kept, own}
    killed(second)
    killed(third)
