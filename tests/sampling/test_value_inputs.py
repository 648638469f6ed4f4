from typing import Any

import numpy as np
import pytest

from piaffe import models, ocp
from piaffe.errors import ProblemError, UnknownNameError
from piaffe.models import base
from piaffe.ocp import rotation
from piaffe.ocp.compiler.nodes import Nodes
from piaffe.sampling.value.inputs import STANDARD, Feature, ValueInputs, clock, targets

from .value_problem import trot_problem


@pytest.fixture(scope="module")
def nodes() -> Nodes:
    return Nodes(trot_problem())


def states_of(nodes: Nodes, count: int = 20) -> np.ndarray:
    rng = np.random.default_rng(0)
    states = nodes.problem.initial + 0.2 * rng.standard_normal((count, nodes.model.state.nx))
    return nodes.model.state.np_normalise(states)


def columns(nodes: Nodes, states: np.ndarray, k: int = 60, inputs: ValueInputs | None = None) -> dict[str, np.ndarray]:
    inputs = inputs or ValueInputs()
    values = inputs.bind(nodes, "numpy")(states, k)
    found, start = {}, 0
    for name, size in inputs.spec(nodes.mode).items():
        found[name] = values[:, start : start + size].copy()
        start += size
    assert start == values.shape[1]
    return found


def test_standard_inputs_are_49_numbers(nodes: Nodes) -> None:
    spec = ValueInputs.standard(nodes).spec(nodes.mode)
    assert tuple(spec) == STANDARD
    assert sum(spec.values()) == 49
    labels = ValueInputs().labels(nodes.mode)
    assert len(labels) == 49
    assert labels[:4] == ("ground normal 0", "ground normal 1", "ground normal 2", "yaw error 0")
    assert "base height" in labels


def test_inputs_are_those_of_their_names(nodes: Nodes) -> None:
    states, k = states_of(nodes), 61
    seen = columns(nodes, states, k)
    axes = rotation.np_matrix(states[:, 3:7])
    yaw = np.arctan2(axes[:, 1, 0], axes[:, 0, 0])
    np.testing.assert_allclose(seen["ground normal"], axes[:, 2, :])
    np.testing.assert_allclose(seen["yaw error"], np.column_stack([np.cos(yaw), np.sin(yaw)]), atol=1e-8)
    np.testing.assert_allclose(seen["linear velocity"], np.einsum("nij,ni->nj", axes, states[:, 19:22]))
    np.testing.assert_allclose(seen["angular velocity"], states[:, 22:25])
    np.testing.assert_allclose(seen["base height"][:, 0], nodes.model.height_above_terrain(states))
    np.testing.assert_allclose(seen["joint positions"], states[:, 7:19])
    np.testing.assert_allclose(seen["joint velocities"], states[:, 25:])
    np.testing.assert_allclose(seen["command"], np.tile([0.3, 0.0, 0.0], (20, 1)), atol=1e-9)
    contact = nodes.running(k, 1).p[0][nodes.mode.layout.slots["contact"]]
    np.testing.assert_array_equal(seen["contact"], np.tile(contact, (20, 1)))


def test_inputs_do_not_tell_where_on_the_map_the_robot_is(nodes: Nodes) -> None:
    states = states_of(nodes)
    moved = states + np.r_[5.0, -3.0, np.zeros(35)]
    for name, values in columns(nodes, states).items():
        np.testing.assert_allclose(columns(nodes, moved)[name], values, atol=1e-9, err_msg=name)


def test_inputs_are_the_same_on_ground_of_any_level(nodes: Nodes) -> None:
    states = states_of(nodes)
    higher = Nodes(trot_problem(terrain=models.terrain.flat(0.7)))
    raised = states + np.r_[0.0, 0.0, 0.7, np.zeros(34)]
    for name, values in columns(nodes, states).items():
        np.testing.assert_allclose(columns(higher, raised)[name], values, atol=1e-9, err_msg=name)


def test_inputs_of_a_robot_that_leans_with_the_slope_are_those_on_flat_ground(nodes: Nodes) -> None:
    angle = 0.2
    sloping = Nodes(trot_problem(terrain=models.terrain.incline(angle, start=-np.inf)))
    lean = rotation.np_from_rpy(np.array([0.0, -angle, 0.0]))
    flat, leaning = nodes.problem.initial.copy(), nodes.problem.initial.copy()
    leaning[3:7] = rotation.np_multiply(lean, flat[3:7])
    seen, expected = columns(sloping, leaning[None]), columns(nodes, flat[None])
    for name in ("ground normal", "yaw error", "joint positions", "command"):
        np.testing.assert_allclose(seen[name], expected[name], atol=1e-3, err_msg=name)


