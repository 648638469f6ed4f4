"""Ctrl-C at random moments of compile, solve, plan and study: it is never lost, and the exit code is 130."""

import itertools
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import casadi as cs
import numpy as np
import pytest

import piaffe
from piaffe import models, ocp, sampling, solvers
from piaffe.cli.app import main
from piaffe.interrupts import check_interrupt, deferred, interruptible
from piaffe.sampling import load_episodes

MOMENTS = 50
BALL = """
from piaffe import ocp
def fall(s): return {"z": s.vz, "vz": s.thrust - 9.81}
ball = ocp.Model("ball", state={"z": 1, "vz": 1}, control={"thrust": 1}, modes={"fall": fall})
objective = ocp.Objective(ocp.track("z", weight=10.0), ocp.regularize("thrust", weight=0.1))
def made(factor=1.0):
    return ocp.Problem(
        ocp.Motion(ocp.Phase("drop", "fall", 1.0, target={"z": 0.6})), ball.until_end(dt=0.01),
        objective + ocp.residual(lambda s: factor * s.z * s.vz).weighted(0.1), initial=[1.0, 0.0],
    )
problem = made()
"""


@pytest.fixture(autouse=True)
def interrupts() -> Iterator[None]:
    """Have SIGINT raise KeyboardInterrupt, also where the tests run in the background."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def lost(work: Callable[[int], object], moments: int, longest: float) -> int:
    """Interrupt work that is repeated at random moments; return how often no interrupt was raised."""
    rng, count = np.random.default_rng(0), 0
    for _ in range(moments):
        sent, killed = threading.Event(), threading.Event()

        def send(sent: threading.Event = sent, killed: threading.Event = killed) -> None:
            sent.set()
            os.kill(os.getpid(), signal.SIGINT)
            killed.set()

        timer = threading.Timer(float(rng.uniform(0.0, longest)), send)
        try:
            timer.start()
            k = 0
            while not sent.is_set():
                work(k := k + 1)
            killed.wait()  # the signal may come after the event
            time.sleep(0.05)
            count += 1
        except KeyboardInterrupt:
            pass
        finally:
            timer.cancel()
            timer.join()
    return count


def sampled_trot() -> ocp.Problem:
    model = models.Mujoco(models.load("solo12"))
    objective = ocp.Objective(ocp.track(models.base.linear_velocity), ocp.track(models.base.height))
    return ocp.Problem(models.gaits.trot(0.3), model.over(0.1, dt=0.02), objective, initial=model.state(joints="stand"))


def test_an_interrupt_of_a_compilation_is_not_lost() -> None:
    names: dict[str, Callable[[float], ocp.Problem]] = {}
    exec(BALL, names)
    assert lost(lambda k: ocp.compile_problem(names["made"](k + 0.5)), MOMENTS, 0.1) == 0
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_an_interrupt_that_casadi_clears_is_raised_at_the_end() -> None:
    def expressions(_: int) -> None:
        with interruptible():
            for _ in range(100):
                x = cs.SX.sym("x", 10)
                cs.vertcat(x[3:7] * 2 + x[0], x, 1.0)

    assert lost(expressions, MOMENTS, 0.05) == 0


def test_a_step_asks_for_an_interrupt_that_was_lost() -> None:
    def steps() -> None:
        with interruptible():
            try:
                os.kill(os.getpid(), signal.SIGINT)
                time.sleep(1.0)
            except KeyboardInterrupt:
                pass  # as CasADi does
            for _ in range(3):
                check_interrupt()
                raise AssertionError("the step after the interrupt began")

    with pytest.raises(KeyboardInterrupt):
        steps()
    check_interrupt()  # it was raised, and is no longer pending


def test_an_error_that_an_interrupt_became_is_an_interrupt() -> None:
    def work() -> None:
        with interruptible():
            try:
                os.kill(os.getpid(), signal.SIGINT)
                time.sleep(1.0)
            except KeyboardInterrupt:
                raise NotImplementedError("Wrong number or type of arguments") from None

    with pytest.raises(KeyboardInterrupt):
        work()


def test_the_handler_that_was_there_is_called_and_comes_back() -> None:
    heard: list[int] = []

    def own(number: int, frame: object) -> None:
        heard.append(number)

    before = signal.signal(signal.SIGINT, own)
    try:
        with interruptible(), interruptible():
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(0.01)
        assert heard == [signal.SIGINT]
        assert signal.getsignal(signal.SIGINT) is own
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        with interruptible():
            assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGINT, before)


def test_nothing_is_installed_in_another_thread() -> None:
    found: list[object] = []

    def work() -> None:
        with interruptible(), deferred():
            check_interrupt()
            found.append(signal.getsignal(signal.SIGINT))

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert found == [signal.default_int_handler]


def test_a_deferred_interrupt_comes_at_the_end() -> None:
    done: list[int] = []

    def work() -> None:
        with deferred():
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(0.01)
            done.append(1)

    with pytest.raises(KeyboardInterrupt):
        work()
    assert done == [1]
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_an_error_of_a_deferred_step_does_not_replace_the_interrupt() -> None:
    def work() -> None:
        with deferred():
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(0.01)
            raise ValueError("of the step")

    with pytest.raises(KeyboardInterrupt) as caught:
        work()
    assert isinstance(caught.value.__context__, ValueError)
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_an_interrupt_of_a_sampled_plan_is_not_lost() -> None:
    """Each plan is at a later time, so that it takes up other numbers of the motion, too."""
    controller = sampling.DIAL(sampled_trot(), samples=8, first_stages=1, threads=1)
    steps = itertools.count()

    def plan(_: int) -> Any:
        return controller.plan(controller.initial, 0.02 * next(steps))

    plan(0)
    assert lost(plan, MOMENTS, 0.05) == 0
    assert np.all(np.isfinite(plan(0).controls))  # it goes on after an interrupt
    controller.engine.close()


def test_an_interrupt_of_a_receding_horizon_is_not_lost() -> None:
    names: dict[str, ocp.Problem] = {}
    exec(BALL, names)
    horizon = solvers.RecedingHorizon(names["problem"].with_schedule(names["ball"].over(0.3, dt=0.01)))  # type: ignore[attr-defined]  # a model

    def plan(k: int) -> None:
        if k % 60 < 2:
            horizon.reset()
        horizon.plan(horizon.initial, 0.01 * (k % 60))

    plan(1)
    assert lost(plan, MOMENTS, 0.02) == 0
    plan(1)  # it goes on after an interrupt


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # files that Python itself had open
def test_a_command_that_is_interrupted_exits_with_130(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The moments are those of loading, compiling and solving."""
    file = tmp_path / "ball.py"
    file.write_text(BALL)
    main(["solve", str(file), "--json", "--no-save"])  # what is imported and compiled once
    codes: list[int] = []

    def solve(_: int) -> None:
        codes.append(main(["solve", str(file), "--json", "--no-save"]))
        if codes[-1] == 130:
            raise KeyboardInterrupt

    assert lost(solve, MOMENTS, 0.15) == 0
    assert set(codes) <= {0, 1, 130}
    capsys.readouterr()


