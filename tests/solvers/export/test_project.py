"""The folder of an exported controller: names, files, consumers."""

import hashlib
import json
import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import pytest

from piaffe import models, ocp, solvers
from piaffe.codegen import defined_symbols
from piaffe.errors import SolverError
from piaffe.models import base
from tests.solvers.export.conftest import Trot, vwbc

ALLOWED = {"memcpy", "memset", "memmove", "memcmp", "clock_gettime"}
LIBM = "acos asin atan atan2 ceil cos cosh exp floor fmax fmin fmod hypot log lround pow sin sincos sinh sqrt tan tanh"
C_PLUS_PLUS = """
#include <cstdio>
#include <cstdlib>
#include "trot.h"
int main() {
    void *memory = std::aligned_alloc(64, trot_memory_size());
    trot *controller = trot_init(memory, trot_memory_size(), nullptr);
    double x[TROT_NX] = {0};
    trot_output output;
    const int status = trot_tick(controller, x, 0.0, &output);
    std::printf("%s\\n", trot_status_text(status));
    std::free(memory);
    return status != TROT_NO_PLAN;
}
"""
CMAKE = """
cmake_minimum_required(VERSION 3.16)
project(robot LANGUAGES C CXX)
{get}
add_executable(robot main.cpp)
target_link_libraries(robot trot::trot)
"""


def test_every_name_has_the_prefix(trot: Trot) -> None:
    names = defined_symbols(trot.folder / "build" / "libtrot.so")
    own = [name for name in names if not name.startswith("_")]
    assert len(own) > 100
    assert [name for name in own if not name.startswith("trot_")] == []
    assert {"trot_init", "trot_reset", "trot_plan", "trot_tick", "trot_cancel", "trot_command"} <= set(own)


@pytest.mark.skipif(shutil.which("nm") is None, reason="needs nm")
def test_the_library_needs_libm_and_no_memory(trot: Trot) -> None:
    told = subprocess.run(
        ["nm", "-u", str(trot.folder / "build" / "libtrot.so")], capture_output=True, text=True, check=True
    ).stdout
    needed = {line.split()[-1].split("@")[0] for line in told.splitlines()}
    foreign = {name for name in needed if not name.startswith("_")}
    assert {"memcpy", "sin"} & foreign
    assert foreign <= ALLOWED | set(LIBM.split())


def test_the_manifest_has_a_hash_of_each_file(trot: Trot) -> None:
    manifest = json.loads((trot.folder / "manifest.json").read_text())
    assert manifest["name"] == "trot"
    assert manifest["period_s"] == 0.02
    assert manifest["max_age_s"] == 0.25
    assert manifest["torque_limits"] == [[-17.0] * 12, [17.0] * 12]
    files = manifest["files"]
    assert {"include/trot.h", "src/controller.c", "LICENSE", "README.md", "examples/loop.c"} <= set(files)
    for path, digest in files.items():
        assert hashlib.sha256((trot.folder / path).read_bytes()).hexdigest() == digest


def test_a_check_writes_sizes_results_and_times(trot: Trot) -> None:
    assert "Nothing yet" in (trot.folder / "README.md").read_text()
    measured = trot.exported.check(seconds=0.4)
    assert measured.bitwise
    assert (measured.plans, measured.ticks) == (50, 500)
    assert measured.library_bytes == (trot.folder / "build" / "libtrot.so").stat().st_size
    assert 0.0 < measured.tick_us[0] <= measured.tick_us[1] <= measured.tick_us[2]
    manifest = json.loads((trot.folder / "manifest.json").read_text())
    assert manifest["measured"]["memory_bytes"] == trot.module.load(trot.module.LIBRARY).trot_memory_size()
    assert manifest["measured"]["plan_ms"] == list(measured.plan_ms)
    readme = (trot.folder / "README.md").read_text()
    assert manifest["files"]["README.md"] == hashlib.sha256(readme.encode()).hexdigest()
    assert "Nothing yet" not in readme
    assert readme.count("## Measured") == readme.count("## State") == 1
    assert f"| tick [µs] | {measured.tick_us[0]:.3g} |" in readme
    trot.exported.check(seconds=0.4)
    assert (trot.folder / "README.md").read_text().count("## Measured") == 1


