"""Sources become a library once; compilers are found, put to the test, and quoted when they refuse."""

import ctypes
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import pytest

from piaffe.codegen import compilers
from piaffe.codegen.build import EXPRESSION_FLAGS, SOLVER_FLAGS, VERSION, _expanded, _Recipe, build, load
from piaffe.codegen.cache import Cache
from piaffe.codegen.compilers import NoCompilerError
from piaffe.codegen.cpu import this_cpu
from piaffe.codegen.processes import CompileError
from piaffe.codegen.sources import LazySources, Sources
from piaffe.errors import SolverError

GCC = next((path for name in ("gcc", "cc", "clang") if (path := shutil.which(name))), None)
pytestmark = pytest.mark.skipif(GCC is None, reason="no C compiler on the path")

HEADER = {"vd.h": "typedef double vd __attribute__((vector_size(8 * PIAFFE_W)));\nint width(void);\n"}
UNITS = (
    ("square", '#include "vd.h"\nvoid square(const vd *x, vd *y) { *y = *x * *x + (width() - PIAFFE_W); }\n'),
    ("width", '#include "vd.h"\nint width(void) { return PIAFFE_W; }\n'),
)
CHILD = """
import sys
from piaffe.codegen import build, load
def progress(done, steps, name):
    print(done, steps, name, flush=True)
built = build([("one", "int one(void) { return 1; }"), ("two", "int two(void) { return 2; }")], progress=progress)
library = load(built)
print("built" if built.built else "found", library.one() + library.two(), flush=True)
"""


def forget() -> None:
    compilers.identify.cache_clear()
    compilers.fault_of.cache_clear()


