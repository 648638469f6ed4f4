"""Horizons at the edges: time steps that are no decimal fractions, parts that do not fit, unusual targets and times."""

import numpy as np
import pytest

from piaffe import models, ocp
from piaffe.errors import ProblemError, ShapeError
from piaffe.models import base, feet, joints, stance
from tests import balls


def motion(*lengths, **more):
    return ocp.Motion(*(balls.phase(f"p{i}", length) for i, length in enumerate(lengths)), **more)


@pytest.mark.parametrize("steps", [(1 / 30,), (1 / 240,), (1 / 60, 1 / 240), (1 / 30, 1 / 300), (0.0125, 0.0125)])
def test_time_steps_may_be_any_fractions_of_a_second(steps):
    models_ = (balls.ball("head"), balls.ball("tail"))
    schedule = ocp.Schedule(())
    for model, dt in zip(models_, steps, strict=False):
        schedule = schedule + model.over(8 * dt, dt=dt)
    declared = balls.problem(motion(0.3, 0.2, 0.5), schedule)
    horizon = ocp.Horizon(declared)
    assert horizon.calendar.tick == pytest.approx(steps[-1], rel=1e-15)
    for k in range(0, round(0.4 / steps[0]), 3):
        t = k * steps[0]
        got = horizon.at(horizon.begin(declared.initial, t), declared.initial)
        expected = ocp.compile_problem(declared, t, checks=False)
        assert len(got.phases) == len(expected.phases)
        for own, other in zip(got.phases, expected.phases, strict=True):
            assert np.allclose(own.times, other.times, atol=1e-12)
            assert np.allclose(own.p, other.p, atol=1e-12)


def test_an_hour_of_steps_that_are_no_decimal_fractions_does_not_drift():
    schedule = balls.ball().over(1 / 6, dt=1 / 60)
    horizon = ocp.Horizon(balls.problem(motion(0.3, 0.2, cyclic=True), schedule))
    x = np.array(horizon.problem.initial)
    late = horizon.at(horizon.begin(x, 3600.1), x)
    assert late.phases[0].times[0] == pytest.approx(3600.1, abs=1e-9)
    assert late.phases[0].interval.start == pytest.approx(3600.0, abs=1e-9)


@pytest.mark.parametrize("length", [0.105, 0.004])
def test_a_part_that_is_no_whole_number_of_steps_is_refused(length):
    text = rf"model 'ball': not a whole number of steps - got {length:g} s with dt 0.01 s, expected a multiple"
    with pytest.raises(ProblemError, match=text):
        ocp.Horizon(balls.problem(motion(0.3, 0.2, 0.5), balls.ball().over(length, dt=0.01)))


def test_a_third_model_whose_phases_would_begin_between_its_steps_is_refused():
    middle, last = balls.ball("middle", cut=False), balls.ball("last")
    schedule = balls.ball().over(0.08, dt=0.04) + middle.over(0.09, dt=0.03) + last.over(0.2, dt=0.02)
    with pytest.raises(ProblemError, match=r"move by the steps of the models before it - got dt 0.02 s after 0.03 s"):
        ocp.Horizon(balls.problem(motion(0.4, 0.4, 0.4), schedule))


@pytest.mark.parametrize("t", [1e300, 1e8, np.inf, -np.inf])
def test_times_too_late_for_their_numbers_are_refused(t):
    horizon = ocp.Horizon(balls.problem(motion(0.3, 0.2, cyclic=True), balls.ball().over(0.1, dt=0.01)))
    with pytest.raises(ProblemError, match=r"time is outside the motion - got t = .* expected 0 ≤ t ≤ 1e\+07 s"):
        horizon.begin(horizon.problem.initial, t)


def test_a_command_that_is_no_number_is_refused():
    body = models.WholeBody(models.load("mini_cheetah"))
    objective = ocp.Objective(ocp.track(base.position, weight=30.0), ocp.regularize(joints.torque, weight=0.02))
    schedule = body.over(0.1, dt=0.01)
    declared = ocp.Problem(models.gaits.trot(), schedule, objective, initial=body.state(joints="stand"))
    with pytest.raises(ProblemError, match=r"command 'speed': is not finite - got 'fast', expected a number"):
        ocp.Horizon(declared).begin(declared.initial, 0.0, {"speed": "fast"})


def test_a_target_of_another_size_is_named():
    table = ocp.FromArrays([0.0, 2.0], {ocp.Quantity("z"): [[1.0, 1.0]] * 2})
    phases = ocp.Motion(ocp.Phase("a", "fall", 0.4), reference=table)
    with pytest.raises(ShapeError, match=r"term 'track z' .* target has the wrong size - got 2 entries, expected 1"):
        ocp.Horizon(balls.problem(phases, balls.ball().over(0.1, dt=0.01)))


def test_impulses_that_a_reference_gives_are_targets_of_a_landing():
    body = models.WholeBody(models.load("mini_cheetah"))
    standing = {
        base.position: [0, 0, 0.27], base.orientation: [1.0, 0, 0, 0], joints.position: body.robot.pose("stand"),
        feet.impulse: [0.0, 0.0, 1.0] * 4,
    }  # fmt: skip
    table = ocp.FromArrays([0.0, 2.0], {quantity: [value, value] for quantity, value in standing.items()})
    stands = stance("FL FR HL HR")
    flown = ocp.Motion(
        ocp.Phase("a", stands, 0.06), ocp.Phase("f", stance(""), 0.06), ocp.Phase("l", stands, 0.2), reference=table
    )
    objective = ocp.Objective(
        ocp.track(base.position, weight=30.0), ocp.track(base.orientation, weight=5.0),
        ocp.track(joints.position, weight=1.0), ocp.regularize(joints.torque, weight=0.02),
        ocp.track(feet.impulse, weight=0.1, at="phase_end"),
    )  # fmt: skip
    declared = ocp.Problem(flown, body.over(0.12, dt=0.01), objective, initial=body.state(joints="stand"))
    horizon = ocp.Horizon(declared)
    x = np.array(declared.initial)
    got = horizon.at(horizon.begin(x, 0.05), x)
    expected = ocp.compile_problem(declared, 0.05, checks=False)
    for own, other in zip(got.phases, expected.phases, strict=True):
        assert np.allclose(own.p_transition, other.p_transition, atol=1e-12)