def test_a_check_needs_a_record_and_a_duration(trot: Trot, tmp_path: Path) -> None:
    with pytest.raises(SolverError, match="there is no record - got no check.bin"):
        replace(trot.exported, folder=tmp_path).check()
    with pytest.raises(SolverError, match="seconds is out of range - got 0 s"):
        trot.exported.check(seconds=0.0)


def test_a_check_that_fails_is_told(trot: Trot, tmp_path: Path) -> None:
    (tmp_path / "Makefile").write_text("all:\n\ncheck:\n\t@echo FAILED; exit 1\n")
    (tmp_path / "check.bin").write_bytes(b"")
    with pytest.raises(SolverError, match=r"it fails - got exit code 2 and\n(.*\n)*.*FAILED"):
        replace(trot.exported, folder=tmp_path).check()


def test_the_readme_names_states_torques_and_forces(trot: Trot) -> None:
    text = (trot.folder / "README.md").read_text()
    for words in (
        "| 19 | base.linear_velocity x | m/s |", "| 3 | base.orientation w | 1 |", "| 1 | FL_HFE | -17 to 17 |",
        "feet_force[12]", "in the order FL x, FL y, FL z, FR x,", "`speed`", "speeds in m/s", "bytes with vectors of",
    ):  # fmt: skip
        assert words in text
    for path in ("README.md", "include/trot.h", "src/controller.c", "CMakeLists.txt", "Makefile", "examples/loop.c"):
        own = (trot.folder / path).read_text()
        assert not re.search(r"\bNAME\b|@[A-Z]+@", own), path


def test_the_header_names_entries_orders_and_periods(trot: Trot) -> None:
    text = (trot.folder / "include" / "trot.h").read_text()
    for words in (
        "for the robot mini_cheetah", "0 to 2  base.position [m]: x, y, z", "7 to 18  joints.position [rad]: FL_HAA, ",
        "3 to 6  base.orientation [1]: w, x, y, z", "#define TROT_PERIOD 0.02", "#define TROT_LATENCY 0.0",
        "in the order FL x, FL y, FL z, FR x,", "those declared: speed 0.5, lateral_speed 0,",
    ):  # fmt: skip
        assert words in text
    assert max(map(len, text.splitlines())) <= 190


def test_what_a_unit_includes_makes_it_old(trot: Trot) -> None:
    assert "src/" not in trot.make("-n", "build/libtrot.a").stdout
    told = trot.make("-n", "-W", "src/solver/riccati.inc", "build/libtrot.a").stdout
    assert "src/solver/mode0.c" in told
    assert "src/solver/riccati.inc" not in told


def test_memory_is_bounded(trot: Trot) -> None:
    c = trot.module.load(trot.module.LIBRARY)
    size = c.trot_memory_size()
    assert size <= 4_000_000
    told = json.loads((trot.folder / "manifest.json").read_text())["memory_bytes_about"]
    assert abs(told - size) < 0.02 * size


def test_calls_need_less_stack_than_is_stated(trot: Trot, tmp_path: Path) -> None:
    initial = ", ".join(map(repr, trot.exported.mpc.initial.tolist()))
    text = Path(__file__).with_name("stack.c").read_text().replace("@INITIAL@", initial)
    (tmp_path / "stack.c").write_text(text)
    words = ["-std=c11", "-Wall", "-Wextra", "-Werror", f"-I{trot.folder}/include", "stack.c"]
    library = [str(trot.folder / "build" / "libtrot.a"), "-lm", "-pthread", "-o", "stack"]
    subprocess.run([shutil.which("cc") or "gcc", *words, *library], cwd=tmp_path, check=True)
    told = subprocess.run([str(tmp_path / "stack")], capture_output=True, text=True, check=True).stdout
    stated = json.loads((trot.folder / "manifest.json").read_text())["stack_bytes"]
    used = [int(each) for each in re.findall(r"\d+", told)]
    assert len(used) == 3
    assert all(4096 < each <= stated for each in used), told


