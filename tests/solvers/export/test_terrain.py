"""An exported controller has the terrain of its problem."""

import subprocess
from pathlib import Path

import numpy as np
import pytest

from piaffe import simulation, solvers
from piaffe.ocp import load_problem_file
from tests.solvers.export.conftest import vwbc


@pytest.mark.slow
def test_a_controller_climbs_stairs_as_in_python_bit_for_bit(tmp_path: Path) -> None:
    problem, module = load_problem_file("examples/stairs_mpc.py")
    exported = solvers.export_controller(problem, tmp_path, name="stairs", low=vwbc)
    recorder, ground = exported.recorder(), module.grounds["stairs"]
    start = problem.initial.copy()
    start[0] += 0.25  # its feet are soon on the first step
    plant = simulation.Plant(module.robot, friction=0.7, terrain=ground)
    episode = simulation.run_online(recorder, recorder, plant, seconds=2.0, initial=start)
    assert not episode.fault
    assert float(ground.height(*episode.last[:2])) >= 0.04
    assert np.isfinite(episode.controls).all()
    (tmp_path / "check.bin").write_bytes(recorder.file())
    done = subprocess.run(["make", "-C", str(tmp_path), "-j2", "check"], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-2000:]
    assert "100 plans, 1000 ticks" in done.stdout
    assert "bitwise equal to the record\npassed" in done.stdout
