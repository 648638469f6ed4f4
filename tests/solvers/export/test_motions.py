"""Several motions in one exported controller: torques and plans of Python, requests, and what refuses one."""

import re
from types import ModuleType

import numpy as np
import pytest

from piaffe import models, ocp, simulation, solvers
from piaffe.codegen import defined_symbols
from piaffe.errors import SolverError
from piaffe.models import stance
from tests.solvers.export.conftest import InSimulation, Trot, build, load_module, vwbc
from tests.solvers.receding.test_ticks import problem, quadruped

COMMANDS = "vx=0.1 motion=pace@0.4 yaw=0.3@0.6 motion=trot@1.2 yaw=0@1.4 vx=0@1.4 motion=bow@2.0"
OPTIONS = {"latency": 0.02, "preparations": 2, "after": {"bow": "pace"}, "retiming": solvers.Retiming()}
SECONDS = 3.0
DRIVEN = ["trot", "pace", "trot", "bow", "pace"]


def declared() -> dict[str, ocp.Problem]:
    """Return two gaits, and a bow, which has an end."""
    four = stance("FL FR HL HR")
    bow = ocp.Motion(
        ocp.Phase("down", four, 0.2, ocp.Keyframe(position=(0, 0, 0.22), rpy=(0, 0.1, 0))),
        ocp.Phase("up", four, 0.2, ocp.Keyframe(position=(0, 0, 0.25), rpy=(0, 0, 0))),
    )
    made = {kind: getattr(models.gaits, kind)(speed=0.1) for kind in ("trot", "pace")}
    return {name: problem(motion) for name, motion in {**made, "bow": bow}.items()}


@pytest.fixture(scope="session")
def gaits(tmp_path_factory: pytest.TempPathFactory) -> Trot:
    """Return the exported motions."""
    folder = tmp_path_factory.mktemp("export") / "gaits"
    exported = solvers.export_controller(declared(), folder, name="gaits", low=vwbc, options=OPTIONS)
    recorder, plant = exported.recorder(), simulation.Plant(quadruped()[0].robot, friction=0.7)
    commands = simulation.parse_commands(COMMANDS)
    episode = simulation.run_online(recorder, recorder, plant, seconds=SECONDS, latency=0.02, commands=commands)
    (folder / "check.bin").write_bytes(recorder.file())
    found = Trot(folder, ModuleType("none"), episode, exported, plant)
    build(found, tmp_path_factory.getbasetemp())
    found.module = load_module(folder / "python" / "gaits.py")
    return found


def test_torques_in_simulation_are_those_of_python(gaits: Trot) -> None:
    exported = InSimulation(gaits.module.Controller(), gaits.module.PERIOD, gaits.exported.mpc.initial)
    commands = simulation.parse_commands(COMMANDS)
    episode = simulation.run_online(exported, exported, gaits.plant, seconds=SECONDS, latency=0.02, commands=commands)
    assert set(exported.statuses) == {0}
    assert [name for _, name in gaits.episode.motions] == DRIVEN
    assert gaits.episode.motions[1][0] == pytest.approx(0.55)  # its phase begins between the starts of two plans
    assert not episode.fault
    assert np.array_equal(episode.controls, gaits.episode.controls)
    mpc = gaits.exported.mpc  # its loop in C, with commands between the motions
    mpc.reset()
    low = vwbc(mpc.plan(mpc.initial, 0.0))
    looped = simulation.run_online(mpc, low, gaits.plant, seconds=SECONDS, latency=0.02, commands=commands)
    assert np.array_equal(episode.controls, looped.controls)


def test_check_replays_the_record_bit_for_bit(gaits: Trot) -> None:
    done = gaits.make("check")
    assert done.returncode == 0, done.stdout + done.stderr[-2000:]
    assert "149 plans, 1490 ticks" in done.stdout
    assert "bitwise equal to the record\npassed" in done.stdout


def test_an_output_tells_the_motion_and_the_request(gaits: Trot) -> None:
    controller, x = gaits.module.Controller(), gaits.exported.mpc.initial
    names = gaits.module.MOTIONS
    assert names == ["trot", "pace", "bow"]
    output = controller.tick(x, 0.0)
    assert (output.status, output.motion, output.next_motion) == (1, -1, -1)
    assert controller.reset(x, 0.0) == 0
    assert controller.command(motion="pace") == 0
    seen = []
    for k in range(250):
        t = 0.002 * k
        if k and k % 10 == 0:
            assert controller.plan(x, t) == 0
        output = controller.tick(x, t)
        if output.motion >= 0:  # a plan acts after the latency
            seen.append((names[output.motion], names[output.next_motion]))
    assert list(dict.fromkeys(seen)) == [("trot", "trot"), ("trot", "pace"), ("pace", "pace")]
    assert controller.c.gaits_motion_name(output.motion) == b"pace"
    assert controller.reset(x, 0.0) == 0  # it forgets motion and request
    output = controller.tick(x, 0.02)
    assert (names[output.motion], names[output.next_motion]) == ("trot", "trot")


def test_what_is_no_motion_is_refused(gaits: Trot) -> None:
    module = gaits.module
    controller = module.Controller()
    for wrong in (-1, 3, 1 << 30):
        commands = module.Commands(module.COMMANDS["motion"])
        commands.motion = wrong
        assert controller.c.gaits_command(controller._at, module.ct.byref(commands)) == 7
    commands = module.Commands(2 * module.COMMANDS["motion"])
    assert controller.c.gaits_command(controller._at, module.ct.byref(commands)) == 7
    with pytest.raises(ValueError, match="options are out of range"):
        module.Controller(max_age=0.06)  # two periods and the latency


def test_names_texts_and_sizes(gaits: Trot) -> None:
    names = defined_symbols(gaits.folder / "build" / "libgaits.so")
    assert [name for name in names if not name.startswith(("gaits_", "_"))] == []
    header = (gaits.folder / "include" / "gaits.h").read_text()
    assert "enum { GAITS_MOTION_TROT, GAITS_MOTION_PACE, GAITS_MOTION_BOW, GAITS_MOTIONS };" in header
    readme = (gaits.folder / "README.md").read_text()
    assert "The motions are `trot`, `pace`, `bow`" in readme
    assert not re.search(r"\bNAME\b|@[A-Z_]+@", readme + header)
    assert '"motions": [\n    "trot",\n    "pace",\n    "bow"\n  ]' in (gaits.folder / "manifest.json").read_text()
    assert len(list((gaits.folder / "src" / "solver").glob("mode*.c"))) == 2  # those of one gait
    size = gaits.module.load(gaits.module.LIBRARY).gaits_memory_size()
    assert size < 4 << 20


def test_a_plan_must_act_until_the_one_after_a_change(gaits: Trot, tmp_path: object) -> None:
    with pytest.raises(SolverError, match=r"expected more than 0.06 s, two periods and the latency"):
        solvers.export_controller(declared(), tmp_path, name="gaits", low=vwbc, options=OPTIONS, max_age=0.06)
