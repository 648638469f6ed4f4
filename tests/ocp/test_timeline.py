"""One time axis for a motion's phases, a schedule's segments and the horizon: who is cut where, and by what."""

import numpy as np
import pytest

from piaffe import models, ocp
from piaffe.errors import ProblemError
from piaffe.models import base, feet, joints, stance
from piaffe.ocp.compiler.timeline import covers, horizon_phases, whole_steps


def still(s):
    return {"z": s.push}


class Uncut(ocp.Model):
    """A model that no change of mode cuts, as a single rigid body."""

    def __init__(self, name):
        super().__init__(name, state={"z": 1}, control={"push": 1}, modes=dict.fromkeys("abc", still))
        object.__setattr__(self, "cut_by_modes", False)


CUT = ocp.Model("cut", state={"z": 1}, control={"push": 1}, modes=dict.fromkeys("abc", still))
UNCUT = Uncut("uncut")
MOTION = ocp.Motion(ocp.Phase("one", "a", 0.2), ocp.Phase("two", "b", 0.1), ocp.Phase("three", "c", 0.3))
ENDLESS = ocp.Motion(ocp.Phase("one", "a", 0.2), ocp.Phase("two", "b", 0.1), cyclic=True)


def spans(motion, schedule, t0=0.0):
    model = schedule.segments[0].model
    return horizon_phases(motion.bind((model,), {b.quantity: np.zeros(1) for b in model.state.blocks}), schedule, t0)


def laid(motion, schedule, t0=0.0):
    return [
        (s.segment.model.name, s.interval.phase.name, round(s.start, 6), s.num_stages, s.ends_phase)
        for s in spans(motion, schedule, t0)
    ]


def test_a_model_is_cut_where_modes_change():
    assert laid(MOTION, CUT.until_end(dt=0.01)) == [
        ("cut", "one", 0.0, 20, True), ("cut", "two", 0.2, 10, True), ("cut", "three", 0.3, 30, True),
    ]  # fmt: skip


def test_a_model_that_modes_do_not_cut_has_one_phase():
    assert laid(MOTION, UNCUT.until_end(dt=0.05)) == [("uncut", "one", 0.0, 12, True)]
    (only,) = spans(MOTION, UNCUT.until_end(dt=0.05))
    placed = list(MOTION.intervals())
    assert [only.interval_at(t, placed).phase.name for t in (0.0, 0.15, 0.2, 0.25, 0.3)] == [
        "one",
        "one",
        "two",
        "two",
        "three",
    ]


def test_a_boundary_belongs_to_the_later_phase():
    path = MOTION.bind((CUT,), {b.quantity: np.zeros(1) for b in CUT.state.blocks})
    assert path.interval_at(0.2).phase.name == "two"
    assert path.interval_before(0.2).phase.name == "one"


@pytest.mark.parametrize("shift", [-0.9, -0.4, 0.0, 0.4, 0.9])
def test_times_that_differ_by_rounding_are_the_same(shift):
    """The path, the references and the timeline read one constant, so that they agree about a boundary."""
    off = shift * ocp.SAME_TIME
    path = MOTION.bind((CUT,), {b.quantity: np.zeros(1) for b in CUT.state.blocks})
    assert path.interval_at(0.2 + off).phase.name == "two"
    assert path.interval_before(0.2 + off).phase.name == "one"
    assert whole_steps(0.2 + off, 0.01, "here") == 20
    (only,) = spans(MOTION, UNCUT.until_end(dt=0.05))
    assert only.interval_at(0.2 + off, list(MOTION.intervals())).phase.name == "two"
    assert laid(MOTION, CUT.over(0.2 + off, dt=0.01)) == [("cut", "one", 0.0, 20, True)]


def test_a_time_further_off_is_another():
    path = MOTION.bind((CUT,), {b.quantity: np.zeros(1) for b in CUT.state.blocks})
    assert path.interval_at(0.2 - 2 * ocp.SAME_TIME).phase.name == "one"
    with pytest.raises(ProblemError, match="not a whole number of steps"):
        whole_steps(0.2 + 2 * ocp.SAME_TIME, 0.01, "here")


def test_the_horizon_cuts_a_phase_without_ending_it():
    assert laid(MOTION, CUT.over(0.25, dt=0.01)) == [("cut", "one", 0.0, 20, True), ("cut", "two", 0.2, 5, False)]


def test_a_junction_of_two_models_cuts_a_phase_without_ending_it():
    both = CUT.over(0.25, dt=0.01) + UNCUT.over(0.35, dt=0.05)
    assert laid(MOTION, both) == [
        ("cut", "one", 0.0, 20, True), ("cut", "two", 0.2, 5, False), ("uncut", "two", 0.25, 7, True),
    ]  # fmt: skip


