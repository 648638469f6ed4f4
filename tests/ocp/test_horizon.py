"""The horizon at any time equals the compiler's result, and has the same numbers after an hour."""

from functools import lru_cache
from itertools import pairwise
from math import pi

import numpy as np
import pytest

from piaffe import models, ocp
from piaffe.errors import ProblemError, ShapeError, UnknownNameError
from piaffe.models import base, feet, joints, stance
from piaffe.ocp.compiler.timeline import horizon_phases
from piaffe.ocp.horizon.calendar import Calendar
from piaffe.ocp.horizon.spans import SpanLayout

ARRAYS = (
    "times", "p", "p_end", "weight", "g_mask", "h_mask", "end_weight", "end_g_mask", "end_h_mask", "p_transition",
    "guess_states",
)  # fmt: skip
PLAIN = ("name", "label", "dt", "ends_phase", "resets", "lands", "mode", "transition")


@lru_cache(maxsize=1)
def quadruped():
    robot = models.load("mini_cheetah")
    return models.WholeBody(robot), models.SingleRigidBody(robot)


@lru_cache(maxsize=2)
def terms(spins=False):
    """Terms at nodes, at phases' ends, at the end, at landings, and with another weight in one phase."""
    objective = ocp.Objective(
        ocp.track(base.position, weight=(0, 1, 30)),
        ocp.track(base.orientation, weight=ocp.by_phase((5, 2, 2), spin=(1, 2, 3)) if spins else (5, 2, 2)),
        ocp.track(base.linear_velocity, weight=1.0),
        ocp.track(joints.position, weight=0.1),
        ocp.track(joints.velocity, weight=0.05),
        ocp.regularize(joints.torque, weight=0.05),
        ocp.track(base.position, weight=(0, 1, 50), at="phase_end"),
        ocp.track(base.linear_velocity, weight=2.0, at="end"),
        models.soft_landing(weight=0.3),
    )
    limits = ocp.Constraints(
        models.friction_cone(mu=0.6, impulses=True), models.torque_limits(), models.base_height(minimum=0.13),
        models.foot_clearance(minimum=0.0),
    )  # fmt: skip
    return objective, limits, ocp.regularize(feet.force, weight=0.01)


def turning_jump(first=0.12, flight=0.2):
    """Stand, fly with a turn to a place ahead, stand."""
    return ocp.Motion(
        ocp.Phase("push", stance("FL FR HL HR"), first, ocp.Keyframe(position=(0.05, 0, 0.3), rpy=(0, 0, 0.1))),
        ocp.Phase("lean", stance("HL HR"), 0.06, ocp.Keyframe(position=(0.1, 0, 0.32), rpy=(0, -0.2, 0.2))),
        ocp.Phase("spin", stance(""), flight, ocp.Keyframe(position=(0.3, 0.1, 0.28), rpy=(0, 0, 1.2))),
        ocp.Phase("land", stance("FL FR HL HR"), 0.2, ocp.Keyframe(position=(0.3, 0.1, 0.25), rpy=(0, 0, pi / 2))),
    )


def problem(motion, head=0.2, tail=0.3):
    body, srb = quadruped()
    objective, limits, effort = terms(any(phase.name == "spin" for phase in motion.pieces[0].phases))
    schedule = body.over(head, dt=0.01)
    if tail:
        schedule = schedule.without(effort) + srb.over(tail, dt=0.05).without(limits)
        objective = objective + effort
    return ocp.Problem(motion, schedule, objective, limits, initial=body.state(joints="stand"))


def on_path(horizon, t):
    """The state on the declared path."""
    path, model = horizon._compilation.path, horizon.models[0]
    sample = path.sample(t, path.interval_at(t))
    return model.state.np_normalise(model.state.pack({b.quantity: sample[b.quantity] for b in model.state.blocks}))


def assert_same(got, expected, tolerance=1e-12):
    assert len(got.phases) == len(expected.phases)
    for own, other in zip(got.phases, expected.phases, strict=True):
        assert [getattr(own, name) for name in PLAIN] == [getattr(other, name) for name in PLAIN]
        for name in ARRAYS:
            a, b = getattr(own, name), getattr(other, name)
            assert a.shape == b.shape, name
            assert np.abs(a - b).max(initial=0.0) < tolerance, (own.name, name)


