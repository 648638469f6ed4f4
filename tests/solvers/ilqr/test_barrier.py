"""The relaxed barrier: its derivatives, its join, and the rule by which it tightens."""

import numpy as np
import pytest

from piaffe.solvers.ilqr import barrier

DELTA = np.array([0.3])
POINTS = np.array([-2.0, -0.1, 0.0, 0.1, 0.29, 0.31, 1.0, 50.0])


def test_slope_and_curvature_match_finite_differences() -> None:
    step = 1e-6
    up, down = POINTS + step, POINTS - step
    slope = (barrier.value(up, DELTA) - barrier.value(down, DELTA)) / (2 * step)
    curvature = (barrier.slope(up, DELTA) - barrier.slope(down, DELTA)) / (2 * step)
    np.testing.assert_allclose(barrier.slope(POINTS, DELTA), slope, rtol=1e-7)
    np.testing.assert_allclose(barrier.curvature(POINTS, DELTA), curvature, rtol=1e-7)


def test_logarithm_and_parabola_join_smoothly() -> None:
    below, above = DELTA * (1 - 1e-9), DELTA * (1 + 1e-9)
    for function in (barrier.value, barrier.slope, barrier.curvature):
        np.testing.assert_allclose(function(below, DELTA), function(above, DELTA), rtol=1e-7)
    assert barrier.value(DELTA, DELTA).item() == pytest.approx(-np.log(0.3))


def test_barrier_is_the_logarithm_inside_and_finite_outside() -> None:
    np.testing.assert_allclose(barrier.value(np.array([2.0]), DELTA), -np.log(2.0))
    far = np.array([-1e6])
    assert all(np.all(np.isfinite(f(far, DELTA))) for f in (barrier.value, barrier.slope, barrier.curvature))


def test_barrier_falls_and_is_convex() -> None:
    assert np.all(barrier.slope(POINTS, DELTA) < 0)
    assert np.all(barrier.curvature(POINTS, DELTA) > 0)


def where_the_force_is(force: np.ndarray, relaxation: np.ndarray) -> np.ndarray:
    """Return g at which −β'(g) is ``force``: from the parabola, or from the logarithm if that is steeper there."""
    return np.where(force >= 1 / relaxation, 2 * relaxation - force * relaxation**2, 1 / force)


def shrink_until_met(g: np.ndarray, relaxation: np.ndarray, force: np.ndarray) -> tuple[np.ndarray, np.ndarray, int]:
    """Apply the rule while the row's force stays what it is; return g, δ and how often it was applied."""
    for count in range(20):
        if np.all(g >= -1e-5):
            return g, relaxation, count
        relaxation = barrier.shrink(relaxation, g, np.ones(g.shape), slack=1e-5, floor=1e-12)
        g = where_the_force_is(force, relaxation)
    return g, relaxation, 20


@pytest.mark.parametrize("violation", [1e-3, 0.02, 0.5])
def test_shrunk_row_holds_at_the_multiplier_that_it_has(violation: float) -> None:
    g, relaxation = np.array([-violation]), np.array([0.1])
    force = -barrier.slope(g, relaxation)  # λ/ε
    g, relaxation, count = shrink_until_met(g, relaxation, force)
    assert g.item() >= -1e-5
    assert 0.5 <= relaxation.item() * force.item() / 2 <= 1 + 1e-9  # δ ≤ 2 ε/λ, and not much smaller
    assert count <= 4


def test_rows_that_are_met_masked_or_within_slack_keep_their_relaxation() -> None:
    relaxation = np.full(4, 0.1)
    g, mask = np.array([0.5, 0.0, -1e-6, -0.3]), np.array([1.0, 1.0, 1.0, 0.0])
    np.testing.assert_array_equal(barrier.shrink(relaxation, g, mask, slack=1e-5, floor=1e-9), relaxation)


def test_relaxation_stops_at_the_floor_and_never_grows() -> None:
    g, mask = np.array([-1e9]), np.ones(1)
    assert barrier.shrink(np.array([2e-6]), g, mask, slack=1e-5, floor=1e-6).item() == 1e-6
    assert barrier.shrink(np.array([1e-7]), g, mask, slack=1e-5, floor=1e-6).item() == 1e-7


def test_active_rows_keep_their_multiplier_at_the_bound_when_the_weight_drops() -> None:
    relaxation, shift = np.full(5, 0.1), np.array([0.0, 0.0, 0.0, 0.0, 0.06])
    g, mask = np.array([-0.2, 0.05, 0.11, 0.05, 0.12]), np.array([1.0, 1.0, 1.0, 0.0, 1.0])
    followed = barrier.follow(relaxation, g, shift, mask, drop=0.3, floor=1e-9)
    np.testing.assert_array_equal(followed, [0.3 * 0.1, 0.3 * 0.1, 0.1, 0.1, 0.3 * 0.1])
    before, after = (
        -weight * barrier.slope(np.zeros(5), delta) for weight, delta in ((1.0, relaxation), (0.3, followed))
    )
    active = [0, 1, 4]
    np.testing.assert_allclose(after[active], before[active])  # λ = 2 ε/δ at g = 0


def test_followed_relaxations_stop_at_the_floor_and_never_grow() -> None:
    relaxation, nothing = np.array([2e-3, 1e-4]), np.zeros(2)
    followed = barrier.follow(relaxation, nothing, nothing, np.ones(2), drop=0.3, floor=1e-3)
    np.testing.assert_array_equal(followed, [1e-3, 1e-4])


def test_recentred_row_pushes_at_zero_as_it_pushed_where_it_was() -> None:
    relaxation, shift, g = np.full(2, 1e-3), np.array([0.0, 0.02]), np.array([-0.01, -0.005])
    moved = barrier.recentre(shift, g, np.ones(2), slack=1e-5)
    np.testing.assert_allclose(barrier.slope(0 - moved, relaxation), barrier.slope(g - shift, relaxation))


def test_shift_of_a_row_that_does_not_need_it_returns_to_zero() -> None:
    shift, g = np.array([0.02, 0.02, 0.0, 0.0]), np.array([0.005, 0.5, 0.3, -0.1])
    mask = np.array([1.0, 1.0, 1.0, 0.0])
    np.testing.assert_allclose(barrier.recentre(shift, g, mask, slack=1e-5), [0.015, 0.0, 0.0, 0.0])
