"""Whatever goes wrong, an exported controller has a defined output."""

import ctypes as ct
from typing import Any

import numpy as np
import pytest

from piaffe.models import stance
from tests.solvers.export.conftest import Trot

OK, NO_PLAN, TOO_OLD, BAD_STATE, BAD_TIME, BAD_NUMBERS, OUTSIDE, BAD_COMMAND, BAD_ARGUMENT = range(9)
PROGRAM_FAILED, DAMPED, LATE, LATCHED = 1, 2, 4, 8
SPEEDS = slice(25, 37)


@pytest.fixture
def x(trot: Trot) -> np.ndarray:
    state = np.array(trot.exported.mpc.initial)
    state[SPEEDS] = np.linspace(-1.0, 1.0, 12)
    return state


@pytest.fixture
def started(trot: Trot) -> Any:
    controller = trot.module.Controller()
    assert controller.reset(trot.exported.mpc.initial, 0.0) == OK
    return controller


def damped(x: np.ndarray) -> np.ndarray:
    return -np.where(np.isfinite(x[SPEEDS]), x[SPEEDS], 0.0)


def test_before_the_first_plan_joints_are_damped(trot: Trot, x: np.ndarray) -> None:
    output = trot.module.Controller().tick(x, 0.0)
    assert (output.status, output.fallback) == (NO_PLAN, DAMPED)
    assert output.plan_age == -1.0
    assert np.array_equal(output.torque, damped(x))
    assert np.array_equal(output.joint_position, x[7:19])
    assert not any(output.joint_velocity)
    assert not any(output.feet_force)


def test_damping_keeps_within_limits_and_is_an_option(trot: Trot, x: np.ndarray) -> None:
    output = trot.module.Controller(damping=100.0).tick(x, 0.0)
    assert np.array_equal(output.torque, np.clip(100.0 * damped(x), -17.0, 17.0))


def test_state_that_is_not_finite_damps_and_does_not_latch(started: Any, x: np.ndarray) -> None:
    bad = x.copy()
    bad[[2, 30]] = np.nan, np.inf
    output = started.tick(bad, 0.0)
    assert (output.status, output.fallback) == (BAD_STATE, DAMPED)
    assert np.array_equal(output.torque, damped(bad))
    assert started.tick(x, 0.002).status == OK
    assert started.plan(bad, 0.002) == BAD_STATE
    assert started.plan(x, 0.02) == OK


def test_time_that_is_not_finite_or_goes_back_is_told(started: Any, x: np.ndarray) -> None:
    for t in (np.nan, np.inf, -np.inf):
        output = started.tick(x, t)
        assert output.status == BAD_TIME
        assert output.fallback == DAMPED
        assert started.plan(x, t) == BAD_TIME
    before = started.tick(x, 0.01).torque[:]
    back = started.tick(x, 0.004)
    assert back.status == BAD_TIME
    assert back.fallback == 0
    assert back.torque[:] != before
    assert started.plan(x, 0.04) == OK
    assert started.plan(x, 0.02) == BAD_TIME


@pytest.mark.parametrize("far", [1.0, 1e6, 1e300])
def test_one_time_far_ahead_changes_nothing_later(started: Any, trot: Trot, far: float) -> None:
    start, untouched = trot.exported.mpc.initial, trot.module.Controller()
    assert untouched.reset(start, 0.0) == OK
    for k in range(1, 40):
        t = 0.02 * k
        if k % 10 == 0:
            odd = started.tick(start, t + far)
            assert (odd.status, odd.fallback) == (BAD_TIME, DAMPED)
            assert started.plan(start, t + far) == BAD_TIME
        assert started.plan(start, t) == untouched.plan(start, t) == OK
        output = started.tick(start, t)
        assert (output.status, output.fallback) == (OK, 0)
        assert output.torque[:] == untouched.tick(start, t).torque[:]


def test_a_first_tick_at_an_absurd_time_does_not_latch(started: Any, x: np.ndarray) -> None:
    assert started.tick(x, 1e9).status == BAD_TIME
    output = started.tick(x, 0.002)
    assert (output.status, output.fallback) == (OK, 0)


