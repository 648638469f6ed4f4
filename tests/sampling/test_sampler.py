"""A sampler of one's own: three methods, pure functions of arrays; what they do wrong is told by name."""

from pathlib import Path

import numpy as np
import pytest

from piaffe import models, ocp, sampling
from piaffe.errors import SamplingError
from piaffe.models import base
from piaffe.sampling.controllers.contract import returned, sampled, settled, unexplained, updated

CHECKOUT = Path(__file__).resolve().parents[2]
DT, STEPS, SAMPLES, NODES, NU = 0.02, 3, 8, 5, 12


@pytest.fixture(scope="module")
def problem():
    simulated = models.Mujoco(models.load("solo12"))
    objective = ocp.Objective(ocp.track(base.linear_velocity, weight=2.0), ocp.track(base.orientation, weight=1.0))
    limits = ocp.Constraints(models.joint_range("HAA", 0.05, scale=0.05))
    return ocp.Problem(
        models.gaits.trot(speed=0.3), simulated.over(STEPS * DT, dt=DT), objective, limits, initial=simulated.state()
    )


class Plain(sampling.Sampler):
    """Takes the mean of all samples, and counts its stages."""

    def initial_memory(self):
        return {"stages": 0.0, "mean": np.zeros(3)}

    def sample(self, xp, plan, noise, stage, memory):
        return plan + 0.1 * noise

    def returns(self, xp, rolled, memory):
        return rolled.states[:, -1, 0], {**memory, "mean": rolled.states[:, -1, :3].mean(axis=0)}

    def update(self, xp, samples, returns, memory):
        weights = xp.ones(len(returns)) / len(returns)
        return samples.mean(axis=0), weights, {**memory, "stages": memory["stages"] + 1.0}


def plan_of(kind, problem, **options):
    return kind(problem, samples=SAMPLES, engine="native", threads=1, **options).plan(problem.initial, 0.0)


def test_the_three_methods_make_the_plan(problem):
    controller = Plain(problem, samples=SAMPLES, engine="native", threads=1, first_stages=2)
    seen = []
    update = controller.update
    controller.update = lambda xp, samples, *rest: seen.append(samples.copy()) or update(xp, samples, *rest)
    plan = controller.plan(problem.initial, 0.0)
    assert plan.controls == pytest.approx(controller._controls(seen[-1].mean(axis=0)[None])[0])
    assert plan.returns == pytest.approx(plan.states[:, -1, 0])
    assert plan.weights == pytest.approx(1 / 9)
    assert plan.effective_samples == pytest.approx(9.0)
    assert len(seen) == 2
    assert seen[1][-1] == pytest.approx(seen[0].mean(axis=0))  # the plan so far is the last sample


def test_memory_goes_from_stage_to_stage_and_from_plan_to_plan_until_a_reset(problem):
    controller = Plain(problem, samples=SAMPLES, engine="native", threads=1, first_stages=3)
    for k in range(2):
        plan = controller.plan(problem.initial, k * DT)
    assert controller.memory["stages"] == 4.0
    assert controller.memory["mean"] == pytest.approx(plan.states[:, -1, :3].mean(axis=0))
    controller.reset()
    assert controller.memory["stages"] == 0.0


def test_a_plan_that_fails_leaves_the_memory_as_it_was(problem):
    class Once(Plain):
        def update(self, xp, samples, returns, memory):
            plan, weights, memory = super().update(xp, samples, returns, memory)
            return plan * (np.nan if memory["stages"] > 1 else 1.0), weights, memory

    controller = Once(problem, samples=SAMPLES, engine="native", threads=1)
    before = controller.plan(problem.initial, 0.0)
    with pytest.raises(SamplingError, match="'Once': update, plan not finite"):
        controller.plan(problem.initial, DT)
    assert controller.memory["stages"] == 1.0
    assert controller._controls(controller._plan[None])[0] == pytest.approx(before.controls)