@pytest.fixture(autouse=True)
def fresh(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Give each test a cache of its own, and no compiler but those that it asks for."""
    monkeypatch.setenv("PIAFFE_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("CC", str(GCC))
    forget()


@pytest.fixture
def wrapper(tmp_path: Path) -> Callable[..., Path]:
    """Return what writes a compiler that logs a line and runs some shell before each compilation."""

    def written(before: str = "", name: str = "mycc") -> Path:
        path = tmp_path / "bin" / name
        path.parent.mkdir(exist_ok=True)
        log = tmp_path / "log"
        path.write_text(
            f'#!/bin/sh\ncase "$*" in\n--version|*trial.c*) exec {GCC} "$@";;\nesac\n'
            f'echo "begin $$ $*" >> {log}\n{before}\n{GCC} "$@"\ncode=$?\necho "end $$ $*" >> {log}\nexit $code\n'
        )
        path.chmod(0o755)
        return path

    return written


def leftovers(tmp_path: Path) -> list[str]:
    return [path.name for path in (tmp_path / "cache" / "native" / "building").glob("*")]


def log_of(tmp_path: Path) -> list[str]:
    log = tmp_path / "log"
    return log.read_text().splitlines() if log.exists() else []


# ---- building


@pytest.mark.parametrize("width", [1, 4, 8])
def test_a_library_computes_with_vectors_of_the_width_asked_for(width: int) -> None:
    built = build(UNITS, headers=HEADER, width=width)
    library = load(built)
    memory = (ctypes.c_double * 24)()
    first = -(-ctypes.addressof(memory) // 64) * 64  # vectors are aligned to their size
    x, y = ((ctypes.c_double * width).from_address(first + 64 * i) for i in range(2))
    x[:] = [float(i) for i in range(1, width + 1)]
    library.square(ctypes.byref(x), ctypes.byref(y))
    assert list(y) == [float(i * i) for i in range(1, width + 1)]
    assert (built.built, built.width, library.width()) == (True, width, width)


def test_the_width_is_that_of_the_processor_by_default() -> None:
    assert build(UNITS, headers=HEADER).width == this_cpu().vector_width


def test_what_was_built_is_found_without_a_compilation(wrapper: Callable[..., Path], tmp_path: Path,
                                                       monkeypatch: pytest.MonkeyPatch) -> None:  # fmt: skip
    monkeypatch.setenv("CC", str(wrapper()))
    first = build(UNITS, headers=HEADER)
    compiled = log_of(tmp_path)
    told: list[object] = []
    second = build(UNITS, headers=HEADER, progress=lambda *step: told.append(step))
    assert (first.built, second.built) == (True, False)
    assert (second.path, second.key) == (first.path, first.key)
    assert told == []
    assert log_of(tmp_path) == compiled
    assert leftovers(tmp_path) == []


def test_progress_reports_each_step_in_the_callers_thread() -> None:
    told: list[tuple[int, int, str]] = []
    threads = set()

    def progress(done: int, steps: int, name: str) -> None:
        told.append((done, steps, name))
        threads.add(threading.get_ident())

    build(UNITS, headers=HEADER, progress=progress)
    assert [step[:2] for step in told] == [(0, 3), (1, 3), (2, 3), (3, 3)]
    assert sorted(step[2] for step in told) == ["", "link", "square", "width"]
    assert threads == {threading.get_ident()}


def test_units_compile_at_the_same_time(
    wrapper: Callable[..., Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CC", str(wrapper("sleep 0.3")))
    monkeypatch.setattr(sys.modules[build.__module__], "available_cores", lambda: 2)
    build(UNITS, headers=HEADER)
    assert [line.split()[0] for line in log_of(tmp_path)] == ["begin", "begin", "end", "end", "begin", "end"]


def test_each_unit_may_have_flags_of_its_own() -> None:
    units = [("a", "int a(void) { return OWN; }"), ("b", "int b(void) { return OWN; }")]
    library = load(build(units, flags=["-DOWN=1"], flags_per_unit={"b": ["-DOWN=2"]}))
    assert (library.a(), library.b()) == (1, 2)


def test_flags_keep_to_ieee_754_and_this_processor() -> None:
    assert not {"-ffast-math", "-Ofast"} & {*EXPRESSION_FLAGS, *SOLVER_FLAGS}
    expressions, solver = (_expanded(flags, 4, this_cpu()) for flags in (EXPRESSION_FLAGS, SOLVER_FLAGS))
    assert (expressions[0], solver[0]) == ("-O1", "-O3")
    assert expressions[-1] == solver[-1] == this_cpu().native


def test_every_ingredient_is_part_of_the_key() -> None:
    texts = Sources(UNITS, HEADER, {"width": ("-O1",)})
    recipe = _Recipe(_lazy(texts), ("-O1",), ("-lm",), 4, "1")
    compiler = compilers.Compiler(("gcc",), "gcc", "gcc 12")
    cpu = this_cpu()
    recipes = [
        recipe, replace(recipe, flags=("-O3",)), replace(recipe, link=()), replace(recipe, width=8),
        replace(recipe, version="2"),
    ]  # fmt: skip
    recipes += [replace(recipe, sources=_lazy(other)) for other in (
        replace(texts, units=UNITS[::-1]), replace(texts, units=(("square", "int a;"), UNITS[1])),
        replace(texts, headers={"vd.h": "typedef double vd;"}), replace(texts, headers={**HEADER, "b.h": ""}),
        replace(texts, flags_per_unit={"width": ("-O3",)}), replace(texts, flags_per_unit={}),
    )]  # fmt: skip
    keys = [one.key(compiler, cpu) for one in recipes]
    keys += [recipe.key(other, cpu) for other in (
        replace(compiler, version="gcc 13"), replace(compiler, kind="clang"),
        replace(compiler, command=("gcc", "-m32")),
    )]  # fmt: skip
    keys.append(recipe.key(compiler, replace(cpu, features=cpu.features | {"avx1024"})))
    assert len(set(keys)) == len(keys)
    assert recipe.key(replace(compiler, command=("/opt/gcc",)), cpu) == keys[0]
    assert VERSION


def _lazy(sources: Sources) -> LazySources:
    return LazySources(sources.parts, lambda: sources)


def test_lazy_sources_are_made_only_if_no_library_is_cached() -> None:
    made: list[int] = []

    def texts() -> Sources:
        made.append(1)
        return Sources([("one", "int one(void) { return 1; }")])

    first, second, other = (build(LazySources(parts, texts)) for parts in (["a"], ["a"], ["b"]))
    assert (first.built, second.built, other.built) == (True, False, True)
    assert first.key == second.key != other.key
    assert len(made) == 2
    assert load(second).one() == 1


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        ({"units": []}, "got [], expected at least one unit"),
        ({"units": [("a", ""), ("a", "")]}, "got ['a', 'a'], expected"),
        ({"units": [("../a", "")]}, "got ['../a'], expected"),
        ({"units": [("a", "")], "headers": {"/etc/a.h": ""}}, "got ['/etc/a.h'], expected"),
        ({"units": [("a", "")], "flags_per_unit": {"b": []}}, "got ['b'], expected names of units ['a']"),
        ({"units": LazySources(["a"], lambda: Sources([("a", "")])), "headers": {"a.h": ""}}, "got them as arguments"),
        ({"units": [("a", "")], "width": 3}, "width is not supported - got 3, expected 1, 2, 4 or 8"),
    ],
)
def test_contradictory_arguments_are_refused(arguments: dict[str, object], told: str) -> None:
    with pytest.raises(SolverError) as error:
        build(**arguments)  # type: ignore[arg-type]
    assert told in str(error.value)


# ---- compilers that refuse


def test_a_refused_unit_is_named_with_the_first_lines_of_the_message(tmp_path: Path) -> None:
    bad = "int f(void) { return missing; }\n" + "int g(void) { retrun 1; }\n" * 30
    with pytest.raises(CompileError) as error:
        build([("good", "int good;"), ("bad", bad)])
    said = str(error.value)
    assert error.value.unit == "bad"
    assert "unit 'bad'" in said
    assert "bad.c:1:" in said
    assert "missing" in said
    assert "more lines" in said
    assert 'backend="numpy"' in said
    assert len(said.splitlines()) < 20
    assert leftovers(tmp_path) == []
    assert Cache().entries() == []


def test_a_missing_symbol_shows_when_linking() -> None:
    with pytest.raises(CompileError, match="(?s)unit 'link'.*nowhere"):
        build([("one", "int nowhere(void); int one(void) { return nowhere(); }")])


def test_a_killed_compiler_is_reported(wrapper: Callable[..., Path], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CC", str(wrapper("kill -9 $$")))
    with pytest.raises(CompileError, match="killed by SIGKILL"):
        build(UNITS, headers=HEADER)


# ---- finding compilers


def test_no_compiler_is_reported_with_advice(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("CC")
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr(compilers, "find_spec", lambda name: None)
    with pytest.raises(NoCompilerError) as error:
        build(UNITS, headers=HEADER)
    assert "got none, expected cc, gcc or clang on the path" in str(error.value)
    assert "pip install 'piaffe[compiler]'" in str(error.value)


@pytest.mark.parametrize("value", ["/nowhere/cc", "'open", "/bin/false"])
def test_a_cc_that_is_no_compiler_is_named(value: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CC", value)
    with pytest.raises(NoCompilerError) as error:
        build(UNITS, headers=HEADER)
    assert f"CC={value!r} does not work" in str(error.value)


def test_a_cc_that_compiles_nothing_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    broken = tmp_path / "broken"
    broken.write_text(
        '#!/bin/sh\n[ "$*" = --version ] && echo "broken 1.0" && exit\necho "error: no headers" >&2\nexit 1\n'
    )
    broken.chmod(0o755)
    monkeypatch.setenv("CC", str(broken))
    with pytest.raises(NoCompilerError, match="does not work.*does not compile: error: no headers"):
        build(UNITS, headers=HEADER)


def test_cc_may_have_arguments(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CC", f"{GCC} -DGIVEN=7")
    assert load(build([("one", "int one(void) { return GIVEN; }")])).one() == 7


def test_a_compiler_on_the_path_that_does_not_work_is_passed_over(
    wrapper: Callable[..., Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    wrapper(name="gcc")
    broken = tmp_path / "bin" / "cc"
    broken.write_text("#!/bin/sh\necho broken 1.0\ncase $* in --version) ;; *) exit 1;; esac\n")
    broken.chmod(0o755)
    monkeypatch.delenv("CC")
    monkeypatch.setenv("PATH", f"{tmp_path / 'bin'}:{os.environ['PATH']}")
    assert next(compilers.candidates()).version == "broken 1.0"
    assert compilers.working().command == (str(tmp_path / "bin" / "gcc"),)


def test_ziglang_serves_where_nothing_else_does(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    package = tmp_path / "site" / "ziglang"
    package.mkdir(parents=True)
    package.joinpath("__init__.py").touch()
    package.joinpath("__main__.py").write_text(  # gcc in its clothes
        "import os, sys\nif sys.argv[1] == 'version':\n    print('0.99.0')\n"
        f"elif sys.argv[2:] == ['--version']:\n    print('clang version 99')\nelse:\n"
        f"    os.environ['PATH'] = {os.environ['PATH']!r}\n    os.execv({str(GCC)!r}, [{str(GCC)!r}, *sys.argv[2:]])\n"
    )
    monkeypatch.delenv("CC")
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setenv("PYTHONPATH", f"{package.parent}:{os.environ.get('PYTHONPATH', '')}")
    monkeypatch.syspath_prepend(package.parent)
    built = build(UNITS, headers=HEADER)
    assert built.built
    assert built.compiler == "zig 0.99.0, clang version 99"


def test_the_name_that_gcc_is_called_by_makes_no_difference(tmp_path: Path) -> None:
    command = str(GCC)
    compiler = compilers.identify((command,))
    assert compiler is not None
    if compiler.kind != "gcc":
        pytest.skip("needs gcc")
    other = tmp_path / "other-cc"
    other.symlink_to(command)
    again = compilers.identify((str(other),))
    assert again is not None
    assert again.identity == compiler.identity


# ---- processes


def child() -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-c", CHILD], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd="/"
    )


def wait_for(condition: Callable[[], bool], seconds: float = 60.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it did not happen"
        time.sleep(0.02)


def alive(pid: int) -> bool:
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except FileNotFoundError:
        return False
    return state not in "ZX"


def test_of_two_processes_one_builds_and_the_other_waits(
    wrapper: Callable[..., Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CC", str(wrapper("sleep 0.7")))
    children = [child() for _ in range(2)]
    said = [process.communicate(timeout=60) for process in children]
    last = sorted(out.splitlines()[-1] for out, _ in said)
    assert last == ["built 3", "found 3"], said
    assert sum(line.startswith("begin") and "-c one.c" in line for line in log_of(tmp_path)) == 1
    assert any("another process" in out for out, _ in said)
    assert len(Cache().entries()) == 1
    assert leftovers(tmp_path) == []


def test_a_killed_builder_leaves_nothing_that_is_loaded_or_stays(
    wrapper: Callable[..., Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    slow = wrapper(f"[ -e {tmp_path / 'go'} ] || sleep 30")
    monkeypatch.setenv("CC", str(slow))
    victim = child()
    wait_for(lambda: "begin" in "".join(log_of(tmp_path)))
    victim.kill()
    victim.communicate()
    assert len(leftovers(tmp_path)) == 1
    assert Cache().entries() == []
    for line in log_of(tmp_path):  # orphans, which write where nobody looks
        with suppress(ProcessLookupError):
            os.killpg(int(line.split()[1]), signal.SIGKILL)
    (tmp_path / "go").touch()
    out, err = child().communicate(timeout=60)
    assert out.splitlines()[-1] == "built 3", err
    assert leftovers(tmp_path) == []


@pytest.mark.parametrize("step", ["-c one.c", "-shared"])
def test_an_interrupt_ends_the_compilers_too(
    wrapper: Callable[..., Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, step: str
) -> None:
    monkeypatch.setenv("CC", str(wrapper(f'case "$*" in *"{step}"*) sleep 30;; esac')))
    process = child()
    wait_for(lambda: any(step in line for line in log_of(tmp_path)))
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=10)
    assert "KeyboardInterrupt" in err
    assert process.returncode != 0
    compiler = next(int(line.split()[1]) for line in log_of(tmp_path) if step in line)
    wait_for(lambda: not alive(compiler), 5.0)
    assert leftovers(tmp_path) == []
    assert Cache().entries() == []


def test_threads_may_build_at_once() -> None:
    results: list[str] = []

    def run(i: int) -> None:
        results.append(build([("one", f"int one(void) {{ return {i % 2}; }}")]).key)

    threads = [threading.Thread(target=run, args=(i,)) for i in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(results) == 4
    assert len(set(results)) == 2


# ---- loading


def test_a_library_of_another_processor_is_built_anew_and_never_loaded(monkeypatch: pytest.MonkeyPatch) -> None:
    here = this_cpu()
    built = build(UNITS, headers=HEADER, width=4)
    other = replace(here, features=here.features - {min(here.features)})  # this one, without something that it has
    monkeypatch.setattr(sys.modules[build.__module__], "this_cpu", lambda: other)
    with pytest.raises(SolverError, match="damaged or was built for another processor"):
        load(built)
    again = build(UNITS, headers=HEADER, width=4)
    assert again.built
    assert again.key != built.key


def test_a_truncated_library_is_built_anew() -> None:
    built = build(UNITS, headers=HEADER)
    built.path.write_bytes(built.path.read_bytes()[:-100])
    with pytest.raises(SolverError, match="damaged"):
        load(built)
    again = build(UNITS, headers=HEADER)
    assert again.built
    assert again.path == built.path
    load(again)


def test_a_missing_library_is_reported() -> None:
    built = build(UNITS, headers=HEADER)
    Cache().clear()
    with pytest.raises(SolverError, match="got no file, expected the built file; build it again"):
        load(built)