def test_a_junction_on_a_boundary_ends_the_phase_and_knows_what_follows():
    first, second = spans(MOTION, CUT.over(0.2, dt=0.01) + UNCUT.over(0.1, dt=0.05))
    assert first.ends_phase
    assert first.following.phase.name == "two"
    assert second.following.phase.name == "three"


def test_a_phase_of_one_step_follows_the_one_before():
    brief = ocp.Motion(ocp.Phase("one", "a", 0.2), ocp.Phase("two", "b", 0.05), ocp.Phase("three", "c", 0.3))
    first, second, third = spans(brief, CUT.until_end(dt=0.05))
    assert (first.following.phase.name, second.following.phase.name, third.following) == ("two", "three", None)
    assert second.num_stages == 1


def test_the_end_of_the_motion_is_followed_by_nothing():
    assert spans(MOTION, CUT.until_end(dt=0.1))[-1].following is None


@pytest.mark.parametrize(
    ("t0", "first", "stages"), [(0.0, 0.0, 20), (0.004, 0.0, 20), (0.006, 0.01, 19), (0.2, 0.2, 10)]
)
def test_the_start_snaps_to_the_first_model_s_step(t0, first, stages):
    span = spans(MOTION, CUT.over(0.3, dt=0.01), t0)[0]
    assert span.start == pytest.approx(first)
    assert span.num_stages == stages


def test_a_start_outside_the_motion():
    with pytest.raises(
        ProblemError, match=r"horizon: start is outside the motion - got t0 = 0\.6 s, expected 0 ≤ t0 < 0\.6 s"
    ):
        laid(MOTION, CUT.over(0.1, dt=0.01), 0.6)


def test_a_horizon_runs_on_through_the_cycles():
    assert laid(ENDLESS, CUT.over(0.4, dt=0.02), 0.5) == [
        ("cut", "two", 0.5, 5, True), ("cut", "one", 0.6, 10, True), ("cut", "two", 0.8, 5, True),
    ]  # fmt: skip
    far = laid(ENDLESS, CUT.over(0.3, dt=0.02), 30.0)
    assert [(name, stages) for _, name, _, stages, _ in far] == [("one", 10), ("two", 5)]


def test_an_endless_motion_has_no_end_to_run_until():
    with pytest.raises(
        ProblemError,
        match=r"the motion never ends - got until_end on a cyclic motion, expected a finite one",
    ):
        laid(ENDLESS, CUT.until_end(dt=0.01))


def test_a_horizon_longer_than_the_motion():
    with pytest.raises(
        ProblemError,
        match=r"model 'cut': the horizon is longer than the motion - got 0\.7 s, expected at most 0\.6 s",
    ):
        laid(MOTION, CUT.over(0.7, dt=0.01))


def test_nothing_follows_a_segment_that_runs_until_the_end():
    with pytest.raises(
        ProblemError, match=r"nothing can follow a segment that runs until the end - got 'uncut' after 'cut'\.until_end"
    ):
        CUT.until_end(dt=0.01) + UNCUT.over(0.1, dt=0.05)


@pytest.mark.parametrize(("duration", "dt"), [(0.0, 0.01), (-1.0, 0.01), (0.1, 0.0), (0.1, float("inf"))])
def test_durations_and_steps_are_positive(duration, dt):
    with pytest.raises(ProblemError, match=r"schedule \(.*\), model 'cut': (dt|duration) is out of range - got"):
        CUT.over(duration, dt=dt)


@pytest.mark.parametrize(
    ("length", "dt", "choices"), [(0.125, 0.01, "0.12 or 0.13"), (0.05, 0.04, "0.04 or 0.08"), (0.004, 0.01, "0.01")]
)
def test_a_fraction_of_a_step_names_the_nearest_choices(length, dt, choices):
    with pytest.raises(
        ProblemError, match=rf"here: not a whole number of steps - got {length} s with dt {dt} s, expected {choices} s"
    ):
        whole_steps(length, dt, "here")


def test_rounding_is_no_fraction_of_a_step():
    assert whole_steps(0.1 + 0.2, 0.1, "here") == 3
    assert whole_steps(0.42, 0.01, "here") == 42


def test_whether_a_horizon_covers_the_motion():
    assert covers(MOTION, spans(MOTION, CUT.until_end(dt=0.01)))
    assert not covers(MOTION, spans(MOTION, CUT.over(0.5, dt=0.01)))
    assert not covers(MOTION, spans(MOTION, CUT.over(0.5, dt=0.01), 0.1))
    assert covers(ENDLESS, spans(ENDLESS, CUT.over(0.3, dt=0.01)))


