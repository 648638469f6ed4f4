"""The policy of a solution, u = ū + K (x ⊖ x̄), against its formula."""

from pathlib import Path

import numpy as np
import pytest

from piaffe import simulation
from piaffe.errors import ShapeError
from piaffe.ocp import Policy
from piaffe.solvers import MSiLQR, Solution
from tests.problems import flying_body, linear_quadratic
from tests.simulation.plans import bow


@pytest.fixture(scope="module")
def solution() -> Solution:
    return MSiLQR(flying_body()).solve()


def test_a_solutions_policy_is_its_formula(solution: Solution) -> None:
    part, K = solution.trajectory.phases[0], solution.phases[0].feedback
    rng = np.random.default_rng(0)
    for k in (0, 3, len(part.controls) - 1):
        x = part.state.np_plus(part.states[k], 0.1 * rng.standard_normal(12))
        u = part.controls[k] + K[k] @ part.state.np_minus(x, part.states[k])
        np.testing.assert_allclose(solution.policy(x, part.times[k]), u, atol=1e-12)
        np.testing.assert_allclose(solution.policy(part.states[k], part.times[k]), part.controls[k], atol=1e-12)


def test_between_nodes_the_plan_is_interpolated_on_the_manifold(solution: Solution) -> None:
    part, K = solution.trajectory.phases[0], solution.phases[0].feedback
    halfway = part.state.np_plus(part.states[2], 0.5 * part.state.np_minus(part.states[3], part.states[2]))
    x = part.state.np_plus(halfway, np.full(12, 0.02))
    t = 0.5 * (part.times[2] + part.times[3])
    np.testing.assert_allclose(solution.policy(x, t), part.controls[2] + K[2] @ np.full(12, 0.02), atol=1e-9)


def test_a_saved_solution_has_the_same_policy(solution: Solution, tmp_path: Path) -> None:
    again = Solution.load(solution.save(tmp_path / "body"))
    x = solution.trajectory.phases[0].states[4] + 0.01
    np.testing.assert_array_equal(again.policy(x, 0.21), solution.policy(x, 0.21))
    assert again.policy.end == pytest.approx(1.0)


def test_phases_of_other_models_have_their_own_states() -> None:
    solution = MSiLQR(linear_quadratic()).solve()
    one, two, three = solution.trajectory.phases
    np.testing.assert_array_equal(solution.policy(one.states[2], one.times[2]), one.controls[2])
    np.testing.assert_array_equal(solution.policy(two.states[0], two.times[0]), two.controls[0])
    assert solution.policy(three.states[1], three.times[1]).shape == (0,)
    with pytest.raises(
        ShapeError, match=r"phase 'two': state has the wrong size - got shape \(4,\), expected \(3,\); give a state of"
    ):
        solution.policy(one.states[2], two.times[1])


def test_control_and_call_are_one_and_simulation_still_has_the_policy() -> None:
    trajectory, gains = bow()
    policy = Policy(trajectory, gains)
    x = trajectory.phases[0].states[1] + 0.01
    np.testing.assert_array_equal(policy.control(x, 0.03), policy(x, 0.03))
    assert simulation.Policy is Policy