@pytest.mark.parametrize("tail", [0.0, 0.3])
def test_equals_the_compiler_at_every_time_of_a_motion_with_keyframes(tail):
    declared = problem(turning_jump(), head=0.1, tail=tail)
    horizon = ocp.Horizon(declared)
    for k in range(58 - round(100 * (0.1 + tail)) + 1):
        t = 0.01 * k
        x = on_path(horizon, t)
        course = horizon.begin(x, t)
        assert np.allclose(course.anchor, 0, atol=1e-12)  # the path begins where the robot is
        got = horizon.at(course, x)
        expected = ocp.compile_problem(declared, t, checks=False)
        assert_same(got, expected.with_start(x))


def test_the_horizon_becomes_shorter_at_the_motions_end():
    declared = problem(turning_jump(), head=0.2, tail=0.3)
    horizon = ocp.Horizon(declared)
    at = {t: horizon.at(horizon.begin(on_path(horizon, t), t), on_path(horizon, t)) for t in (0.3, 0.5, 0.57)}
    assert [sum(p.num_stages for p in c.phases if p.dt == 0.01) for c in at.values()] == [20, 8, 1]
    assert [sum(p.num_stages for p in c.phases if p.dt == 0.05) for c in at.values()] == [1, 0, 0]
    last = at[0.57].phases[-1]
    assert last.transition is None
    assert last.ends_phase
    ends = ocp.compile_problem(problem(turning_jump(), head=0.58, tail=0), 0.0, checks=False).phases[-1]
    assert np.array_equal(np.sort(last.end_weight)[-3:], np.sort(ends.end_weight)[-3:])


@pytest.mark.parametrize("gait", ["bound", "walk", "flying_trot"])
def test_equals_the_compiler_at_the_start_of_a_gait(gait):
    motion = getattr(models.gaits, gait)(speed=0.4, yaw_rate=0.3, lateral_speed=0.1)
    declared = problem(motion, head=0.3, tail=0.5)
    horizon = ocp.Horizon(declared)
    got = horizon.at(horizon.begin(declared.initial, 0.0), declared.initial)
    assert_same(got, ocp.compile_problem(declared, 0.0, checks=False), 1e-9)


@pytest.mark.parametrize("t", [0.0, 0.1, 0.18, 0.3, 0.42, 0.5])
def test_a_gait_follows_keyframes_where_they_end(t):
    declared = problem(turning_jump() + models.gaits.trot(speed=0.4, yaw_rate=-0.3), head=0.3, tail=0.5)
    horizon = ocp.Horizon(declared)
    x = on_path(horizon, t)
    expected = ocp.compile_problem(declared, t, checks=False)
    assert_same(horizon.at(horizon.begin(x, t), x), expected.with_start(x), 1e-9)


def moved(horizon, x, motion):
    return horizon.courses.moved(x, motion)


@pytest.mark.parametrize("t", [0.0, 0.2, 0.45])
def test_the_numbers_do_not_depend_on_where_the_robot_is(t):
    declared = problem(turning_jump() + models.gaits.trot(speed=0.4), head=0.3, tail=0.5)
    horizon = ocp.Horizon(declared)
    x, frame = on_path(horizon, t), (3.0, -7.0, 2.5)
    here, there = horizon.begin(x, t), horizon.begin(moved(horizon, x, frame), t)
    assert np.allclose(there.anchor[:2], frame[:2])
    assert np.cos(there.anchor[2] - frame[2]) == pytest.approx(1.0)
    local = horizon.local(there, moved(horizon, x, frame))
    assert np.allclose(np.abs(local), np.abs(horizon.local(here, x)), atol=1e-12)
    assert_same(horizon.at(there, local), horizon.at(here, local), 1e-9)


