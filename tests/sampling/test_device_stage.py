"""A stage compiled as one function gives the plan that the same stage gives in NumPy, on MuJoCo's own roll-outs."""

import json
from collections import defaultdict

import numpy as np
import pytest

from piaffe import models, ocp
from piaffe.errors import SamplingError
from piaffe.models import base, feet, joints
from piaffe.sampling import MPPI, TDCDMPPI
from piaffe.sampling.controllers.device_stage import DeviceStage
from piaffe.sampling.controllers.host_stage import HostStage
from piaffe.sampling.controllers.noise import deviations
from piaffe.sampling.controllers.stage import Stage
from piaffe.sampling.engines.mjx import MjxEngine
from piaffe.sampling.translate import import_jax
from piaffe.sampling.value import numbers_of, traced_value
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


def stages_of(controller, stage):
    """Return two stages of a plan, from equal noise, the second one later in the motion."""
    found, plan, memory = [], np.zeros((5, 12)), controller.initial_memory()
    for i, k in enumerate((0, 7)):
        noise = 0.2 * np.random.default_rng(i).standard_normal((SAMPLES, 5, 12))
        noise[:, 0] = 0.0
        own, numbers = (
            Stage(i, 2, deviations(controller.options, i, 2)[:, None]),
            controller.nodes.running(k, STEPS + 1),
        )
        found.append(stage(controller.initial, plan, noise, own, memory, k, numbers, defaultdict(float)))
        plan, memory = found[-1].plan, found[-1].memory
    return found


def in_double(value, controller):
    """Return a value that computes in double precision, as the device stage does in this test."""
    jax, traced = import_jax(), traced_value(value, controller.nodes.mode)

    def of(states, k, nodes):
        with jax.enable_x64(True):
            return np.array(traced(*(jax.numpy.asarray(each, float) for each in (states, numbers_of(nodes, k)))))

    return of


@pytest.mark.slow
@pytest.mark.parametrize("kind", [MPPI, TDCDMPPI])
def test_a_stage_on_the_device_is_the_stage_in_numpy(problem, kind):
    value = {"value": some_value(problem)} if kind is TDCDMPPI else {}
    host, device = (kind(problem, engine=name, samples=SAMPLES, **value) for name in ("native", "mjx"))
    device.engine = MjxEngine(device.model, precision="double")
    if value:
        host.value = in_double(host.value, host)
    both = zip(stages_of(host, HostStage(host)), stages_of(device, DeviceStage(device)), strict=True)
    for wanted, found in both:
        assert np.std(wanted.returns) > 1e-3
        assert not found.rolled.failed.any()
        for name in ("plan", "returns", "weights"):
            assert getattr(found, name) == pytest.approx(getattr(wanted, name), abs=1e-9)
        for name in wanted.memory:
            assert np.asarray(found.memory[name]) == pytest.approx(wanted.memory[name], abs=1e-9)
        if value:
            assert np.asarray(found.memory["maxima"]).max() > host.options.violation_floor


def test_a_value_on_the_device_is_the_value(problem):
    controller, value = MPPI(problem, samples=1), some_value(problem)
    states = controller.initial + 0.05 * np.random.default_rng(3).standard_normal((20, 37))
    states[:, 3:7] /= np.linalg.norm(states[:, 3:7], axis=1, keepdims=True)
    states[0, 2] = 0.1  # it lies
    wanted = value(states, 7, controller.nodes)
    assert wanted[0] == 0.0
    assert np.median(wanted) > 0.1
    assert in_double(value, controller)(states, 7, controller.nodes) == pytest.approx(wanted, rel=1e-5)  # of single


def test_a_native_controller_has_no_device_stage(problem):
    with pytest.raises(SamplingError, match="device stage: engine - got NativeEngine, expected MjxEngine"):
        DeviceStage(MPPI(problem, engine="native", samples=4))


def test_values_of_unknown_make_are_refused(problem):
    controller = TDCDMPPI(problem, engine="mjx", samples=4, value=lambda states, k, nodes: np.ones(len(states)))
    with pytest.raises(SamplingError, match="device stage: value cannot be compiled - got function"):
        DeviceStage(controller)


class Upwards(MPPI):
    """Returns how high the base is at the end."""

    def returns(self, xp, rolled, memory):
        return rolled.states[:, -1, 2], memory


def test_a_plan_on_the_device_is_made_from_the_returns_of_its_class(problem):
    controller = Upwards(problem, samples=SAMPLES, engine="mjx", first_stages=1)
    plan = controller.plan(problem.initial, 0.0)
    action = problem.schedule.segments[0].model.action
    share = np.clip(controller.spline.to_controls @ controller._plan, -1.0, 1.0)
    assert plan.returns == pytest.approx(plan.states[:, -1, 2])
    assert np.argmax(plan.weights) == np.argmax(plan.states[:, -1, 2])
    assert plan.controls == pytest.approx(action.centre + action.half_range * share, abs=1e-6)
    assert plan.action == pytest.approx(plan.controls[0])


class Rooted(MPPI):
    """Takes a root of negative numbers."""

    def returns(self, xp, rolled, memory):
        return xp.sqrt(-rolled.states[:, -1, 2]), memory


@pytest.mark.slow
def test_nan_on_the_device_is_told_by_name(problem):
    with pytest.raises(SamplingError, match="'Rooted': returns are not finite - got NaN or infinity for 13 of 13"):
        Rooted(problem, samples=SAMPLES, engine="mjx", first_stages=1).plan(problem.initial, 0.0)


class Sorted(MPPI):
    """Tries what NumPy makes of the noise."""

    def sample(self, xp, plan, noise, stage, memory):
        return plan + np.sort(noise, axis=0)


def test_what_jax_cannot_compile_is_told_by_name(problem):
    with pytest.raises(SamplingError, match="'Sorted': sample cannot be compiled by JAX - got .*; use xp.where"):
        Sorted(problem, samples=SAMPLES, engine="mjx").plan(problem.initial, 0.0)