def test_names_that_are_no_identifiers_are_refused(trot: Trot, tmp_path: Path) -> None:
    with pytest.raises(SolverError, match="name is unusable - got 'my trot'"):
        solvers.export_controller(trot.exported.mpc.problem, tmp_path / "a", name="my trot", low=vwbc)
    assert not (tmp_path / "a").exists()


def test_a_plan_must_act_until_the_next_one(trot: Trot, tmp_path: Path) -> None:
    with pytest.raises(SolverError, match=r"max_age is out of range - got 0.02 s, expected more than 0.02 s"):
        solvers.export_controller(trot.exported.mpc.problem, tmp_path / "a", name="trot", low=vwbc, max_age=0.02)
    assert not (tmp_path / "a").exists()


def test_what_is_not_compiled_is_refused(trot: Trot, tmp_path: Path) -> None:
    with pytest.raises(SolverError, match="the planner is not compiled"):
        solvers.export_controller(
            trot.exported.mpc.problem, tmp_path, name="trot", low=vwbc, options={"backend": "numpy"}
        )
    with pytest.raises(SolverError, match="Vwbc is not compiled"):
        solvers.export_controller(
            trot.exported.mpc.problem, tmp_path, name="trot", low=lambda plan: solvers.Vwbc(plan, qp="numpy")
        )


def test_a_model_without_joints_is_refused(tmp_path: Path) -> None:
    robot = models.load("mini_cheetah")
    srb = models.SingleRigidBody(robot)
    problem = ocp.Problem(
        models.gaits.trot(speed=0.5), srb.over(0.5, dt=0.05),
        ocp.Objective(ocp.track(base.position, weight=1.0), ocp.track(models.feet.force, weight=1e-3)),
        ocp.Constraints(models.friction_cone(mu=0.6)), initial=srb.state(),
    )  # fmt: skip
    with pytest.raises(SolverError, match="no speeds to damp"):
        solvers.export_controller(problem, tmp_path, name="srb", low=solvers.Vwbc, options={"period": 0.05})


def test_a_program_in_c_plus_plus_uses_the_library(trot: Trot, tmp_path: Path) -> None:
    compiler = shutil.which("g++") or shutil.which("clang++")
    if compiler is None:
        pytest.skip("needs a C++ compiler")
    (tmp_path / "main.cpp").write_text(C_PLUS_PLUS)
    words = ["-std=c++17", "-Wall", "-Wextra", "-Wpedantic", "-Werror", f"-I{trot.folder}/include", "main.cpp"]
    library = [str(trot.folder / "build" / "libtrot.a"), "-lm", "-o", "main"]
    subprocess.run([compiler, *words, *library], cwd=tmp_path, check=True)
    done = subprocess.run([str(tmp_path / "main")], capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (0, "there is no plan yet\n")


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("cmake") is None, reason="needs CMake")
@pytest.mark.parametrize("way", ["add_subdirectory", "find_package"])
def test_a_project_of_cmake_uses_the_library(trot: Trot, tmp_path: Path, way: str) -> None:
    def cmake(*words: object) -> None:
        subprocess.run(["cmake", *map(str, words)], cwd=tmp_path, check=True, capture_output=True)

    get = f"add_subdirectory({trot.folder} trot)" if way == "add_subdirectory" else "find_package(trot REQUIRED)"
    (tmp_path / "main.cpp").write_text(C_PLUS_PLUS)
    (tmp_path / "CMakeLists.txt").write_text(CMAKE.replace("{get}", get))
    if way == "find_package":
        cmake("-S", trot.folder, "-B", "made")
        cmake("--build", "made", "-j2")
        cmake("--install", "made", "--prefix", "installed")
    cmake("-S", ".", "-B", "build", f"-DCMAKE_PREFIX_PATH={tmp_path}/installed")
    cmake("--build", "build", "-j2")
    done = subprocess.run([str(tmp_path / "build" / "robot")], capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (0, "there is no plan yet\n")