def test_samples_are_clipped_and_begin_with_the_control_that_is_being_applied(problem):
    class Wild(Plain):
        def sample(self, xp, plan, noise, stage, memory):
            return np.full_like(noise, 7.0)

    controller = Wild(problem, samples=SAMPLES, engine="native", threads=1)
    plan, noise = np.full((NODES, NU), 0.25), np.zeros((SAMPLES, NODES, NU))
    found = sampled(controller, np, plan, noise, None, {})
    assert found.shape == (SAMPLES + 1, NODES, NU)
    assert np.all(found[:, 0] == 0.25)
    assert np.all(found[:-1, 1:] == 1.0)
    assert np.array_equal(found[-1], plan)


def test_a_class_is_called_by_its_name_unless_it_has_a_title():
    class Own(sampling.MPPI):
        pass

    class Titled(sampling.MPPI):
        title = "my own"

    assert (Own.title, Titled.title, sampling.MPPI.title) == ("Own", "my own", "MPPI")


def test_every_controller_is_public_and_on_the_api_page():
    page = (CHECKOUT / "docs" / "api" / "sampling.md").read_text()
    for kind in sampling.CONTROLLERS.values():
        assert getattr(sampling, kind.__name__) is kind
        assert f"::: piaffe.sampling.{kind.__name__}\n" in page
    titles = [kind.title for kind in sampling.CONTROLLERS.values()]
    assert titles == ["TD-CD-MPPI", "DIAL-MPC", "MPPI"]


def test_the_old_name_of_the_titles_says_the_new_one():
    with pytest.raises(ImportError, match=r"'TITLES' was renamed - .*piaffe.sampling.CONTROLLERS\[name\].title"):
        sampling.TITLES  # noqa: B018  # the error is what is looked at


def test_a_sampler_that_uses_values_is_told_them(problem):
    class Valued(Plain):
        uses_value = True

        def returns(self, xp, rolled, memory):
            return rolled.value, memory

    plan = plan_of(Valued, problem, value=lambda states, k, nodes: k + states[:, 2])
    assert plan.returns == pytest.approx(STEPS + 1 + plan.states[:, -1, 2])
    with pytest.raises(SamplingError, match="controller 'Plain': uses no value - got 'some.value', expected None"):
        Plain(problem, value="some.value")


# ---- what is told by name


@pytest.mark.parametrize("name", ["sample", "returns", "update"])
def test_a_missing_method_is_named(problem, name):
    own = {method: getattr(Plain, method) for method in ("sample", "returns", "update") if method != name}
    kind = type("Partial", (sampling.Sampler,), own)
    with pytest.raises(SamplingError, match=f"'Partial': has no method '{name}' - got a class without it.*def {name}"):
        kind(problem)


def changed(method, change):
    """Return a sampler whose method returns something else."""

    def other(self, xp, *given):
        return change(getattr(Plain, method)(self, xp, *given))

    return type("Odd", (Plain,), {method: other})


WRONG = [
    ("sample", lambda s: s[:, 1:], "samples have the wrong shape - got (8, 4, 12), expected (8, 5, 12)"),
    ("sample", lambda s: None, "samples have the wrong shape - got NoneType"),
    ("sample", lambda s: s * np.nan, "sample, samples not finite - got NaN or infinity in 480 of 480"),
    ("returns", lambda r: (r[0][1:], r[1]), "returns have the wrong shape - got (8,), expected (9,)"),
    ("returns", lambda r: r[0], "returns has a wrong result - got ndarray, expected 2 values"),
    ("returns", lambda r: (r[0] * np.nan, r[1]), "returns are not finite - got NaN or infinity for 9 of 9"),
    ("returns", lambda r: (r[0], {}), "memory has other names - got [], expected ['mean', 'stages']"),
    ("returns", lambda r: (r[0], None), "memory has other names - got NoneType, expected ['mean', 'stages']"),
    ("update", lambda u: (u[0][:, :1], *u[1:]), "plan have the wrong shape - got (5, 1), expected (5, 12)"),
    ("update", lambda u: (*u, 0), "update has a wrong result - got 4 values, expected 3 values"),
    ("update", lambda u: (u[0] / 0.0 * 0.0, *u[1:]), "update, plan not finite - got NaN or infinity in"),
    ("update", lambda u: (u[0], 2 * u[1], u[2]), "weights are no shares - got the sum 2"),
    ("update", lambda u: (u[0], u[1] * np.nan, u[2]), "weights are no shares - got the sum nan"),
    ("update", lambda u: (u[0], u[1][1:], u[2]), "weights have the wrong shape - got (8,), expected (9,)"),
    ("update", lambda u: (*u[:2], {**u[2], "mean": np.zeros(4)}), "memory 'mean' have the wrong shape - got (4,)"),
    ("update", lambda u: (*u[:2], {**u[2], "stages": np.nan}), "memory 'stages' not finite"),
]


