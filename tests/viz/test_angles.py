"""Roll, pitch and yaw of figures have no jumps, and count full turns as a motion declares them."""

from math import pi

import numpy as np
import pytest

from piaffe import ocp, solvers
from piaffe.ocp import Quantity, rotation
from piaffe.viz.angles import continuous_rpy
from piaffe.viz.curves import panels
from piaffe.viz.figure import draw

TIMES = np.linspace(0, 1, 81)


def path(*ends):
    """Return the triples from zero to three angles, (81, 3)."""
    return TIMES[:, None] * np.array(ends)


def largest_steps(angles):
    return np.abs(np.diff(angles, axis=0)).max(axis=0)


@pytest.mark.parametrize("ends", [
    (2 * pi, 0, 0), (-4 * pi, 0.3, 1.0), (0, -2 * pi, 0), (0, 4 * pi, 0), (0.2, 0.4, -6 * pi), (5 * pi, 0, -3 * pi),
])  # fmt: skip
def test_declared_angles_come_back_with_their_full_turns(ends):
    declared = path(*ends)
    np.testing.assert_allclose(continuous_rpy(rotation.np_from_rpy(declared)), declared, atol=1e-12)


def test_the_signs_of_quaternions_do_not_matter():
    declared = path(2 * pi, 0.4, 3 * pi)
    signs = np.where(np.random.default_rng(3).random(len(TIMES)) < 0.5, -1.0, 1.0)[:, None]
    np.testing.assert_allclose(continuous_rpy(signs * rotation.np_from_rpy(declared)), declared, atol=1e-12)


def test_a_flip_with_roll_and_yaw_keeps_both_at_the_vertical():
    declared = path(0, -2 * pi, 0) + np.array([0.3, 0.0, -0.8])
    found = continuous_rpy(rotation.np_from_rpy(declared), near=declared[0])
    np.testing.assert_allclose(found, declared, atol=1e-12)


@pytest.mark.parametrize("tilt", [0.02, 0.05, 0.1])
def test_a_flip_that_misses_the_vertical_has_no_jump(tilt):
    """The base passes the vertical at a distance, where roll and yaw of an exact triple turn by π."""
    tilted = np.broadcast_to(rotation.np_exp(np.array([tilt, 0.0, 0.0])), (len(TIMES), 4))
    motion = rotation.np_multiply(tilted, rotation.np_from_rpy(path(0, -2 * pi, 0)))
    usual = np.unwrap(rotation.np_to_rpy(motion), axis=0)
    assert np.ptp(usual[:, [0, 2]], axis=0).min() > 0.9 * pi  # what this is about
    found = continuous_rpy(motion)
    assert np.all(largest_steps(found) < [3.5 * tilt, 2 * pi / 80 + 2 * tilt, 3.5 * tilt])
    assert np.abs(found[:, [0, 2]]).max() < 3.5 * tilt  # sin 20° is 1 / 2.9
    np.testing.assert_allclose(found[-1], [tilt, -2 * pi, 0], atol=1e-9)


def test_triples_are_exact_away_from_the_vertical():
    rng = np.random.default_rng(7)
    rates = np.cumsum(rng.normal(0, 0.02, (400, 3)), axis=0)
    motion = [rotation.np_from_rpy(np.array([0.2, -0.3, 0.5]))]
    for rate in rates:
        motion.append(rotation.np_multiply(motion[-1], rotation.np_exp(rate)))
    found = continuous_rpy(np.array(motion))
    again = np.abs(np.sum(rotation.np_from_rpy(found) * motion, axis=1))
    exact = np.abs(np.cos(found[:, 1])) > np.sin(np.radians(20.0))
    assert 0.5 < exact.mean() < 1.0
    np.testing.assert_allclose(again[exact], 1.0, atol=1e-12)


def test_a_base_that_rears_and_comes_back_does_not_flip():
    declared = np.stack([0 * TIMES, -1.45 * np.sin(pi * TIMES), 0 * TIMES], axis=1)
    found = continuous_rpy(rotation.np_from_rpy(declared))
    np.testing.assert_allclose(found, declared, atol=1e-12)