def test_a_gait_has_the_same_numbers_after_an_hour():
    declared = problem(models.gaits.trot(speed=0.5, yaw_rate=0.2), head=0.25, tail=0.5)
    horizon = ocp.Horizon(declared)
    x = np.array(declared.initial)
    early = horizon.at(horizon.begin(x, 1.55), x)
    late = horizon.at(horizon.begin(x, 1.55 + 3600.0), x)
    for own, other in zip(late.phases, early.phases, strict=True):
        assert own.interval.index - other.interval.index == 3600 / 0.5 * 2
        for name in ARRAYS[1:]:
            assert np.abs(getattr(own, name) - getattr(other, name)).max(initial=0.0) < 1e-9, name
        assert np.allclose(own.times - other.times, 3600.0)


def test_the_reference_is_anchored_again_and_again():
    declared = problem(models.gaits.trot(speed=0.5), head=0.25, tail=0.5)
    horizon = ocp.Horizon(declared)
    space, rng = horizon.models[0].state, np.random.default_rng(3)
    x = np.array(declared.initial)
    course = horizon.begin(x, 0.0)
    for k in range(1, 400):
        x = space.np_plus(x, 0.02 * np.r_[0.5, 0.1, 0, 0, 0, 0.4, np.zeros(30)] + 1e-3 * rng.standard_normal(36))
        x[2] = 0.27
        before = course
        course = horizon.advance(course, x, 0.02 * k)
        local = horizon.local(course, x)
        assert np.allclose(local[:2], 0, atol=1e-12)
        assert abs(ocp.rotation.np_to_rpy(local[3:7])[2]) < 1e-12
        again = horizon.courses.moved(horizon.local(before, x), course.moved)
        assert np.allclose(again, local, atol=1e-9)
    assert np.abs(course.memory).max() < 10
    got = horizon.at(course, local)
    assert all(np.all(np.isfinite(phase.p)) for phase in got.phases)


def test_a_cycle_of_keyframes_repeats_with_its_motion_in_the_plane():
    motion = ocp.Motion(
        ocp.Phase("a", stance("FL FR HL HR"), 0.1, ocp.Keyframe(position=(0.1, 0, 0.27), rpy=(0, 0, 0.15))),
        ocp.Phase("b", stance("FL FR HL HR"), 0.1, ocp.Keyframe(position=(0.2, 0.1, 0.27), rpy=(0, 0, 0.25))),
        cyclic=True,
    )
    declared = problem(motion, head=0.25, tail=0)
    horizon = ocp.Horizon(declared)
    t, x = 0.15, on_path(horizon, 0.15)
    course = horizon.begin(x, t)
    for k in range(16, 120):
        course = horizon.advance(course, x, 0.01 * k)
    expected = ocp.compile_problem(declared, 1.19, checks=False)
    assert_same(horizon.at(course, x), expected.with_start(x), 1e-7)


def test_targets_that_do_not_repeat_are_refused():
    table = ocp.FromArrays([0.0, 2.0], {base.position: [[0, 0, 0.2], [0, 0, 0.3]]})
    motion = ocp.Motion(ocp.Phase("a", stance("FL FR HL HR"), 0.1), cyclic=True, reference=table)
    with pytest.raises(ProblemError, match=r"phase 'a' .*: its targets do not repeat - got a difference of 0\.005"):
        ocp.Horizon(problem(motion, head=0.25, tail=0))


def test_parts_of_random_horizons_are_those_of_the_compiler():
    rng = np.random.default_rng(11)
    body, srb = quadruped()
    for _ in range(25):
        feet_of = ("FL FR HL HR", "FL HR", "FR HL", "", "HL HR")
        phases = [ocp.Phase(f"p{i}", stance(feet_of[rng.integers(5)]), 0.01 * rng.integers(1, 12)) for i in range(6)]
        cyclic = bool(rng.integers(2))
        motion = ocp.Motion(*phases, cyclic=cyclic)
        head, tail = 0.01 * rng.integers(5, 20), 0.05 * rng.integers(1, 4)
        schedule = body.over(head, dt=0.01) + srb.over(tail, dt=0.05)
        declared = ocp.Problem(motion, schedule, terms()[0] + terms()[2], initial=body.state(joints="stand"))
        calendar = Calendar(motion.pieces, schedule)
        layout = SpanLayout(calendar, schedule)
        path = motion.bind((body, srb), body.state.unpack(declared.initial))
        total = 3.0 if cyclic else motion.duration - head - tail
        for k in range(0, round(100 * total) + 1, 3):
            if total < 0:
                break
            expected = horizon_phases(path, schedule, 0.01 * k)
            for own, other in zip(layout.at(k * calendar.steps[0]), expected, strict=True):
                place = own.place
                assert (own.stages, own.ends) == (other.num_stages, other.ends_phase)
                assert own.first * calendar.tick == pytest.approx(other.start, abs=1e-9)
                assert (calendar.index(place), calendar.entries[place.entry].phase) == (
                    other.interval.index, other.interval.phase,
                )  # fmt: skip
                assert place.start * calendar.tick == pytest.approx(other.interval.start, abs=1e-9)