@pytest.mark.parametrize(("method", "change", "message"), WRONG)
@pytest.mark.filterwarnings("ignore:(invalid value|divide by zero):RuntimeWarning")
def test_a_wrong_result_is_told_by_name(problem, method, change, message):
    with pytest.raises(SamplingError) as raised:
        plan_of(changed(method, change), problem)
    assert str(raised.value).startswith("controller 'Odd': ")
    assert message in str(raised.value)


def test_returns_of_rollouts_that_failed_may_be_anything(problem):
    controller = changed("returns", lambda r: (np.where(np.arange(9) == 3, np.nan, r[0]), r[1]))(
        problem, samples=SAMPLES, engine="native", threads=1
    )
    rollout = controller.engine.rollout

    def broken(*given):
        rolled = rollout(*given)
        rolled.failed[3] = True
        return rolled

    controller.engine.rollout = broken
    plan = controller.plan(problem.initial, 0.0)
    assert plan.failed == 1
    assert plan.returns[3] == plan.returns.min()


# ---- for JAX as for NumPy


@pytest.mark.parametrize("kind", [Plain, sampling.MPPI, sampling.DIAL, sampling.TDCDMPPI])
def test_the_methods_give_the_same_on_jax(problem, kind):
    jax = pytest.importorskip("jax")
    controller = kind(problem, samples=SAMPLES, engine="native", threads=1)
    random = np.random.default_rng(0)
    noise, plan = random.standard_normal((SAMPLES, NODES, NU)), random.uniform(-1, 1, (NODES, NU))
    n = SAMPLES + 1
    rolled = sampling.Rolled(
        k=0,
        states=random.standard_normal((n, STEPS + 2, 37)),
        controls=random.standard_normal((n, STEPS + 1, NU)),
        cost=random.uniform(size=(n, STEPS + 1)),
        last=random.uniform(size=n),
        value=random.uniform(size=n) if kind.uses_value else None,
        violation=np.maximum(random.standard_normal((len(controller.constraints), n, STEPS + 1)), 0.0),
        failed=np.arange(n) == 2,
    )
    memory = {name: np.asarray(kept) for name, kept in controller.initial_memory().items()}

    def stage(xp, plan, noise, rolled, memory):
        for index in range(2):
            samples = sampled(controller, xp, plan, noise, sampling.Stage(index, 2, 0.3), memory)
            found, memory = returned(controller, xp, rolled, memory)
            returns, failed = settled(xp, found, rolled.failed)
            plan, weights, memory = updated(controller, xp, samples, returns, memory)
        return plan, weights, memory, returns, failed, unexplained(xp, found, rolled)

    wanted = stage(np, plan, noise, rolled, memory)
    with jax.enable_x64(True):
        found = jax.jit(lambda *given: stage(jax.numpy, *given))(plan, noise, rolled, memory)
    for want, got in zip(jax.tree.leaves(wanted), jax.tree.leaves(found), strict=True):
        assert np.asarray(got) == pytest.approx(np.asarray(want), rel=1e-12, abs=1e-14)
    assert wanted[3][2] == wanted[3].min()
