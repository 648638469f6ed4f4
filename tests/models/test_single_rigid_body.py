"""The single rigid body: forces and torques, footholds, what it binds and refuses."""

import casadi as cs
import numpy as np
import pinocchio as pin
import pytest

from piaffe import ocp
from piaffe.errors import ModelError, ProblemError, ShapeError, UnknownNameError
from piaffe.models import SingleRigidBody, base, feet, load, stance
from piaffe.models.integrators import Integrator
from piaffe.ocp.language.model import Node
from piaffe.ocp.language.rotation import np_from_rpy, np_matrix

FEET = np.array([[0.2, 0.1, 0.0], [0.2, -0.1, 0.0], [-0.2, 0.1, 0.0], [-0.2, -0.1, 0.0]])


@pytest.fixture(scope="module")
def body() -> SingleRigidBody:
    return SingleRigidBody(load("mini_cheetah"))


def test_state_is_a_prefix_choice_of_the_whole_body(body: SingleRigidBody) -> None:
    x = body.state(rpy=(0.1, 0.2, 0.3), linear_velocity=(1, 2, 3), angular_velocity=(4, 5, 6))
    assert (body.state.nx, body.state.ndx, body.control.nx) == (13, 12, 12)
    np.testing.assert_allclose(x[3:], [*np_from_rpy(np.array([0.1, 0.2, 0.3])), 1, 2, 3, 4, 5, 6])


def test_mass_and_inertia_default_to_the_standing_robot(body: SingleRigidBody) -> None:
    model, numbers = body.robot.model, body.numbers()
    q, data = pin.neutral(model), model.createData()
    q[7:] = body.robot.pose("stand")
    pin.ccrba(model, data, q, np.zeros(model.nv))
    assert numbers["mass"] == pytest.approx([pin.computeTotalMass(model)])
    xx, yy, zz, xy, xz, yz = numbers["inertia"]
    np.testing.assert_allclose([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]], data.Ig.inertia, atol=1e-12)


def test_entries_of_absent_feet_move_nothing(body: SingleRigidBody) -> None:
    x, rng = body.state(), np.random.default_rng(1)
    forces, changed, moved = rng.normal(size=12), rng.normal(size=12), FEET.copy()
    changed[[0, 1, 2, 9, 10, 11]] = forces[[0, 1, 2, 9, 10, 11]]
    moved[[1, 2]] += 1.0
    after = body.step(x, forces, "FL HR", FEET, 0.05)
    np.testing.assert_array_equal(body.step(x, changed, "FL HR", moved, 0.05), after)


@pytest.mark.parametrize(("integrator", "order"), [("euler", 1), ("midpoint", 2)])
def test_angular_momentum_is_kept_in_flight(integrator: Integrator, order: int) -> None:
    body = SingleRigidBody(load("mini_cheetah"), integrator=integrator)

    def world_momentum(x: np.ndarray) -> np.ndarray:
        xx, yy, zz, xy, xz, yz = body.numbers()["inertia"]
        return np_matrix(x[3:7]) @ (np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ x[10:13])

    drifts = []
    for steps in (100, 200):
        x = start = body.state(angular_velocity=(3.0, -2.0, 1.0))
        for _ in range(steps):
            x = body.step(x, np.ones(12), "", FEET, 0.2 / steps)
        drifts.append(np.linalg.norm(world_momentum(x) - world_momentum(start)))
    assert drifts[0] / drifts[1] == pytest.approx(2**order, rel=0.05)


def test_node_takes_footholds_from_the_reference(body: SingleRigidBody) -> None:
    sample = {base.position: np.zeros(3), base.orientation: np.array([1.0, 0, 0, 0]), feet.position: FEET.ravel()}
    given = body.node_parameters(Node(0.0, stance("FL HR"), None, sample))
    np.testing.assert_array_equal(given["contact"], [1, 0, 0, 1])
    np.testing.assert_array_equal(given["footholds"], FEET.ravel())