def test_places_follow_one_another_without_end():
    schedule = quadruped()[0].over(0.1, dt=0.01)
    motion = models.gaits.walk(speed=0.3)
    calendar = Calendar(motion.pieces, schedule)
    place = calendar.at(0)
    places = [place]
    for _ in range(100):
        places.append(calendar.next(places[-1]))
    for before, after in pairwise(places):
        assert calendar.at(after.start) == after
        assert calendar.at(after.start - 1) == before
        assert calendar.previous(after) == before.entry
        assert after.start - before.start == calendar.entries[before.entry].length


@pytest.mark.parametrize(
    ("call", "error", "text"),
    [
        (lambda h, x: h.begin(x, -0.01), ProblemError, r"time is outside the motion - got t = -0.01 s"),
        (lambda h, x: h.begin(x, 0.58), ProblemError, r"expected 0 ≤ t ≤ 0.57 s; stop the controller there"),
        (lambda h, x: h.begin(x, np.nan), ProblemError, r"time is outside the motion - got t = nan"),
        (lambda h, x: h.begin(x[:-1], 0.0), ShapeError, r"wrong size - got shape \(36,\), expected \(37,\)"),
        (lambda h, x: h.begin(x * np.nan, 0.0), ProblemError, r"state is not finite - got nan in 'base.position x'"),
        (lambda h, x: h.begin(x, 0.0, {"speed": 1.0}), UnknownNameError, r"horizon: no command 'speed'"),
        (lambda h, x: h.advance(h.begin(x, 0.2), x, 0.1), ProblemError, r"time goes back - got 0.1 s after 0.2 s"),
    ],
)
def test_errors_of_calls(call, error, text):
    horizon = ocp.Horizon(problem(turning_jump(), head=0.1, tail=0.0))
    with pytest.raises(error, match=text):
        call(horizon, np.array(horizon.problem.initial))


def test_commands_are_checked():
    horizon = ocp.Horizon(problem(models.gaits.trot(speed=0.5)))
    assert horizon.commands["speed"] == 0.5
    with pytest.raises(ProblemError, match=r"command 'speed': is not finite - got nan"):
        horizon.begin(horizon.problem.initial, 0.0, {"speed": float("nan")})


def test_time_steps_that_do_not_fit_are_refused():
    body, srb = quadruped()
    objective, _, effort = terms()

    def declared(motion, schedule):
        return ocp.Problem(motion, schedule, objective + effort, initial=body.state(joints="stand"))

    with pytest.raises(ProblemError, match=r"phase 'push' .*: not a whole number of steps"):
        ocp.Horizon(declared(turning_jump(first=0.125), body.over(0.1, dt=0.01)))
    with pytest.raises(ProblemError, match=r"time steps have no common divisor - got 0.01, 0.0314159"):
        ocp.Horizon(declared(turning_jump(), body.over(0.1, dt=0.01) + srb.over(0.01 * pi, dt=0.01 * pi)))
    with pytest.raises(ProblemError, match=r"the motion never ends - got until_end"):
        ocp.Horizon(declared(models.gaits.trot(), body.until_end(dt=0.01)))
    with pytest.raises(
        ProblemError, match=r"its phases move by the steps of the models before it - got dt 0.02 s after 0.01 s"
    ):
        ocp.Horizon(declared(turning_jump(), body.over(0.1, dt=0.01) + body.over(0.1, dt=0.02)))
