"""MJX: the native engine's states to rounding, and sentences about what it has not."""

import subprocess
import sys
import warnings

import jax
import mujoco
import numpy as np
import pytest

from piaffe.errors import SamplingError
from piaffe.sampling.engines import engine_for
from piaffe.sampling.engines.engine import MAX_SPEED
from piaffe.sampling.engines.mjx import MjxEngine
from piaffe.sampling.engines.mjx_model import MjxWarning
from piaffe.sampling.engines.native import NativeEngine

from . import solo

pytest.importorskip("mujoco.mjx")

N, STEPS = 6, 9


def in_gait(n, steps, seed=0):
    """Joint targets that bend smoothly through their range, (n, steps, 12)."""
    bends = np.random.default_rng(seed).uniform(-1, 1, (n, 2, 12))
    share = np.linspace(0, 1, steps)[:, None]
    return solo.CROUCH + solo.RANGE * (bends[:, :1] * (1 - share) + bends[:, 1:] * share)


@pytest.fixture(scope="module")
def double():
    return MjxEngine(solo.simulated(), precision="double")


def native(x0, controls, **options):
    with NativeEngine(solo.simulated(**options)) as engine:
        return engine.rollout(x0, controls)


@pytest.mark.slow
def test_double_precision_agrees_with_native_to_rounding(double):
    expected, got = native(solo.STANDING, in_gait(N, STEPS)), double.rollout(solo.STANDING, in_gait(N, STEPS))
    assert expected.failures == got.failures == 0
    assert got.states.shape == (N, STEPS + 1, 37)
    assert got.states.dtype == np.float64
    assert got.states[:, -1, 21] == pytest.approx(0.0, abs=2.0)  # it stands: in free fall it would be elsewhere
    assert np.abs(got.states - expected.states).max() < 1e-11


@pytest.mark.slow
def test_each_sample_may_start_elsewhere(double):
    starts = np.tile(solo.STANDING, (N, 1))
    starts[:, 2] += np.linspace(0, 0.1, N)
    expected, got = native(starts, in_gait(N, STEPS)), double.rollout(starts, in_gait(N, STEPS))
    assert np.abs(got.states - expected.states).max() < 1e-11


@pytest.mark.slow
@pytest.mark.parametrize("step", [0, 4, STEPS - 1])
def test_failed_samples_are_what_they_are_natively(double, step):
    controls, starts = in_gait(N, STEPS), np.tile(solo.STANDING, (N, 1))
    controls[1, step, 3] = np.nan
    controls[2, step, 3] = np.inf
    starts[4, 25] = np.nan
    starts[5, 20] = 2 * MAX_SPEED
    expected, got = native(starts, controls), double.rollout(starts, controls)
    assert got.failed.tolist() == expected.failed.tolist() == [False, True, True, False, True, True]
    assert np.abs(got.states - expected.states).max() < 1e-11


@pytest.mark.slow
def test_single_precision_agrees_to_a_few_of_its_digits():
    expected = native(solo.STANDING, in_gait(N, STEPS)).states
    engine = MjxEngine(solo.simulated(), precision="single")
    got = engine.rollout(solo.STANDING, in_gait(N, STEPS)).states
    assert 1e-9 < np.abs(got - expected)[:, :, :19].max() < 1e-5
    assert np.abs(got - expected)[:, :, 19:].max() < 1e-3


@pytest.mark.slow
def test_a_control_is_held_over_substeps():
    options = {"substeps": 4, "dt": 0.005}
    engine = MjxEngine(solo.simulated(**options), precision="double")
    expected = native(solo.STANDING, in_gait(3, 4), **options)
    assert np.abs(engine.rollout(solo.STANDING, in_gait(3, 4)).states - expected.states).max() < 1e-11


def test_products_of_matrices_have_all_digits_on_gpus_too(double):
    with double.computing():
        assert jax.config.jax_default_matmul_precision == "highest"


# ---- what MJX has not


def test_pgs_becomes_newton_with_a_warning():
    simulated = solo.simulated(solver=mujoco.mjtSolver.mjSOL_PGS)
    with pytest.warns(MjxWarning, match="MJX has no PGS solver, Newton takes its place with 10 iterations") as caught:
        MjxEngine(simulated)
    assert caught[0].filename == __file__
    assert simulated.compiled().opt.solver == mujoco.mjtSolver.mjSOL_PGS


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"integrator": mujoco.mjtIntegrator.mjINT_IMPLICIT}, "option integrator - got 'implicit', expected .* Euler"),
        ({"noslip_iterations": 3}, "option noslip_iterations - got 3, expected 0"),
    ],
)
def test_options_that_mjx_has_not_are_named(options, message):
    with pytest.raises(SamplingError, match=message):
        MjxEngine(solo.simulated(**options))


@pytest.mark.parametrize(
    "options",
    [{"cone": mujoco.mjtCone.mjCONE_ELLIPTIC}, {"integrator": mujoco.mjtIntegrator.mjINT_IMPLICITFAST}],
    ids=["elliptic cone", "implicitfast"],
)
def test_options_that_mjx_has_are_taken_silently(options):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        MjxEngine(solo.simulated(**options))


def test_collisions_that_mjx_has_not_are_named():
    spec = mujoco.MjSpec.from_string(
        "<mujoco><worldbody><geom type='box' size='1 1 .1'/><body pos='0 0 1'><freejoint/>"
        "<geom type='cylinder' size='.1 .1'/></body></worldbody></mujoco>"
    )
    model = spec.compile()
    with pytest.raises(SamplingError, match=r"mjGEOM_CYLINDER.*mjGEOM_BOX.* collisions not implemented.*native"):
        MjxEngine(type("Simulated", (), {"substeps": 1, "compiled": lambda self: model})())


def test_unknown_precision_is_refused():
    with pytest.raises(SamplingError, match="precision is unknown - got 'half', expected 'single' or 'double'"):
        engine_for(solo.simulated(), "mjx", precision="half")


def test_jax_is_imported_when_an_engine_of_it_is_made_and_not_before():
    code = "import sys, piaffe.sampling.engines; sys.exit('jax' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