def test_the_last_node_of_an_uncut_model_ends_the_phase_before_a_boundary():
    """Its stages are the later phase's from the boundary on, its last node is the earlier one's."""
    weights = ocp.by_phase(0.0, one=3.0, two=5.0)
    objective = ocp.Objective(
        ocp.regularize("push"), ocp.track("z", weights, to=0.0), ocp.track("z", weights, to=0.0, at="phase_end")
    )
    schedule = UNCUT.over(0.2, dt=0.05) + UNCUT.over(0.1, dt=0.05)
    first, second = ocp.compile_problem(ocp.Problem(MOTION, schedule, objective, initial=[0.0])).phases
    assert (first.weight[:, 1].tolist(), first.end_weight.tolist()) == ([3, 3, 3, 3], [3])
    assert (second.weight[:, 1].tolist(), second.end_weight.tolist()) == ([5, 5], [5])


# ---- a robot with two models


STEPS = ocp.Motion(
    ocp.Phase("stand", stance("FL FR HL HR"), 0.1),
    ocp.Phase("left", stance("FL HR"), 0.1),
    ocp.Phase("right", stance("FR HL"), 0.1),
    ocp.Phase("again", stance("FL HR"), 0.1),
)


@pytest.fixture(scope="module")
def cascade():
    """Standing, one diagonal pair, the other; whole body until the first touchdown, then a single rigid body."""
    robot = models.load("mini_cheetah")
    body, srb = models.WholeBody(robot), models.SingleRigidBody(robot)
    objective = ocp.Objective(
        ocp.track(base.position), ocp.regularize(joints.torque, 0.1), ocp.regularize(feet.force, weight=0.01)
    )
    problem = ocp.Problem(STEPS, body.over(0.2, dt=0.02) + srb.over(0.2, dt=0.05), objective, initial=body.state())
    return ocp.compile_problem(problem)


def slot(phase, name, p):
    return p[..., phase.mode.layout.slots[name]]


def test_a_rigid_body_takes_each_stage_s_own_contacts(cascade):
    *_, tail = cascade.phases
    assert [phase.label for phase in cascade.phases] == ["FL FR HL HR", "FL HR", "scheduled"]
    flags = slot(tail, "contact", tail.p)
    assert flags.tolist() == [
        [0, 1, 1, 0],
        [0, 1, 1, 0],
        [1, 0, 0, 1],
        [1, 0, 0, 1],
    ]  # the boundary at 0.3 s is the later's
    assert slot(tail, "contact", tail.p_end).tolist() == [1, 0, 0, 1]


def test_a_touchdown_at_the_junction_belongs_to_the_model_before_it(cascade):
    left, tail = cascade.phases[1:]
    assert slot(left, "landing", left.p_end).tolist() == [0, 1, 1, 0]
    assert not slot(left, "landing", left.p).any()
    assert left.end_h_mask.tolist() == [0, 1, 1, 0]
    assert left.resets
    assert left.transition.target is tail.mode.model
    impact = left.p_transition[left.transition.layout.slots["landing"]]
    assert impact.tolist() == [0, 1, 1, 0]


def test_at_the_horizon_s_end_a_touchdown_leaves_its_equality(cascade):
    body = cascade.phases[0].mode.model
    problem = ocp.Problem(
        STEPS,
        body.over(0.2, dt=0.02),
        ocp.Objective(ocp.regularize(joints.torque)),
        initial=cascade.initial,
    )
    last = ocp.compile_problem(problem).phases[-1]
    assert last.end_h_mask.tolist() == [0, 1, 1, 0]
    assert last.transition is None


def test_lifting_a_foot_is_no_touchdown(cascade):
    stand = cascade.phases[0]
    assert not stand.end_h_mask.any()
    assert not stand.resets


@pytest.mark.parametrize(("integrator", "nodes"), [("midpoint", 1), ("semi_implicit", 1), ("euler", 2)])
def test_feet_lift_while_their_place_depends_on_the_stance_alone(integrator, nodes):
    body = models.WholeBody(models.load("mini_cheetah"), integrator=integrator)
    objective = ocp.Objective(ocp.regularize(joints.torque))
    problem = ocp.Problem(STEPS, body.over(0.2, dt=0.02), objective, initial=body.state(joints="stand"))
    compiled = ocp.compile_problem(problem)
    stand, left = compiled.phases
    assert not slot(stand, "lifting", stand.p).any()
    assert slot(left, "lifting", left.p).tolist() == [[0, 1, 1, 0]] * nodes + [[0] * 4] * (5 - nodes)
    assert not slot(left, "lifting", left.p_end).any()
    # a swing that differs in its first control alone
    x = left.guess_states[0]
    for steps in range(3):
        ends = []
        for u in (np.zeros(12), np.full(12, 3.0)):
            y = x
            for _ in range(steps):
                y = body.step(y, u, "FL HR", left.dt)
            ends.append(body.foot_positions(y)[[1, 2]])
        assert np.allclose(*ends, rtol=0, atol=1e-12) == (steps < nodes)


def test_a_transition_has_the_time_step_of_the_model_that_ends(cascade):
    stand, left, tail = cascade.phases
    assert tail.dt == 0.05
    for phase in (stand, left):
        assert phase.p_transition[phase.transition.layout.slices[ocp.ParameterKey("dt")]].tolist() == [0.02]