def test_position_error_is_seen_when_the_objective_asks_for_a_place() -> None:
    height_only = Nodes(trot_problem(place={"z": 10.0}))
    place = Nodes(trot_problem(place=10.0))
    assert "position error" not in ValueInputs.standard(height_only).spec(height_only.mode)
    inputs = ValueInputs.standard(place)
    assert inputs.spec(place.mode)["position error"] == 2
    k = 80
    state = place.problem.initial.copy()
    state[:2] = np.asarray(place.sample(k)[base.position])[:2] + np.array([0.1, -0.2])
    seen = columns(place, state[None], k, inputs)
    np.testing.assert_allclose(seen["position error"], [[0.1, -0.2]], atol=1e-9)


def test_errors_and_commands_are_in_the_axes_of_the_paths_heading() -> None:
    turned = trot_problem(place=10.0)
    yaw = 0.9
    start = turned.initial.copy()
    start[3:7] = rotation.np_from_rpy(np.array([0.0, 0.0, yaw]))
    nodes = Nodes(turned.with_initial(start))
    k = 75
    state = start.copy()
    ahead, left = np.array([np.cos(yaw), np.sin(yaw)]), np.array([-np.sin(yaw), np.cos(yaw)])
    state[:2] = np.asarray(nodes.sample(k)[base.position])[:2] + 0.1 * ahead - 0.2 * left
    seen = columns(nodes, state[None], k, ValueInputs.standard(nodes))
    np.testing.assert_allclose(seen["position error"], [[0.1, -0.2]], atol=1e-9)
    np.testing.assert_allclose(seen["yaw error"], [[1.0, 0.0]], atol=1e-8)
    np.testing.assert_allclose(seen["command"], [[0.3, 0.0, 0.0]], atol=1e-9)


def test_clock_turns_once_per_cycle_and_runs_up_to_its_start(nodes: Nodes) -> None:
    turns = np.array([clock(nodes, k) for k in range(60)]) / (2 * np.pi)
    intro, period = 0.05, 0.5
    expected = (np.arange(60) * 0.02 - intro) / period
    np.testing.assert_allclose(np.exp(2j * np.pi * turns), np.exp(2j * np.pi * expected), atol=1e-9)
    assert turns[0] == pytest.approx(-0.1)
    np.testing.assert_allclose(targets(nodes, 40)[5:7], [np.cos(clock(nodes, 40)), np.sin(clock(nodes, 40))])


def test_clock_of_a_motion_without_a_cycle_is_half_a_turn() -> None:
    problem = trot_problem()
    stance = models.stance("FL FR HL HR")
    motion = ocp.Motion(ocp.Phase("one", stance, 0.2), ocp.Phase("two", stance, 0.2, target={"rpy": (0, 0, 0)}))
    once = ocp.Problem(
        motion,
        problem.schedule,
        ocp.Objective(ocp.track(base.orientation)),
        initial=problem.initial,
    )
    nodes = Nodes(once)
    np.testing.assert_allclose([clock(nodes, k) for k in (0, 10, 15, 20, 40)], np.pi * np.array([0, 0.5, 0.75, 1, 1]))


def test_features_of_ones_own(nodes: Nodes) -> None:
    def speed(s: Any, r: Any) -> Any:
        return s.base.linear_velocity[0] - r.velocity[0]

    inputs = ValueInputs(["ground normal", Feature("speed error", speed)])
    states = states_of(nodes)
    np.testing.assert_allclose(columns(nodes, states, inputs=inputs)["speed error"][:, 0], states[:, 19] - 0.3)


def test_feature_of_the_control_is_refused(nodes: Nodes) -> None:
    inputs = ValueInputs([Feature("torque", lambda s, _: s.joints.torque)])
    with pytest.raises(ProblemError, match="'torque': depends on something else than state and targets"):
        inputs.spec(nodes.mode)


def test_feature_that_the_model_cannot_supply_is_refused(nodes: Nodes) -> None:
    inputs = ValueInputs([Feature("forces", lambda s, _: s.feet.force)])
    with pytest.raises(UnknownNameError, match=r"no quantity 'feet\.force'"):
        inputs.spec(nodes.mode)


def test_unknown_and_double_features_are_refused() -> None:
    with pytest.raises(UnknownNameError, match="did you mean 'ground normal'"):
        ValueInputs(["ground norml"])
    with pytest.raises(ProblemError, match="each once"):
        ValueInputs(["phase", "phase"])
