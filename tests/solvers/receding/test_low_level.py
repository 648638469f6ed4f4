"""Low levels follow plans of the receding horizon: states are measured in the world, a plan has its own frame."""

import numpy as np
import pytest

from piaffe import models, ocp, solvers
from piaffe.models import base, feet
from tests.solvers.receding.test_ticks import ahead, problem

FRAME = (2.0, -1.0, 2.0)


def planned(frame, declared=None, ticks=4):
    """Return a receding horizon that has moved on from a frame, its plan, and a state of the plan with noise."""
    declared = declared or problem(models.gaits.trot(speed=0.4))
    mpc = solvers.RecedingHorizon(declared, first_iterations=8, iterations=2)
    rng = np.random.default_rng(7)
    x = mpc.horizon.courses.moved(np.array(declared.initial), frame)
    for k in range(ticks):
        plan = mpc.plan(x, 0.02 * k)
        x = ahead(plan, 0.02 * (k + 1), rng, 1e-3)
    return mpc, plan, x


@pytest.mark.parametrize(
    ("make", "options"),
    [
        (solvers.Vwbc, {}),
        (solvers.Vwbc, {"contacts": "measured"}),
        (solvers.Vwbc, {"leave_out": ("base.position x",)}),
        (solvers.Riccati, {"contacts": "measured"}),
        (solvers.FeedforwardPD, {}),
    ],
)
def test_the_tick_in_c_moves_the_measured_state_into_the_frame_of_the_plan(make, options):
    mpc, plan, x = planned(FRAME)
    assert np.abs(plan.anchor).min() > 0.5
    twins = [make(plan, backend=backend, **options) for backend in ("native", "numpy")]
    space, rng = mpc.horizon.models[0].state, np.random.default_rng(1)
    for k in range(50):
        y = space.np_plus(x, 10 ** rng.uniform(-3, -1) * rng.standard_normal(space.ndx))
        flags = (rng.integers(0, 2, 4),) if options.get("contacts") else ()
        u, expected = (twin.control(y, 0.08 + 0.002 * k, *flags) for twin in twins)
        np.testing.assert_allclose(u, expected, rtol=0, atol=1e-9 * (1 + np.abs(expected).max()))
    assert getattr(twins[0], "statuses", None) == getattr(twins[1], "statuses", None)


def test_the_control_does_not_depend_on_where_the_robot_is():
    (mpc, there, x), (_, here, y) = planned(FRAME), planned((0.0, 0.0, 0.0))
    assert np.allclose(mpc.horizon.courses.moved(y, FRAME)[:3], x[:3], atol=1e-6)
    u, expected = (solvers.Vwbc(plan).control(each, 0.08) for plan, each in ((there, x), (here, y)))
    np.testing.assert_allclose(u, expected, rtol=0, atol=1e-5 * np.abs(expected).max())


def test_a_state_with_a_part_that_is_not_finite_still_damps_the_joints():
    mpc, plan, x = planned(FRAME)
    where = mpc.horizon.models[0].state.slices
    x[where[models.base.position]] = np.nan
    for backend in ("native", "numpy"):
        low = solvers.Vwbc(plan, backend=backend, damping=0.1)
        np.testing.assert_allclose(low.control(x, 0.08), -0.1 * x[where[models.joints.velocity]], atol=1e-12)
        assert low.damped == 1


@pytest.mark.parametrize("backend", ["native", "numpy"])
@pytest.mark.parametrize("make", [solvers.Vwbc, solvers.Riccati])
def test_controls_that_are_forces_turn_with_the_robot(make, backend):
    body = models.SingleRigidBody(models.load("mini_cheetah"))
    objective = ocp.Objective(
        ocp.track(base.position, weight=(0, 0, 50)), ocp.track(base.orientation, weight=5.0),
        ocp.track(base.linear_velocity, weight=5.0), ocp.track(base.angular_velocity, weight=1.0),
        ocp.track(feet.force, weight=0.001),
    )  # fmt: skip
    limits, gait = ocp.Constraints(models.friction_cone(mu=0.6)), models.gaits.trot(speed=0.4)
    declared = ocp.Problem(gait, body.over(0.3, dt=0.01), objective, limits, initial=body.state())
    (_, there, x), (_, here, y) = planned(FRAME, declared), planned((0.0, 0.0, 0.0), declared)
    u, expected = (make(plan, backend=backend).control(each, 0.08) for plan, each in ((there, x), (here, y)))
    c, s = np.cos(FRAME[2]), np.sin(FRAME[2])
    turned = expected.reshape(4, 3) @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
    assert np.abs(expected.reshape(4, 3)[:, :2]).max() > 1.0
    np.testing.assert_allclose(u.reshape(4, 3), turned, rtol=0, atol=1e-4 * np.abs(expected).max())
