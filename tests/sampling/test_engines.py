"""Rollout engines: the same states as stepping by hand, and no surprise when a simulation diverges."""

from concurrent.futures import ThreadPoolExecutor
from threading import Event

import mujoco
import numpy as np
import pytest

from piaffe import models
from piaffe.errors import ModelError, SamplingError, ShapeError
from piaffe.sampling.engines import engine_for, take
from piaffe.sampling.engines.engine import MAX_SPEED, shared_steps
from piaffe.sampling.engines.native import NativeEngine

from . import solo


@pytest.fixture(params=[0, 2], ids=["on the calling thread", "two threads"])
def engine(request):
    with NativeEngine(solo.simulated(), threads=request.param) as engine:
        yield engine


def by_hand(model, x0, controls, substeps=1):
    """Step one sample with ``mj_step``."""
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = x0[: model.nq], x0[model.nq :]
    states = [x0]
    for control in controls:
        data.ctrl[:] = control
        for _ in range(substeps):
            mujoco.mj_step(model, data)
        states.append(np.r_[data.qpos, data.qvel])
    return np.array(states)


def test_rollouts_are_mujoco_stepped_by_hand(engine):
    simulated, controls = solo.simulated(), solo.controls(7, 5)
    model = simulated.compiled()
    rollouts = engine.rollout(solo.STANDING, controls)
    assert rollouts.failures == 0
    for states, control in zip(rollouts.states, controls, strict=True):
        assert np.array_equal(states, by_hand(model, solo.STANDING, control))


@pytest.mark.parametrize("threads", [0, 2])
def test_a_control_is_held_over_substeps(threads):
    simulated = solo.simulated(substeps=4, dt=0.005)
    controls = solo.controls(3, 6)
    with NativeEngine(simulated, threads=threads) as engine:
        states = engine.rollout(solo.STANDING, controls).states
    model = simulated.compiled()
    for path, control in zip(states, controls, strict=True):
        assert np.array_equal(path, by_hand(model, solo.STANDING, control, substeps=4))


def test_each_sample_may_start_elsewhere(engine):
    starts = np.tile(solo.STANDING, (3, 1))
    starts[:, 2] += [0.0, 0.1, 0.2]
    controls = np.repeat(solo.controls(1, 4), 3, axis=0)
    together = engine.rollout(starts, controls).states.copy()
    assert np.array_equal(together[:, 0], starts)
    for start, states in zip(starts, together, strict=True):
        assert np.array_equal(states, engine.rollout(start, controls).states[0])


def test_states_do_not_depend_on_threads_chunks_or_what_ran_before():
    simulated, controls = solo.simulated(), solo.controls(40, 6)
    with NativeEngine(simulated, threads=0) as engine:
        expected = engine.rollout(solo.STANDING, controls).states.copy()
    for options in ({"threads": 1}, {"threads": 2}, {"threads": 2, "chunk": 7}, {"threads": 3, "chunk": 100}):
        with NativeEngine(simulated, **options) as engine:
            engine.rollout(solo.STANDING, solo.controls(40, 6, seed=1))
            assert np.array_equal(engine.rollout(solo.STANDING, controls).states, expected)


def test_a_second_rollout_of_the_same_size_allocates_nothing(engine):
    first = engine.rollout(solo.STANDING, solo.controls(5, 4)).states
    assert engine.rollout(solo.STANDING, solo.controls(5, 4, seed=1)).states is first
    assert engine.rollout(solo.STANDING, solo.controls(5, 3)).states is not first


def planned(substeps):
    """A planner's simulation: few iterations of PGS from a warm start, so that a start forgotten would show."""
    return models.Mujoco(models.load("solo12"), timestep=0.02 / substeps, substeps=substeps)


