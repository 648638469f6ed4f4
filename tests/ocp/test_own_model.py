"""Models by hand: integrators of their order, rotations, further quantities, what functions see of a node."""

from math import pi

import casadi as cs
import numpy as np
import pytest

from piaffe import ocp
from piaffe.errors import ProblemError, UnknownNameError
from piaffe.ocp import Vectorised, rotation


def mode_of(model, key="go", *terms, rows=(), dt=0.1):
    """Return the compiled phase of a one-phase problem."""
    motion = ocp.Motion(ocp.Phase("only", key, 2 * dt))
    cost = [ocp.regularize(block.quantity, weight=1.0) for block in model.control.blocks]
    initial = np.concatenate(
        [np.eye(4)[0] if b.quantity.kind == "rotation" else np.zeros(b.nx) for b in model.state.blocks]
    )
    problem = ocp.Problem(
        motion, model.until_end(dt=dt), ocp.Objective(*cost, *terms), ocp.Constraints(*rows), initial=initial
    )
    return ocp.compile_problem(problem, checks=False).phases[0]


def step(model, x, u=(), dt=0.1):
    phase = mode_of(model, dt=dt)
    arguments = (np.atleast_2d(x), np.zeros((1, 0)) if not len(u) else np.atleast_2d(u), np.zeros((1, 0)), phase.p[:1])
    return Vectorised(phase.mode.functions["stage"])(*arguments)[0][0]


def oscillator(integrator):
    return ocp.Model(
        "spring", state={"x": 1, "v": 1}, modes={"go": lambda s: {"x": s.v, "v": -s.x}}, integrator=integrator
    )


def test_euler_takes_one_slope():
    assert step(oscillator("euler"), [1.0, 0.5], dt=0.1) == pytest.approx([1.05, 0.4])


@pytest.mark.parametrize(("integrator", "order"), [("euler", 1), ("rk4", 4)])
def test_the_error_falls_with_the_order_of_the_integrator(integrator, order):
    model, errors = oscillator(integrator), []
    for n in (8, 16):
        x = np.array([1.0, 0.0])
        for _ in range(n):
            x = step(model, x, dt=1.0 / n)
        errors.append(np.linalg.norm(x - [np.cos(1.0), -np.sin(1.0)]))
    assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.15)


def test_a_discrete_model_gives_the_next_state_itself():
    model = ocp.Model(
        "map", state={"x": 1}, control={"u": 1}, modes={"go": lambda s: {"x": 2 * s.x + s.u}}, integrator="discrete"
    )
    assert step(model, [3.0], [0.5]) == pytest.approx([6.5])


@pytest.mark.parametrize("integrator", ["euler", "rk4"])
def test_a_rotation_turns_at_its_body_rate(integrator):
    model = ocp.Model(
        "top",
        state={"turn": "rotation"},
        control={"rate": 3},
        modes={"go": lambda s: {"turn": s.rate}},
        integrator=integrator,
    )
    assert (model.state.nx, model.state.ndx) == (4, 3)
    start = rotation.np_from_rpy(np.array([0.0, 0.0, pi / 2]))
    turned = step(model, start, [0.0, 1.0, 0.0])
    expected = rotation.np_multiply(start, rotation.np_exp(np.array([0.0, 0.1, 0.0])))
    assert turned == pytest.approx(expected, abs=1e-12)


def test_a_keyframe_of_a_rotation_is_its_angles():
    model = ocp.Model("top", state={"turn": "rotation"}, modes={"go": lambda s: {"turn": [0, 0, 0]}})
    motion = ocp.Motion(ocp.Phase("a", "go", 0.2, {"turn": (2 * pi, 0, 0)}))
    path = motion.bind((model,), model.state.unpack(np.eye(4)[0]))
    half = path.sample(0.1, path.interval_at(0.1))[model.state.blocks[0].quantity]
    assert rotation.np_matrix(half) == pytest.approx(np.diag([1, -1, -1]), abs=1e-12)


def test_derivatives_may_be_expressions_numbers_arrays_or_lists():
    model = ocp.Model(
        "mixed", state={"a": 1, "b": 2, "c": 2, "d": 2},
        modes={"go": lambda s: {"a": 3, "b": [s.a, 1.0], "c": np.array([1.0, 2.0]), "d": 2 * s.b}},
    )  # fmt: skip
    assert step(model, [1, 2, 3, 4, 5, 6, 7]) == pytest.approx([1.3, 2.1, 3.1, 4.1, 5.2, 6.4, 7.6])


def test_further_quantities_are_tracked_and_constrained():
    model = ocp.Model(
        "ball", state={"z": 1, "vz": 1}, modes={"go": lambda s: {"z": s.vz, "vz": -9.81}},
        quantities={"energy": lambda s: 0.5 * s.vz**2 + 9.81 * s.z, "both": lambda s: [s.z, s.energy]},
    )  # fmt: skip
    row = ocp.inequality(lambda s: s.both, upper=20.0)
    phase = mode_of(model, "go", ocp.track("energy", to=5.0), rows=[row])
    _, residual, g, _ = Vectorised(phase.mode.functions["stage"])(
        np.array([[1.0, 2.0]]), np.zeros((1, 0)), np.zeros((1, 0)), phase.p[:1]
    )
    assert residual[0] == pytest.approx([11.81 - 5.0])
    assert g[0] == pytest.approx([19.0, 20.0 - 11.81])


def test_a_node_shows_quantities_by_attribute_key_and_component():
    model = ocp.Model("m", state={"q": 3, "v": 3}, modes={"go": lambda s: {"q": s["v"], "v": [0, 0, 0]}})
    seen = []

    def look(s):
        seen.extend([s.q["1"], s.q[2], s.v.shape, cs.sumsqr(s.q)])
        return s.q[0]

    mode_of(model, "go", rows=[ocp.inequality(look)])
    assert [str(seen[0]), str(seen[1]), seen[2]] == ["x_1", "x_2", (3, 1)]


def test_a_node_names_what_it_does_not_have():
    model = ocp.Model("m", state={"height": 1}, modes={"go": lambda s: {"height": s.hight}})
    with pytest.raises(UnknownNameError, match=r"model 'm': no quantity 'hight' .*did you mean 'height'"):
        mode_of(model)


def test_a_parameter_in_dynamics():
    drag = ocp.parameter("drag", 0.5)
    model = ocp.Model("m", state={"v": 1}, modes={"go": lambda s: {"v": -drag * s.v}})
    assert step(model, [2.0]) == pytest.approx([1.9])


@pytest.mark.parametrize("value", [float("inf"), [[1.0, 2.0]], "0.1m"])
def test_parameters_are_finite_numbers_in_a_column(value):
    with pytest.raises((ProblemError, ValueError)):
        ocp.parameter("gap", value)


def test_a_parameter_shows_itself():
    assert repr(ocp.parameter("gap", (0.1, 0.2))) == "parameter('gap', [0.1, 0.2])"