def test_a_jump_ahead_that_is_repeated_is_believed(started: Any, x: np.ndarray) -> None:
    assert started.tick(x, 5.0).status == BAD_TIME
    output = started.tick(x, 5.002)
    assert (output.status, output.fallback) == (TOO_OLD, LATE | DAMPED | LATCHED)
    assert started.plan(x, 5.0) == BAD_TIME
    assert started.plan(x, 5.02) == OK
    assert started.plan(x, 5.04) == OK
    assert started.tick(x, 5.04).fallback == DAMPED | LATCHED


def test_a_time_far_back_damps_until_it_is_right(started: Any, x: np.ndarray) -> None:
    for k in range(1, 30):
        assert started.plan(x, 0.02 * k) == OK
        assert started.tick(x, 0.02 * k).status == OK
    for t in (0.0, 0.002, -1e300):
        output = started.tick(x, t)
        assert (output.status, output.fallback) == (BAD_TIME, DAMPED)
        assert np.array_equal(output.torque, damped(x))
    assert started.tick(x, 0.582).status == OK


def test_plan_that_gets_too_old_damps_until_reset(trot: Trot, x: np.ndarray) -> None:
    controller = trot.module.Controller(max_age=0.1)
    start = trot.exported.mpc.initial
    assert controller.reset(start, 0.0) == OK
    fresh = controller.tick(start, 0.02)
    assert (fresh.status, fresh.fallback, fresh.plan_age) == (OK, 0, 0.02)
    late = controller.tick(start, 0.05)
    assert (late.status, late.fallback) == (OK, LATE)
    old = controller.tick(x, 0.11)
    assert (old.status, old.fallback) == (TOO_OLD, LATE | DAMPED | LATCHED)
    assert np.array_equal(old.torque, damped(x))
    assert controller.plan(start, 0.1) == OK
    latched = controller.tick(x, 0.12)
    assert (latched.status, latched.fallback) == (TOO_OLD, DAMPED | LATCHED)
    assert controller.reset(start, 0.0) == OK
    assert controller.tick(start, 0.0).status == OK


def test_absurd_states_keep_torques_finite_and_within_limits(started: Any, x: np.ndarray) -> None:
    rng = np.random.default_rng(0)
    for i in range(300):
        wild = x + rng.normal(size=37) * 10.0 ** rng.uniform(-3, 12)
        output = started.tick(wild, 1e-4 * i)
        assert np.all(np.abs(output.torque) <= 17.0)
        assert np.isfinite(output.feet_force).all()


def test_plan_from_an_absurd_state_leaves_the_plan_before(started: Any, x: np.ndarray) -> None:
    wild = x.copy()
    wild[7:] = 1e9
    assert started.plan(wild, 0.02) in (OK, BAD_NUMBERS)
    assert started.plan(x, 0.04) == OK
    output = started.tick(x, 0.04)
    assert np.all(np.abs(output.torque) <= 17.0)
    assert output.plan_age == 0.0


def test_outputs_tell_what_the_plan_has_and_the_forces_of_the_torques(started: Any, trot: Trot) -> None:
    mpc, low = trot.exported.mpc, trot.exported.low
    mpc.reset()
    plan = mpc.plan(mpc.initial, 0.0)
    low.follow(plan)
    x = np.array(mpc.initial)
    x[7:19] += 0.01
    output = started.tick(x, 0.006)
    phase = plan.phases[0]
    share = phase.states[0] + 0.6 * (phase.states[1] - phase.states[0])
    assert np.allclose(output.joint_position, share[7:19], atol=1e-12)
    assert np.allclose(output.joint_velocity, share[25:37], atol=1e-12)
    u = low.control(x, 0.006)
    assert np.array_equal(output.torque, u)
    model, flags = phase.mode.model, phase.p[0, phase.mode.layout.slots["contact"]]
    feet = " ".join(foot for foot, on in zip(model.robot.foot_names, flags, strict=True) if on)
    forces = model.contact_forces(x, u, stance(feet))
    assert 50.0 < forces[:, 2].sum() < 200.0  # the robot weighs 81 N
    assert np.allclose(np.reshape(output.feet_force, (-1, 3)), forces, atol=1e-6)


