"""An exported controller does what planner and low level do in Python, bit for bit."""

import subprocess

import numpy as np

from piaffe import simulation
from tests.solvers.export.conftest import COMMANDS, SECONDS, InSimulation, Trot


def test_torques_in_simulation_are_those_of_python(trot: Trot) -> None:
    exported = InSimulation(trot.module.Controller(), trot.module.PERIOD, trot.exported.mpc.initial)
    commands = simulation.parse_commands(COMMANDS)
    episode = simulation.run_online(exported, exported, trot.plant, seconds=SECONDS, commands=commands)
    assert set(exported.statuses) == {0}
    assert not episode.fault
    assert np.array_equal(episode.controls, trot.episode.controls)
    assert np.abs(episode.controls).max() > 1.0


def test_check_replays_the_record_bit_for_bit(trot: Trot) -> None:
    done = trot.make("check")
    assert done.returncode == 0, done.stderr[-2000:]
    assert "50 plans, 500 ticks" in done.stdout
    assert "bitwise equal to the record\npassed" in done.stdout


def test_check_finds_a_torque_that_differs(trot: Trot) -> None:
    recorded = (trot.folder / "check.bin").read_bytes()
    last = np.frombuffer(recorded[-8 - 8 * 12 : -8])
    assert np.array_equal(last, trot.episode.controls[-1])
    changed = trot.folder / "changed.bin"
    changed.write_bytes(recorded[: -8 - 8 * 12] + (last + 1e-6).tobytes() + recorded[-8:])
    check = trot.folder / "build" / "check"
    assert trot.make("build/check").returncode == 0
    found = run(check, changed)
    assert found.returncode == 1
    assert "1 ticks differ" in found.stdout
    assert found.stdout.endswith("FAILED\n")


def test_check_finds_a_plan_that_differs(trot: Trot) -> None:
    """A measured state that is not the one of the recorded plan makes another plan."""
    recorded = bytearray((trot.folder / "check.bin").read_bytes())
    state = trot.exported.mpc.initial.tobytes()
    at = recorded.index(state) + 8 * 2
    recorded[at : at + 8] = np.array([0.3]).tobytes()  # height [m]
    changed = trot.folder / "changed.bin"
    changed.write_bytes(bytes(recorded))
    assert trot.make("build/check").returncode == 0
    found = run(trot.folder / "build" / "check", changed)
    assert found.returncode == 1
    assert found.stdout.endswith("FAILED\n")


def run(program: object, *words: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run([str(program), *map(str, words)], capture_output=True, text=True)