def test_gaps_stay_gaps_and_turns_go_on_after_them():
    declared = path(0, 0, 4 * pi)
    motion = rotation.np_from_rpy(declared)
    motion[50:55] = np.nan
    found = continuous_rpy(motion)
    assert np.all(np.isnan(found[50:55]))
    np.testing.assert_allclose(found[55:], declared[55:], atol=1e-12)
    assert np.all(np.isnan(continuous_rpy(np.full((3, 4), np.nan))))


def test_the_first_triple_has_small_angles_or_is_near_to_a_given_one():
    upside_down = rotation.np_from_rpy(np.array([[0.0, 3.0, 0.1]]))
    np.testing.assert_allclose(continuous_rpy(upside_down), [[0.0, 3.0, 0.1]], atol=1e-12)
    turned = continuous_rpy(upside_down, near=np.array([pi, 0.1, 3 * pi]))
    np.testing.assert_allclose(turned, [[pi, pi - 3.0, 0.1 + 3 * pi]], atol=1e-12)


# ---- in the figure


@pytest.fixture(scope="module")
def turns():
    """A free body rolls, flips backwards and turns, a full turn each."""
    body = ocp.Model(
        "turning", control={"torque": 3}, state={"attitude": "rotation", "rate": 3},
        modes={"fly": lambda s: {"attitude": s.rate, "rate": s.torque}},
    )  # fmt: skip
    motion = ocp.Motion(
        ocp.Phase("roll", "fly", 0.6, {"attitude": (2 * pi, 0, 0)}),
        ocp.Phase("flip", "fly", 0.6, {"attitude": (2 * pi, -2 * pi, 0)}),
        ocp.Phase("turn", "fly", 0.6, {"attitude": (2 * pi, -2 * pi, 2 * pi)}),
    )
    objective = ocp.Objective(
        ocp.track(Quantity("attitude", "rad", "rotation"), 1e3), ocp.regularize("torque", 1e-4),
    )  # fmt: skip
    start = np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    problem = ocp.Problem(motion, body.until_end(dt=0.02), objective, initial=start)
    return solvers.MSiLQR(problem).solve().raise_if_failed()


def test_turns_end_where_they_are_declared_and_so_do_their_targets(turns):
    panel = next(panel for panel in panels(turns) if panel.title == "attitude")
    assert [curve.label for curve in panel.curves] == ["roll", "pitch", "yaw"]
    targets = np.stack([curve.target for curve in panel.curves], axis=1)
    values = np.stack([curve.values for curve in panel.curves], axis=1)
    ends = np.cumsum([len(part.times) for part in turns.trajectory.phases]) - 1
    declared = [(2 * pi, 0, 0), (2 * pi, -2 * pi, 0), (2 * pi, -2 * pi, 2 * pi)]
    np.testing.assert_allclose(targets[ends], declared, atol=1e-9)
    np.testing.assert_allclose(values[ends], declared, atol=0.3)
    np.testing.assert_allclose(values[-1], declared[-1], atol=0.1)
    assert largest_steps(targets).max() < 2 * pi / 30 + 1e-9
    assert largest_steps(values).max() < 2 * 2 * pi / 30


def test_lines_and_targets_of_turns_are_drawn(turns):
    axes = next(axes for axes in draw(turns).axes if axes.get_title(loc="left") == "attitude")
    drawn = {line.get_label(): line.get_ydata() for line in axes.lines}
    assert drawn["pitch"][-1] == pytest.approx(-2 * pi, abs=0.1)
    dotted = [line.get_ydata()[-1] for line in axes.lines if line.get_linestyle() == "--"]
    np.testing.assert_allclose(sorted(dotted), [-2 * pi, 2 * pi, 2 * pi], atol=1e-9)
    low, high = axes.get_ylim()
    assert low < -2 * pi
    assert high > 2 * pi