def test_commands_that_are_unusable_change_nothing(started: Any, trot: Trot, x: np.ndarray) -> None:
    module = trot.module
    assert started.command(speed=np.nan) == BAD_COMMAND
    wrong = module.Commands(1 << 20)
    assert started.c.trot_command(started._at, ct.byref(wrong)) == BAD_COMMAND
    other = module.Controller()
    assert other.reset(trot.exported.mpc.initial, 0.0) == OK
    assert started.plan(x, 0.02) == other.plan(x, 0.02) == OK
    assert started.tick(x, 0.02).torque[:] == other.tick(x, 0.02).torque[:]
    assert started.command(speed=0.1) == OK
    assert started.plan(x, 0.04) == other.plan(x, 0.04) == OK
    assert started.tick(x, 0.04).torque[:] != other.tick(x, 0.04).torque[:]


def test_memory_and_options_are_checked(trot: Trot) -> None:
    c = trot.module.load(trot.module.LIBRARY)
    size = c.trot_memory_size()
    room = ct.create_string_buffer(size + 128)
    at = ct.addressof(room) + -ct.addressof(room) % 64
    assert c.trot_init(at, size, None) == at
    assert c.trot_init(at, size - 1, None) is None
    assert c.trot_init(at + 8, size, None) is None
    assert c.trot_init(None, size, None) is None
    for wrong in (
        {"max_age": 0.0}, {"max_age": 0.02}, {"max_age": np.nan}, {"damping": -1.0}, {"damping": np.nan},
        {"damping": np.inf}, {"iterations": 0}, {"iterations": 201}, {"time_limit": -1.0}, {"time_limit": np.nan},
    ):  # fmt: skip
        with pytest.raises(ValueError, match="out of range"):
            trot.module.Controller(**wrong)


def test_null_pointers_are_refused(trot: Trot, x: np.ndarray) -> None:
    c, output = trot.module.load(trot.module.LIBRARY), trot.module.Output()
    state = (ct.c_double * 37)(*x)
    assert c.trot_plan(None, state, 0.0) == c.trot_reset(None, state, 0.0) == BAD_ARGUMENT
    assert c.trot_tick(None, state, 0.0, None) == c.trot_tick(None, state, 0.0, ct.byref(output)) == BAD_ARGUMENT
    assert (output.status, output.fallback) == (BAD_ARGUMENT, DAMPED)
    assert not any(output.torque)
    c.trot_cancel(None)


def test_every_status_has_words(trot: Trot) -> None:
    c = trot.module.load(trot.module.LIBRARY)
    words = [c.trot_status_text(i).decode() for i in range(9)]
    assert len(set(words)) == 9
    assert "unknown" not in words
    assert c.trot_status_text(9) == c.trot_status_text(-1) == c.trot_plan_status_text(8) == b"unknown"
    assert len({c.trot_plan_status_text(i) for i in range(8)}) == 8


def test_clock_of_ones_own_limits_the_time(trot: Trot, x: np.ndarray) -> None:
    calls = []

    def clock(_: Any) -> float:
        calls.append(1)
        return 0.001 * len(calls)

    made = ct.CFUNCTYPE(ct.c_double, ct.c_void_p)(clock)
    start = trot.exported.mpc.initial
    limited = trot.module.Controller(time_limit=1e-9, clock=ct.cast(made, ct.c_void_p))
    assert limited.reset(start, 0.0) == OK
    assert limited.tick(start, 0.0).plan_iterations >= 4  # the first plan has no limit
    assert len(calls) >= 4
    assert limited.plan(start, 0.02) == OK
    output = limited.tick(start, 0.02)
    assert output.plan_iterations == 0
    assert limited.c.trot_plan_status_text(output.plan_status) == b"time limit"


def test_two_controllers_do_not_know_of_each_other(trot: Trot, x: np.ndarray) -> None:
    start = trot.exported.mpc.initial
    alone, first, second = (trot.module.Controller() for _ in range(3))
    told = []
    for each in (alone, first, second):
        assert each.reset(start, 0.0) == OK
    assert second.command(speed=0.1) == OK
    for k in range(1, 4):
        assert alone.plan(start, 0.02 * k) == OK
        told.append(alone.tick(x, 0.02 * k).torque[:])
    for k in range(1, 4):
        assert second.plan(x, 0.02 * k) == first.plan(start, 0.02 * k) == OK
        assert second.tick(start, 0.02 * k).status == OK
        assert first.tick(x, 0.02 * k).torque[:] == told[k - 1]
