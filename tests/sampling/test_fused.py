"""A stage compiled as one function gives the plan that the same stage gives in NumPy, on MuJoCo's own rollouts."""

import json

import numpy as np
import pytest

from piaffe import models, ocp
from piaffe.errors import SamplingError
from piaffe.models import base, feet, joints
from piaffe.sampling import MPPI, TDCDMPPI
from piaffe.sampling.controllers.device_stage import DeviceStage
from piaffe.sampling.controllers.mppi import Rolled, softmax
from piaffe.sampling.engines.mjx import MjxEngine
from piaffe.sampling.value.fingerprint import fingerprint
from piaffe.sampling.value.inputs import ValueInputs
from piaffe.sampling.value.network import Layer, Network
from piaffe.sampling.value.store import Value

pytest.importorskip("mujoco.mjx")

STEPS, SAMPLES = 4, 12


@pytest.fixture(scope="module")
def problem():
    robot = models.load("solo12")
    plant = models.Mujoco(robot, contact=models.SoftContact(solver="newton", iterations=20, cone="pyramidal"))
    objective = ocp.Objective(
        ocp.track(base.linear_velocity, weight=1.0),
        ocp.track(feet.height, weight=20.0),
        ocp.regularize(joints.torque, weight=1e-2),
        ocp.track(base.orientation, weight=3.0, at="end"),
    )
    limits = ocp.Constraints(models.joint_range("HAA", 0.02, scale=0.02))
    trot = models.gaits.trot(0.3)
    return ocp.Problem(trot, plant.over(0.02 * STEPS, dt=0.02), objective, limits, initial=plant.state(joints="stand"))


@pytest.fixture(scope="module")
def samples():
    nodes = 0.2 * np.random.default_rng(0).standard_normal((SAMPLES, 5, 12))
    nodes[:, 0] = nodes[0, 0]
    return np.clip(nodes, -1, 1)


def some_value(problem):
    """A network with random weights, of the usual inputs."""
    controller, rng = TDCDMPPI(problem, samples=1), np.random.default_rng(1)
    inputs = ValueInputs.standard(controller.nodes)
    made_for = json.loads(json.dumps(fingerprint(controller.nodes, controller.reward, controller.options, inputs)))
    m = sum(inputs.spec(controller.nodes.mode).values())

    def single(*shape):
        return rng.standard_normal(shape).astype(np.float32)

    layers = (
        Layer(single(m, 7) / 3, single(7), 1 + single(7), single(7)),
        Layer(single(7, 5), single(5), *[single(5)] * 2),
    )
    network = Network(single(m), 1 + single(m) ** 2, layers, single(5), 0.3)
    return Value(network, inputs, made_for, fall={"tilt": 0.5, "height": 0.15})


def in_numpy(controller, start, samples, k):
    """Return plan and returns of a stage by the controller's own parts."""
    action = controller.model.action
    controls = np.clip(controller.spline.to_controls @ samples, -1, 1)
    controls = 0.5 * (action.upper + action.lower) + 0.5 * (action.upper - action.lower) * controls
    rollouts = controller.engine.rollout(start, controls)
    cost, violation = controller.score(rollouts.states[:, :-1], controls, controller.nodes.running(k, STEPS + 1))
    end = controller.nodes.end(k + STEPS + 1)
    last, _ = controller.evaluator.terminal(
        rollouts.states[:, -1], end.p[0], end.weight[0], end.g_mask[0], end.h_mask[0]
    )
    rolled = Rolled(k, rollouts.states, cost, last, violation, rollouts.failed)
    returns = controller.returns(rolled)
    return np.einsum("n,njc->jc", softmax(returns, controller.options.temperature), samples), returns


@pytest.mark.slow
@pytest.mark.parametrize("kind", [MPPI, TDCDMPPI])
def test_a_fused_stage_is_the_stage(problem, samples, kind):
    value = {"value": some_value(problem)} if kind is TDCDMPPI else {}
    native, other = (kind(problem, engine=name, samples=SAMPLES, **value) for name in ("native", "mjx"))
    other.engine = MjxEngine(other.model, precision="double")
    stage, start, maxima = DeviceStage(other), problem.initial, None
    for k in (0, 7):
        plan, returns = in_numpy(native, start, samples, k)
        staged = stage(start, samples, k, other.nodes.running(k, STEPS + 1), maxima)
        maxima = np.asarray(staged.maxima) if kind is TDCDMPPI else None
        assert np.std(returns) > 1e-3
        assert not np.asarray(staged.failed).any()
        assert np.asarray(staged.returns) == pytest.approx(returns, rel=1e-6)
        assert np.asarray(staged.nodes) == pytest.approx(plan, abs=1e-6)
        assert np.asarray(staged.weights).sum() == pytest.approx(1.0)
        if kind is TDCDMPPI:
            assert maxima.max() > native.options.violation_floor
            assert np.maximum(maxima, native.options.violation_floor) == pytest.approx(native.discount.maxima, rel=1e-9)


def test_a_native_controller_has_no_fused_stage(problem):
    with pytest.raises(SamplingError, match="engine - got NativeEngine, expected MjxEngine"):
        DeviceStage(MPPI(problem, samples=4))


def test_values_of_unknown_make_are_refused(problem):
    controller = TDCDMPPI(problem, engine="mjx", samples=4, value=lambda states, k, nodes: np.ones(len(states)))
    with pytest.raises(SamplingError, match="value cannot be compiled - got function"):
        DeviceStage(controller)


def test_plan_on_the_device_tells_the_controls_of_its_nodes(problem):
    controller = MPPI(problem, samples=SAMPLES, engine="mjx", first_stages=1)
    plan = controller.plan(problem.initial, 0.0)
    action = problem.schedule.segments[0].model.action
    share = np.clip(controller.spline.to_controls @ controller._plan, -1.0, 1.0)
    assert plan.controls == pytest.approx(action.centre + action.half_range * share, abs=1e-6)
    assert plan.action == pytest.approx(plan.controls[0])
