"""The backward sweep and the linear roll-out against one dense KKT system."""

from dataclasses import replace

import numpy as np
import pytest

from piaffe.solvers import LqPhase
from piaffe.solvers.ilqr.riccati import Sweep, backward, roll_out

from .dense import stack_models

SIZES = ((4, 5, 2), (3, 3, 1), (2, 4, 0), (5, 2, 3))  # stages, states and controls of every phase


def random_model(rng: np.random.Generator, sizes: tuple[tuple[int, int, int], ...] = SIZES) -> list[LqPhase]:
    """Return a convex multi-phase model with defects everywhere and cross terms in the cost."""
    phases = []
    for i, (n, nx, nu) in enumerate(sizes):
        roots = rng.normal(size=(n, nx + nu, nx + nu))
        H = roots @ roots.swapaxes(1, 2) + 0.1 * np.eye(nx + nu)
        end = rng.normal(size=(nx, nx))
        last = i + 1 == len(sizes)
        phases.append(
            LqPhase(
                A=rng.normal(size=(n, nx, nx)) / np.sqrt(nx), B=rng.normal(size=(n, nx, nu)),
                d=rng.normal(size=(n + 1, nx)), l_x=rng.normal(size=(n, nx)), l_u=rng.normal(size=(n, nu)),
                l_xx=H[:, :nx, :nx], l_ux=H[:, nx:, :nx], l_uu=H[:, nx:, nx:],
                end_x=rng.normal(size=nx), end_xx=end @ end.T,
                P=None if last else rng.normal(size=(sizes[i + 1][1], nx)),
            )
        )  # fmt: skip
    return phases


def sweep(phases: list[LqPhase]) -> list[Sweep]:
    found = backward(phases, 0.0)
    assert found is not None
    return found


@pytest.fixture
def model() -> list[LqPhase]:
    return random_model(np.random.default_rng(0))


def test_step_matches_the_dense_kkt_solution(model: list[LqPhase]) -> None:
    stack, places = stack_models(model)
    states, controls = places.split(stack.solve())
    direction = roll_out(model, sweep(model))
    for i in range(len(model)):
        np.testing.assert_allclose(direction.dx[i], states[i], atol=1e-9)
        np.testing.assert_allclose(direction.du[i], controls[i], atol=1e-9)


def test_policy_is_plus_k_plus_K_dx(model: list[LqPhase]) -> None:
    sweeps = sweep(model)
    direction = roll_out(model, sweeps)
    for dx, du, s in zip(direction.dx, direction.du, sweeps, strict=True):
        np.testing.assert_allclose(du, s.feedforward + np.einsum("nij,nj->ni", s.feedback, dx[:-1]), atol=1e-12)
    # a scalar by hand: x+ = x + u, cost ½ u² + ½ (x+)²; from x the best is u = −x/2, so both signs are plus
    one, none = np.ones((1, 1, 1)), np.zeros((1, 1, 1))
    scalar = LqPhase(
        one, one, np.array([[1.0], [0.5]]), none[0], none[0], none, none, one, np.zeros(1), np.eye(1), None
    )
    (s,) = sweep([scalar])
    assert s.feedback.item() == pytest.approx(-0.5)
    assert s.feedforward.item() == pytest.approx(-0.25)  # half of the defect 0.5 that pushes x+ up


@pytest.mark.parametrize("size", [1.0, 0.5, 0.1, -0.3])
def test_expected_change_is_exact(model: list[LqPhase], size: float) -> None:
    stack, places = stack_models(model)
    direction = roll_out(model, sweep(model))
    w = places.join(direction.dx, direction.du)
    assert stack.cost(size * w) == pytest.approx(size * direction.dV1 + 0.5 * size**2 * direction.dV2, rel=1e-10)


def test_value_function_predicts_the_cost_of_another_start(model: list[LqPhase]) -> None:
    rng, (first, *_) = np.random.default_rng(1), sweep(model)

    def optimum(deviation: np.ndarray) -> float:
        d = model[0].d.copy()
        d[0] = deviation
        stack, _ = stack_models([replace(model[0], d=d), *model[1:]])
        return stack.cost(stack.solve())

    for deviation in rng.normal(size=(3, model[0].d.shape[1])):
        predicted = first.V_x[0] @ deviation + 0.5 * deviation @ first.V_xx[0] @ deviation
        assert optimum(deviation) - optimum(0 * deviation) == pytest.approx(predicted, rel=1e-9)


def test_value_function_of_every_phase_is_that_of_its_tail(model: list[LqPhase]) -> None:
    sweeps = sweep(model)
    for i in range(len(model)):
        (head, *_) = sweep(model[i:])
        np.testing.assert_allclose(head.V_xx[0], sweeps[i].V_xx[0], rtol=1e-10)
        np.testing.assert_allclose(head.V_x[0], sweeps[i].V_x[0], rtol=1e-10)


def test_action_value_predicts_the_cost_of_another_first_control(model: list[LqPhase]) -> None:
    rng, s = np.random.default_rng(2), sweep(model)[0]

    def best_after(dx: np.ndarray, du: np.ndarray) -> float:
        d = model[0].d.copy()
        d[0] = dx
        stack, places = stack_models([replace(model[0], d=d), *model[1:]])
        stack.equal(places.u[0][0], np.eye(len(du)), du)
        return stack.cost(stack.solve())

    nx, nu = model[0].B.shape[1:]
    origin = best_after(np.zeros(nx), np.zeros(nu))
    for dx, du in zip(rng.normal(size=(3, nx)), rng.normal(size=(3, nu)), strict=True):
        linear = s.Q_x[0] @ dx + s.Q_u[0] @ du
        quadratic = dx @ s.Q_xx[0] @ dx + 2 * du @ s.Q_ux[0] @ dx + du @ s.Q_uu[0] @ du
        assert best_after(dx, du) - origin == pytest.approx(linear + 0.5 * quadratic, rel=1e-9)


def test_expansions_are_consistent(model: list[LqPhase]) -> None:
    for s in sweep(model):
        for i in range(len(s.feedforward)):
            np.testing.assert_allclose(s.Q_uu[i] @ s.feedforward[i], -s.Q_u[i], atol=1e-9)
            np.testing.assert_allclose(s.Q_uu[i] @ s.feedback[i], -s.Q_ux[i], atol=1e-9)
            np.testing.assert_allclose(s.V_x[i], s.Q_x[i] + s.Q_ux[i].T @ s.feedforward[i], atol=1e-9)
            np.testing.assert_allclose(s.V_xx[i], s.Q_xx[i] + s.Q_ux[i].T @ s.feedback[i], atol=1e-8)
            np.testing.assert_array_equal(s.V_xx[i], s.V_xx[i].T)


def test_regularisation_shortens_the_step(model: list[LqPhase]) -> None:
    lengths = []
    for regularization in (0.0, 1.0, 100.0):
        sweeps = backward(model, regularization)
        assert sweeps is not None
        lengths.append(sum(float(np.linalg.norm(s.feedforward)) for s in sweeps))
    assert lengths == sorted(lengths, reverse=True)


def test_indefinite_model_is_refused_until_regularised(model: list[LqPhase]) -> None:
    bad = [replace(model[0], l_uu=model[0].l_uu - 1e4 * np.eye(2)), *model[1:]]
    assert backward(bad, 0.0) is None
    assert backward(bad, 1e5) is not None


def test_nan_is_refused(model: list[LqPhase]) -> None:
    l_x = model[-1].l_x.copy()
    l_x[0, 0] = np.nan
    assert backward([*model[:-1], replace(model[-1], l_x=l_x)], 0.0) is None
