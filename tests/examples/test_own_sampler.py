"""The samplers of ``own_sampler.py``: short, run by every engine and by the command line, and good enough to trot."""

import ast
import importlib.util
import json
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from piaffe import models, ocp, sampling
from piaffe.cli.app import main
from piaffe.models import base, feet, joints
from piaffe.sampling.engines import MjxEngine, engine_for

FILE = Path(__file__).resolve().parents[2] / "examples" / "own_sampler.py"
DT, STEPS = 0.02, 4


@pytest.fixture(scope="module")
def example():
    sys.path.insert(0, str(FILE.parent))  # it builds on another example
    spec = importlib.util.spec_from_file_location("example_own_sampler", FILE)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    yield module
    sys.path.remove(str(FILE.parent))


@pytest.mark.parametrize(("name", "most"), [("CEM", 40), ("Predictive", 20)])
def test_a_sampler_is_short(name, most):
    (own,) = (node for node in ast.parse(FILE.read_text()).body if isinstance(node, ast.ClassDef) and node.name == name)
    assert own.end_lineno - own.lineno + 1 <= most


def test_the_plan_of_cem_is_the_mean_of_the_best(example):
    controller = example.CEM(example.problem(), reward=example.reward, samples=39, engine="native", first_stages=1)
    seen = []
    update = controller.update
    controller.update = lambda xp, samples, *rest: seen.append(samples.copy()) or update(xp, samples, *rest)
    plan = controller.plan(controller.initial, 0.0)
    best = sorted(range(40), key=lambda n: plan.returns[n])[-4:]
    assert plan.effective_samples == pytest.approx(4.0)
    assert set(np.flatnonzero(plan.weights)) == set(best)
    assert controller._plan == pytest.approx(np.mean([seen[0][n] for n in best], axis=0))
    spread = np.std([seen[0][n] for n in best], axis=0)
    assert controller.memory["deviation"] == pytest.approx(np.maximum(spread, 0.05))


def test_the_plan_of_predictive_sampling_is_the_best_sample(example):
    controller = example.Predictive(example.problem(), reward=example.reward, samples=30, engine="native")
    plan = controller.plan(controller.initial, 0.0)
    best = int(np.argmax(plan.returns))
    assert plan.weights[best] == 1.0
    again = controller.engine.rollout(controller.initial, plan.controls[None]).states[0]
    assert again == pytest.approx(plan.states[best], abs=1e-9)


# ---- engines


def problem_of(contact, height):
    """Return a trot that begins at a height above the stand [m]."""
    plant = models.Mujoco(models.load("solo12", rotors=True), contact=contact)
    objective = ocp.Objective(
        ocp.track(base.linear_velocity, weight=1.0), ocp.track(feet.height, weight=20.0),
        ocp.regularize(joints.torque, weight=1e-2), ocp.track(base.orientation, weight=3.0, at="end"),
    )  # fmt: skip
    limits = ocp.Constraints(models.joint_range("HAA", 0.02, scale=0.02))
    start = plant.state(joints="stand")
    start[2] += height
    return ocp.Problem(models.gaits.trot(0.3), plant.over(STEPS * DT, dt=DT), objective, limits, initial=start)


def plans_of(kind, problem, name):
    """Return the plans of two steps, with the contact solver converged, in double precision."""
    controller = kind(problem, samples=24, seed=3, first_stages=2, engine=name, reward=sampling.Reward(scale=10.0))
    compiled = controller.model.compiled()
    compiled.opt.tolerance = compiled.opt.ls_tolerance = 1e-14
    model = SimpleNamespace(compiled=lambda: compiled, substeps=controller.model.substeps)
    controller.engine = MjxEngine(model, precision="double") if name == "mjx" else engine_for(model, name)
    return [controller.plan(problem.initial, k * DT) for k in range(2)]


def agree(kind, problem, first, *others):
    """Compare plans of engines with those of a first one."""
    wanted = plans_of(kind, problem, first)
    assert all(np.std(plan.returns) > 1e-4 for plan in wanted)
    for name in others:
        for want, found in zip(wanted, plans_of(kind, problem, name), strict=True):
            assert found.controls == pytest.approx(want.controls, abs=1e-9)
            assert found.returns == pytest.approx(want.returns, abs=1e-9)
            assert found.weights == pytest.approx(want.weights, abs=1e-9)
            assert found.failed == want.failed == 0


KINDS = ("CEM", "Predictive", "MPPI", "DIAL", "TDCDMPPI")
ON_DEVICE = ("CEM", "Predictive", "TDCDMPPI")  # a compilation takes most of a minute
PLANNING = {"solver": "pgs", "cone": "elliptic", "iterations": 4}
NEWTON = {"solver": "newton", "cone": "pyramidal", "iterations": 50, "line_search": 50}


def kind_of(example, name):
    return getattr(example, name, None) or getattr(sampling, name)


@pytest.mark.parametrize("name", KINDS)
def test_native_and_simd_give_the_same_plan_on_the_ground(example, name):
    agree(kind_of(example, name), problem_of(models.SoftContact(**PLANNING), 0.0), "native", "simd")


@pytest.mark.slow
@pytest.mark.parametrize("name", ON_DEVICE)
def test_native_and_mjx_give_the_same_plan_on_the_ground(example, name):
    pytest.importorskip("mujoco.mjx")
    agree(kind_of(example, name), problem_of(models.SoftContact(**NEWTON), 0.0), "native", "mjx")


@pytest.mark.slow
@pytest.mark.parametrize("name", ON_DEVICE)
@pytest.mark.filterwarnings("ignore:mjx engine. MJX has no PGS solver")
def test_all_three_engines_give_the_same_plan_in_the_air(example, name):
    """Where no foot touches the ground: ``simd`` and ``mjx`` have no contact solver in common."""
    pytest.importorskip("mujoco.mjx")
    agree(kind_of(example, name), problem_of(models.SoftContact(**PLANNING), 0.5), "native", "simd", "mjx")


# ---- in closed loop


def test_the_example_runs(example):
    assert 0.0 <= example.main(steps=10, seeds=1) <= 1.0


@pytest.mark.parametrize("name", ["cem", "predictive"])
def test_the_command_line_runs_both(name, capsys):
    code = main(["mppi", str(FILE), "--controller", name, "--steps", "10", "--json"])
    found = json.loads(capsys.readouterr().out)
    assert (found["controller"], found["episodes"][0]["steps"]) == (name, 10)
    assert code == (0 if found["successes"] else 1)


@pytest.mark.slow
def test_solo12_trots_with_both(example):
    assert example.main() == 1.0