def test_node_without_reference_of_the_feet_puts_them_below_the_base(body: SingleRigidBody) -> None:
    tilted = np_from_rpy(np.array([0.4, 0.3, np.pi / 2]))
    sample = {base.position: np.array([1.0, 2.0, 0.5]), base.orientation: tilted}
    footholds = body.node_parameters(Node(0.0, stance(), None, sample))["footholds"].reshape(-1, 3)
    np.testing.assert_allclose(footholds[:, 2], body.robot.foot_radius)
    assert np.all(footholds[:2, 1] > 2.0)  # turned a quarter to the left, the front feet are ahead in y
    assert np.all(footholds[2:, 1] < 2.0)
    np.testing.assert_allclose(footholds[:, 0], [0.889, 1.111, 0.889, 1.111], atol=1e-9)


def test_modes_never_cut_it(body: SingleRigidBody) -> None:
    assert not body.cut_by_modes
    assert body.implicit_size("contact") == 0
    assert body.mode_key(stance("FL")) == body.mode_key("") == "contact"


def test_quantities(body: SingleRigidBody) -> None:
    x, u, p = cs.SX.sym("x", 13), cs.SX.sym("u", 12), body.symbols()
    quantities = body.dynamics("contact", x, u, cs.SX(0, 1), p).quantities
    for path in quantities.paths:
        bound = quantities.bind(path)
        assert bound.value.shape == (4 if path == "base.orientation" else bound.size, 1)
    assert feet.force in quantities
    assert "feet.height" not in quantities
    with pytest.raises(UnknownNameError, match=r"no quantity 'feet\.heigh'"):
        quantities.bind("feet.heigh")


def test_wrong_arguments_are_refused(body: SingleRigidBody) -> None:
    x = body.state()
    with pytest.raises(UnknownNameError, match="no foot 'RL' - got 'RL', expected one of"):
        body.step(x, np.zeros(12), "RL", FEET, 0.01)
    with pytest.raises(ShapeError, match="parameter 'footholds': wrong size - got 9 entries, expected 12"):
        body.step(x, np.zeros(12), "FL", FEET[:3], 0.01)
    with pytest.raises(ShapeError, match="argument 'u': wrong size - got 3 entries, expected 12"):
        body.step(x, np.zeros(3), "FL", FEET, 0.01)
    with pytest.raises(ModelError, match=r"inertia is unusable - got shape \(2,\), expected a symmetric"):
        SingleRigidBody(body.robot, inertia=[1.0, 2.0])
    with pytest.raises(ModelError, match=r"inertia is not positive - got principal inertias \[-1.0, 1.0, 1.0\]"):
        SingleRigidBody(body.robot, inertia=[1.0, 1.0, -1.0, 0, 0, 0])
    with pytest.raises(ModelError, match="mass is out of range - got -1, expected a positive number"):
        SingleRigidBody(body.robot, mass=-1)
    with pytest.raises(ModelError, match=r"models\.SingleRigidBody: not a robot - got 'solo12', expected what models"):
        SingleRigidBody("solo12")  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [
        ("mass", -1.0, "numbers > 0"),
        ("mass", 0.0, "numbers > 0"),
        ("inertia", [1.0, 1.0, -1.0, 0.0, 0.0, 0.0], "an inertia with positive principal values"),
        ("inertia", [1.0, 1.0, 1.0, 2.0, 0.0, 0.0], "an inertia with positive principal values"),
    ],
)
def test_numbers_that_are_refused_as_arguments_are_refused_as_parameters(name, value, expected):
    robot = load("mini_cheetah")
    with pytest.raises(ModelError):
        SingleRigidBody(robot, **{name: value})
    model = SingleRigidBody(robot, name="block")
    problem = ocp.Problem(
        ocp.Motion(ocp.Phase("stand", "FL FR HL HR", 0.3)),
        model.until_end(dt=0.1),
        ocp.Objective(ocp.regularize(feet.force, weight=1e-4)),
        initial=model.state(),
    )
    with pytest.raises(ProblemError, match=expected):
        problem.with_parameters({f"block.{name}": value})
    with pytest.raises(ProblemError, match=expected):
        ocp.compile_problem(problem).with_parameters({f"block.{name}": value})