ENDING = """
import atexit, sys, time
from piaffe.cli.app import main
atexit.register(lambda: (print("ends", flush=True), time.sleep(30)))
sys.argv = ["piaffe", "--version"]
sys.exit(main())
"""


def test_an_interrupt_while_python_ends_exits_with_130() -> None:
    process = subprocess.Popen(
        [sys.executable, "-c", ENDING], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        env={**os.environ, "PYTHONPATH": str(Path(piaffe.__file__).parent.parent)},
    )  # fmt: skip
    assert process.stdout is not None
    try:
        lines = [process.stdout.readline(), process.stdout.readline()]
        process.send_signal(signal.SIGINT)
        rest, _ = process.communicate(timeout=20)
    finally:
        process.kill()
    assert (lines[1], process.returncode, rest) == ("ends\n", 130, "")


@pytest.mark.parametrize(
    "after",
    [0.0, 0.3, 1.0]
    + [pytest.param(each, marks=pytest.mark.slow) for each in np.random.default_rng(0).uniform(0.0, 6.0, MOMENTS - 3)],
)
def test_a_study_whose_workers_start_exits_with_130(tmp_path: Path, after: float) -> None:
    """The interrupt goes to all processes, as a terminal sends it, some time after the first line of the study."""
    examples = Path(piaffe.__file__).resolve().parent.parent.parent / "examples"
    if not (examples / "trot_mppi.py").exists():
        pytest.skip("needs the examples")
    study = tmp_path / "study.toml"
    study.write_text(
        f'file = "{examples / "trot_mppi.py"}"\ncontroller = "dial"\nvalue = "none"\n'
        "samples = 4\nsteps = 3\nseeds = 4\n"
    )
    process = subprocess.Popen(
        [sys.executable, "-m", "piaffe", "study", str(study), "--workers", "2"],
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, start_new_session=True,
        env={**os.environ, "PYTHONPATH": str(Path(piaffe.__file__).parent.parent), "PYTHONUNBUFFERED": "1"},
    )  # fmt: skip
    assert process.stdout is not None
    try:
        line = process.stdout.readline()
        time.sleep(after)
        os.killpg(process.pid, signal.SIGINT)
        rest, _ = process.communicate(timeout=60)
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
            process.communicate()
    assert "episodes" in line, line + rest
    assert process.returncode in ((0, 130) if "saved" in rest else (130,)), rest
    assert "Traceback" not in rest
    for file in (tmp_path / "study").rglob("seed-*.npz"):
        assert load_episodes(file)[0]