@pytest.mark.parametrize("substeps", [1, 3])
@pytest.mark.parametrize("shared", [1, 4])
@pytest.mark.parametrize("threads", [0, 2])
def test_steps_that_all_samples_share_are_those_of_each(threads, shared, substeps):
    simulated, controls = planned(substeps), solo.controls(5, 6)
    controls[:, :shared] = controls[0, :shared]
    assert shared_steps(controls) == shared
    start = simulated.state(joints="stand")
    start[2] -= 0.004  # so that feet touch
    with NativeEngine(simulated, threads=threads) as engine:
        engine.rollout(start, solo.controls(5, 6, seed=1))
        rollouts = engine.rollout(start, controls)
        assert len(engine._lead(start, controls).states) == shared
    assert rollouts.failures == 0
    for states, control in zip(rollouts.states, controls, strict=True):
        assert np.array_equal(states, by_hand(simulated.compiled(), start, control, substeps))


def test_a_sample_alone_and_the_last_step_are_not_shared():
    assert shared_steps(solo.controls(1, 6)) == 0
    assert shared_steps(np.zeros((3, 6, 12))) == 5
    assert shared_steps(np.zeros((3, 1, 12))) == 0
    assert shared_steps(np.full((3, 6, 12), np.nan)) == 0


def test_samples_that_start_elsewhere_share_no_step(engine):
    controls, starts = solo.controls(3, 6), np.tile(solo.STANDING, (3, 1))
    controls[:, 0], starts[1, 2] = controls[0, 0], 0.4
    states = engine.rollout(starts, controls).states.copy()
    for i in range(3):
        assert np.array_equal(states[i], engine.rollout(starts[i], controls[i : i + 1]).states[0])


def test_what_was_simulated_is_taken_over_alike_in_c_and_in_numpy(monkeypatch):
    rng = np.random.default_rng(0)
    simulated = rng.normal(size=(9, 6, 1 + 37))
    simulated[:, :, 0] = 0.01 * np.arange(1, 7)
    simulated[1, 3, 5], simulated[2, 3, 5], simulated[3, 5, 30] = np.nan, np.inf, -1.5 * MAX_SPEED
    simulated[4, 4:, 0], simulated[5, 1, 25], simulated[6, 0, 30] = 0.04, np.nan, 1e9
    results = []
    for _ in range(2):
        states = np.zeros((9, 4, 37))
        results.append((take.take(simulated, 2, 19, 0.055, states[:, 1:]), states))
        monkeypatch.setattr(take, "_library", lambda: None)
    (suspects, states), (others, same) = results
    assert suspects.tolist() == others.tolist() == [False, True, True, True, True, True, False, False, False]
    assert np.array_equal(states, same, equal_nan=True)
    assert np.array_equal(states[:, 1:], simulated[:, 1::2, 1:], equal_nan=True)


def test_warm_start_changes_nothing_where_the_solver_converges():
    states = []
    for warm_start in (False, True):
        with NativeEngine(solo.simulated(iterations=100), warm_start=warm_start) as engine:
            states.append(engine.rollout(solo.STANDING, solo.controls(20, 8)).states)
    assert np.abs(states[0] - states[1]).max() < 1e-10
    assert not np.array_equal(*states)


# ---- failures


@pytest.mark.parametrize("step", [0, 2, 5])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_control_that_is_not_finite_fails_its_sample_alone(engine, step, value, capfd):
    controls = solo.controls(5, 6)
    expected = engine.rollout(solo.STANDING, controls).states.copy()
    controls[3, step, 7] = value
    rollouts = engine.rollout(solo.STANDING, controls)
    assert rollouts.failed.tolist() == [False, False, False, True, False]
    assert rollouts.failures == 1
    assert np.isfinite(rollouts.states).all()
    assert np.array_equal(rollouts.states[3, : step + 1], expected[3, : step + 1])
    assert (rollouts.states[3, step + 1 :] == expected[3, step]).all()
    assert np.array_equal(rollouts.states[~rollouts.failed], expected[~rollouts.failed])
    assert capfd.readouterr() == ("", "")


