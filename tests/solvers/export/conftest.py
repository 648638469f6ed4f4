"""A trot that is exported and built once for all tests."""

import fcntl
import hashlib
import importlib.util
import os
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from piaffe import simulation, solvers
from piaffe.ocp import load_problem_file

WARNINGS = "-Wall -Wextra -Wpedantic -Wshadow -Wvla -Wstrict-prototypes -Werror"
HORIZONTAL = ("base.position x", "base.position y")
COMMANDS = "vx=0.7@0.4 yaw=0.4@0.5"
SECONDS = 1.0


@dataclass
class Trot:
    """An exported trot, its module of Python, and the closed loop that was recorded."""

    folder: Path
    module: ModuleType
    episode: simulation.OnlineEpisode
    exported: solvers.Exported
    plant: simulation.Plant

    def make(self, *words: str) -> subprocess.CompletedProcess[str]:
        """Return what make does in its folder."""
        return subprocess.run(["make", "-C", str(self.folder), *words], capture_output=True, text=True)


def vwbc(plan: solvers.Plan) -> solvers.LowLevel:
    """Return the low level that is exported."""
    return solvers.Vwbc(plan, leave_out=HORIZONTAL)


@pytest.fixture(scope="session")
def trot(tmp_path_factory: pytest.TempPathFactory) -> Trot:
    """Return the exported trot."""
    folder = tmp_path_factory.mktemp("export") / "trot"
    problem, module = load_problem_file("examples/trot_mpc.py")
    exported = solvers.export_controller(problem, folder, name="trot", low=vwbc)
    recorder, plant = exported.recorder(), simulation.Plant(module.robot, friction=0.7)
    commands = simulation.parse_commands(COMMANDS)
    episode = simulation.run_online(recorder, recorder, plant, seconds=SECONDS, commands=commands)
    (folder / "check.bin").write_bytes(recorder.file())
    found = Trot(folder, ModuleType("none"), episode, exported, plant)
    build(found, tmp_path_factory.getbasetemp())
    found.module = load_module(folder / "python" / "trot.py")
    return found


def load_module(path: Path) -> ModuleType:
    """Return the module of Python of an exported controller."""
    spec = importlib.util.spec_from_file_location(f"exported_{path.stem}", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def build(trot: Trot, base: Path) -> None:
    """Build the library, or take what another process of this run has built from the same sources."""
    shared = base.parent if "PYTEST_XDIST_WORKER" in os.environ else base
    digest = hashlib.sha256()
    for path in sorted((trot.folder / "src").rglob("*.*")):
        digest.update(path.read_bytes())
    kept = shared / f"build_{digest.hexdigest()[:16]}"
    with (shared / "build.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not kept.exists():
            made = trot.make(f"-j{len(os.sched_getaffinity(0))}", f"CFLAGS={WARNINGS}", "all", "build/check")
            assert made.returncode == 0, made.stderr[-4000:]
            shutil.copytree(trot.folder / "build", kept)
            return
    shutil.copytree(kept, trot.folder / "build", copy_function=shutil.copyfile)  # newer than the sources
    for name in (f"lib{trot.exported.name}.a", f"lib{trot.exported.name}.so", "check"):  # in the order of make
        os.utime(trot.folder / "build" / name)
    (trot.folder / "build" / "check").chmod(0o755)


class InSimulation:
    """An exported controller as planner and low level of ``run_online``."""

    def __init__(self, controller: object, period: float, initial: np.ndarray) -> None:
        self.controller, self.period, self.initial, self.began = controller, period, initial, False
        self.statuses: list[int] = []

    def reset(self) -> None:
        self.began = False

    def command(self, **values: object) -> None:
        assert self.controller.command(**values) == 0

    def plan(self, x: np.ndarray, t: float) -> None:
        make = self.controller.plan if self.began else self.controller.reset
        self.began = True
        self.statuses.append(make(x, t))

    def follow(self, plan: None) -> None:
        pass

    def control(self, x: np.ndarray, t: float) -> np.ndarray:
        output = self.controller.tick(x, t)
        self.statuses.append(output.status)
        return np.array(output.torque)