def test_a_diverging_sample_stands_still_at_its_last_good_state(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    simulated = solo.simulated()
    model = simulated.compiled()
    model.dof_armature[6:] = 0.0  # explicit damping of a light joint: unstable at this step
    model.actuator_biasprm[:, 2] = -20.0
    model.actuator_forcelimited[:] = 0
    with NativeEngine(simulated) as engine:
        rollouts = engine.rollout(solo.STANDING, solo.controls(4, 40))
        assert rollouts.failed.all()
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    for states, control in zip(rollouts.states, solo.controls(4, 40), strict=True):
        raw = by_hand(model, solo.STANDING, control)
        with np.errstate(invalid="ignore"):
            bad = ~(np.abs(raw[:, 19:]).max(axis=1) <= MAX_SPEED)
        first = int(np.argmax(bad))
        assert 0 < first < 40
        assert np.array_equal(states[:first], raw[:first])
        assert (states[first:] == raw[first - 1]).all()


@pytest.mark.parametrize("shared", [1, 39])
def test_samples_that_diverge_after_shared_steps_or_in_them_stand_still_alike(shared):
    simulated = solo.simulated()
    model = simulated.compiled()
    model.dof_armature[6:] = 0.0  # unstable, as above
    model.actuator_biasprm[:, 2] = -20.0
    model.actuator_forcelimited[:] = 0
    controls = solo.controls(4, 40)
    controls[:, :shared] = controls[0, :shared]
    with NativeEngine(simulated) as engine:
        together = engine.rollout(solo.STANDING, controls)
        assert len(engine._lead(solo.STANDING, controls).states) == (1 if shared == 1 else 0)
        assert together.failed.all()
        for states, control in zip(together.states, controls, strict=True):
            assert np.array_equal(states, engine.rollout(solo.STANDING, control[None]).states[0])


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e300])
def test_a_shared_control_that_is_not_sound_fails_all(engine, value, capfd):
    controls = solo.controls(4, 6)
    controls[:, 0] = controls[0, 0]
    controls[:, 0, 3] = value
    rollouts = engine.rollout(solo.STANDING, controls)
    assert rollouts.failed.all()
    assert np.isfinite(rollouts.states).all()
    assert capfd.readouterr() == ("", "")


def test_divergence_leaves_no_log_file_and_no_message(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    start = solo.STANDING.copy()
    start[20] = np.nan
    with NativeEngine(solo.simulated()) as engine:
        rollouts = engine.rollout(start, solo.controls(3, 4))
    assert rollouts.failed.all()
    assert np.isfinite(rollouts.states).all()
    assert list(tmp_path.iterdir()) == []
    assert capfd.readouterr() == ("", "")


def test_another_users_warnings_come_back_after_a_rollout():
    heard = []
    mujoco.set_mju_user_warning(heard.append)
    try:
        with NativeEngine(solo.simulated()) as engine:
            assert engine.rollout(np.full(37, np.nan), solo.controls(3, 4)).failures == 3
        assert heard == []
        data = mujoco.MjData(solo.simulated().compiled())
        data.qpos[0] = np.nan
        mujoco.mj_step(solo.simulated().compiled(), data)
    finally:
        mujoco.set_mju_user_warning(None)
    assert len(heard) == 1


def test_mujocos_clock_rests_during_a_rollout_unless_it_is_the_users():
    step = mujoco.mjtTimer.mjTIMER_STEP
    model = solo.simulated().compiled()
    data = mujoco.MjData(model)
    with NativeEngine(solo.simulated(), threads=0) as engine:
        engine.rollout(solo.STANDING, solo.controls(3, 4))
        assert engine._data[0].timer[step].duration == 0.0
        assert mujoco.get_mjcb_time() is None
        mujoco.mj_step(model, data)
        assert data.timer[step].duration > 0.0
        asked = []
        mujoco.set_mjcb_time(lambda: asked.append(1) or 0.0)
        try:
            users = mujoco.get_mjcb_time()
            engine.rollout(solo.STANDING, solo.controls(3, 4))
            assert asked
            assert mujoco.get_mjcb_time() is users
        finally:
            mujoco.set_mjcb_time(None)


def test_a_failure_does_not_reach_the_next_rollout(engine):
    controls = solo.controls(4, 5)
    expected = engine.rollout(solo.STANDING, controls).states.copy()
    assert engine.rollout(np.full(37, np.nan), controls).failures == 4
    rollouts = engine.rollout(solo.STANDING, controls)
    assert rollouts.failures == 0
    assert np.array_equal(rollouts.states, expected)


def test_the_limit_of_speed_is_that_of_one_joint_in_one_step():
    start = solo.STANDING.copy()
    start[2] = 1.0
    start[19] = 0.6 * MAX_SPEED
    with NativeEngine(solo.simulated()) as engine:
        rollouts = engine.rollout(start, solo.controls(3, 6))
    assert np.sum(rollouts.states[:, :, 19:] ** 2, axis=(1, 2)).min() > MAX_SPEED**2
    assert rollouts.failures == 0


# ---- messages


def test_unknown_engines_are_refused_by_name():
    with pytest.raises(
        SamplingError, match="engine is unknown - got 'gpu', expected one of 'auto', 'native', 'simd', 'mjx'"
    ):
        engine_for(solo.simulated(), "gpu")
    with engine_for(solo.simulated(), "native", threads=1) as engine:
        assert engine.threads == 1


def test_shapes_are_checked(engine):
    with pytest.raises(ShapeError, match=r"controls - got shape \(5, 12\), expected \(samples, steps, 12\)"):
        engine.rollout(solo.STANDING, solo.controls(1, 5)[0])
    with pytest.raises(ShapeError, match=r"initial state - got shape \(36,\), expected \(37,\), or \(2, 37\)"):
        engine.rollout(solo.STANDING[1:], solo.controls(2, 5))


@pytest.mark.parametrize("name", ["native", "mjx"])
def test_a_closed_engine_says_so(name):
    engine = engine_for(solo.simulated(), name)
    engine.close()
    engine.close()  # does nothing more
    with pytest.raises(SamplingError, match=rf"{name} engine: rollout after close\(\)"):
        engine.rollout(solo.STANDING, solo.controls(1, 1))


def test_a_second_rollout_at_once_is_refused():
    started, go_on = Event(), Event()

    class Slow(NativeEngine):
        def _simulate(self, x0, controls):
            started.set()
            assert go_on.wait(30.0)
            return super()._simulate(x0, controls)

    with Slow(solo.simulated()) as engine, ThreadPoolExecutor(1) as other:
        first = other.submit(engine.rollout, solo.STANDING, solo.controls(2, 1))
        assert started.wait(30.0)
        with pytest.raises(SamplingError, match="native engine: rollout - got a second one"):
            engine.rollout(solo.STANDING, solo.controls(2, 1))
        go_on.set()
        assert first.result().failures == 0
        assert engine.rollout(solo.STANDING, solo.controls(2, 1)).failures == 0


def test_actuators_with_a_state_of_their_own_are_refused():
    spec = mujoco.MjSpec.from_string(
        "<mujoco><worldbody><body><joint name='j'/><geom size='.1'/></body></worldbody>"
        "<actuator><general joint='j' dyntype='integrator'/></actuator></mujoco>"
    )
    model = spec.compile()
    with pytest.raises(ModelError, match="got 3 numbers, expected 2, positions and velocities alone"):
        NativeEngine(type("Simulated", (), {"substeps": 1, "compiled": lambda self: model})())


def test_the_models_own_options_are_left_alone():
    simulated = solo.simulated()
    before = simulated.compiled().opt.disableflags
    NativeEngine(simulated).close()
    assert simulated.compiled().opt.disableflags == before
