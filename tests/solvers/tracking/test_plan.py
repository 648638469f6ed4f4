"""Plans that are followed: arrays are referred to, tails are left out, several models share a low level."""

import gc
import re
from dataclasses import replace

import numpy as np
import pytest

from piaffe import ocp
from piaffe.errors import ShapeError, SolverError
from piaffe.solvers import FeedforwardPD, JointPD, MeasuredContacts, MSiLQR, Riccati, SolvedPlan, Vwbc
from piaffe.solvers.tracking import PlanMemory, modes_of, stage_at
from tests.problems import Rope, bouncing_ball, rope, swing_up
from tests.solvers.tracking.test_native import compare, pair
from tests.solvers.tracking.test_tracking import OneStage, bounded, plan_of, pushed, standing

ARRAYS = ("times", "states", "controls", "feedback", "Q_u", "Q_ux", "Q_uu", "p", "g_mask", "h_mask")


class Joined:
    """Plans one after the other."""

    def __init__(self, *plans):
        self._plans, start, self.phases = plans, 0.0, ()
        for plan in plans:
            begin = start - plan.phases[0].times[0]
            self.phases += tuple(replace(phase, times=phase.times + begin) for phase in plan.phases)
            start = self.phases[-1].times[-1]

    def row_name(self, mode, kind, row):
        owner = next(plan for plan in self._plans if mode in modes_of(plan))
        return owner.row_name(mode, kind, row)


def changed(plan, **arrays):
    """Return a plan of one phase with other arrays."""
    other = Joined(plan)
    other.phases = (replace(plan.phases[0], **arrays),)
    return other


def heavy():
    """A mass on a rail with other dynamics, other rows and more parameters than that of ``bounded``."""
    drag = ocp.parameter("drag", 0.3)
    mass = ocp.Model(
        "heavy mass", state={"place": 1, "speed": 1}, control={"force": 1},
        modes={"drag": lambda s: {"place": s.speed, "speed": 0.5 * s.force - drag * s.speed}},
    )  # fmt: skip
    limits = ocp.Constraints(
        ocp.inequality(lambda s: s.force, lower=-5, upper=5, name="small force", unit="N"),
        ocp.inequality(lambda s: 4.0 - s.force - s.speed, lower=0.0, name="motor", unit="N"),
    )
    objective = ocp.Objective(ocp.track("place", 20.0), ocp.regularize("force", 0.01))
    motion = ocp.Motion(ocp.Phase("drag", "drag", 0.3, {"place": 1.0}))
    return ocp.Problem(motion, mass.until_end(dt=0.05), objective, limits, initial=[0.0, 0.0])


# ---- arrays


def test_a_followed_plan_is_referred_to_and_kept_alive():
    _, compiled, x, u = standing()
    controller, state = Vwbc(OneStage(compiled, x, u)), pushed(compiled, x, 0.05)
    made = OneStage(compiled, x, u, Q_u=np.ones(12))
    other = changed(made, **{name: getattr(made.phases[0], name).copy() for name in ARRAYS})
    expected, shared = Vwbc(other, backend="numpy").control(state, 0.0), other.phases[0].controls
    controller.follow(other)
    del other, made
    gc.collect()
    np.testing.assert_allclose(controller.control(state, 0.0), expected, atol=1e-9)
    shared += 0.01  # not allowed to users; it shows that nothing was copied
    assert np.abs(controller.control(state, 0.0) - expected).max() > 1e-4


def test_arrays_in_another_order_or_type_are_copied_and_kept():
    _, compiled, x, u = standing()
    plan = OneStage(compiled, x, u.astype(np.float32).astype(float))
    phase, state = plan.phases[0], pushed(compiled, x, 0.05)
    expected, controller = Vwbc(plan).control(state, 0.0), Vwbc(plan)
    spread = np.zeros((1, 12, 72))
    spread[..., ::2] = phase.feedback
    fixed = phase.Q_uu.copy()
    fixed.flags.writeable = False
    given = {
        "Q_ux": np.asfortranarray(phase.Q_ux[0])[None], "feedback": spread[..., ::2], "Q_uu": fixed,
        "controls": phase.controls.astype(np.float32), "Q_u": np.zeros((1, 12), np.int8),
    }  # fmt: skip
    assert not given["Q_ux"].flags.c_contiguous
    controller.follow(changed(plan, **given))
    given.clear()
    del spread, fixed
    controller.plan = plan  # the memory alone keeps what it refers to
    gc.collect()
    filled = [np.full(size, np.nan) for size in (12, 24, 144, 432, 864) for _ in range(200)]  # takes what was freed
    np.testing.assert_array_equal(controller.control(state, 0.0), expected)
    assert len(filled) == 1000


@pytest.mark.parametrize("name", ARRAYS[:-1])
def test_an_array_of_another_size_is_refused_and_the_plan_before_stays(name):
    _, compiled, x, u = standing()
    plan, state = OneStage(compiled, x, u), pushed(compiled, x, 0.05)
    controller = Vwbc(plan)
    expected, given = controller.control(state, 0.0), getattr(plan.phases[0], name)
    wrong = changed(plan, **{name: np.concatenate([given, given])})
    message = f"plan, phase of model 'mini_cheetah', {'times' if name == 'controls' else name}: wrong size - got "
    with pytest.raises(ShapeError, match=re.escape(message)):
        controller.follow(wrong)
    assert controller.plan is plan
    np.testing.assert_array_equal(controller.control(state, 0.0), expected)


def test_plans_with_more_and_fewer_phases_follow_each_other():
    ball, rng = plan_of(bouncing_ball), np.random.default_rng(0)
    twins = pair(ball)
    for count in (1, 7, 2, 40, 1):
        plan = Joined(*[ball] * count)
        for each in twins:
            each.follow(plan)
        for t in rng.uniform(0.0, plan.phases[-1].times[-1] + 0.1, 20):
            compare(twins, stage_at(plan, t).x + 0.1 * rng.standard_normal(2), t)


@pytest.mark.parametrize("make", [Riccati, FeedforwardPD])
def test_the_baselines_follow_another_plan(make):
    _, compiled, x, u = standing()
    controller, state = make(OneStage(compiled, x, u)), pushed(compiled, x, 0.05)
    before, other = controller.control(state, 0.0), OneStage(compiled, x, 0.5 * u)
    controller.follow(other)
    np.testing.assert_array_equal(controller.control(state, 0.0), make(other).control(state, 0.0))
    assert np.abs(before - controller.control(state, 0.0)).max() > 0.1
    with pytest.raises(SolverError, match=f"{make.__name__}: the plan has other modes - got 'ball' fall, expected mod"):
        controller.follow(plan_of(bouncing_ball))
    assert controller.plan is other


class InMemory:
    """A plan that lies in memory already, with modes in an order of its own."""

    def __init__(self, plan, modes):
        self.modes, self._memory, self._plan = modes, PlanMemory(modes), plan
        self._memory.hold(plan.phases)
        self.address, self.phases, self.row_name = self._memory.address, plan.phases, plan.row_name


def test_a_plan_that_lies_in_memory_is_read_there():
    first, second = plan_of(bounded), plan_of(heavy)
    modes = (*modes_of(second), *modes_of(first))
    controller = Vwbc(InMemory(first, modes))  # the second model comes later
    assert len(controller.limits) == 5
    for plan in (first, second, Joined(first, second), first):
        controller.follow(InMemory(plan, modes))
        twin = Vwbc(plan, backend="numpy")
        for t in (0.0, 0.13, 0.52, 0.77):
            np.testing.assert_allclose(controller.control([-1.0, 0.5], t), twin.control([-1.0, 0.5], t), atol=1e-9)


def test_the_memory_of_a_plan_is_not_trusted_if_its_modes_have_another_order():
    first, second = plan_of(bounded), plan_of(heavy)
    modes = (*modes_of(second), *modes_of(first))
    controller = Vwbc(InMemory(first, modes))
    controller.follow(InMemory(first, modes[::-1]))
    assert controller.control([-3.0, 0.0], 0.0) == pytest.approx([20.0])


# ---- tails and several models


@pytest.mark.parametrize("backend", ["native", "numpy"])
@pytest.mark.parametrize("make", [Vwbc, Riccati])
def test_a_tail_of_another_size_is_left_out_and_the_last_stage_is_held(make, backend):
    own, options = plan_of(bounded), {"backend": backend} if make is Vwbc else {}
    with_tail, end = Joined(own, plan_of(swing_up), own), own.phases[-1].times[-1]
    controller, alone = make(with_tail, **options), make(own, **options)
    assert modes_of(with_tail) == modes_of(own)
    for t in (0.0, end - 0.01, end, end + 0.3, 9.0):
        np.testing.assert_array_equal(controller.control([0.9, 0.1], t), alone.control([0.9, 0.1], t))
    last = own.phases[-1]
    held = stage_at(with_tail, end + 0.3)
    np.testing.assert_allclose(held.x, last.states[-1])
    np.testing.assert_array_equal(held.u, last.controls[-1])
    alone.follow(with_tail)
    np.testing.assert_array_equal(controller.control([0.9, 0.1], 9.0), alone.control([0.9, 0.1], 9.0))


def test_two_models_of_one_size_share_a_low_level():
    first, second = plan_of(bounded), plan_of(heavy)
    plan, end = Joined(first, second, first), first.phases[-1].times[-1]
    twins, rng = pair(plan, leave_out=("speed",)), np.random.default_rng(0)
    assert twins[0].limits == ("force limit lower", "force limit upper", "small force lower", "small force upper",
                               "motor lower")  # fmt: skip
    for t in rng.uniform(0.0, plan.phases[-1].times[-1], 300):
        compare(twins, 10.0 ** rng.uniform(-2, 0.5) * rng.standard_normal(2), t)
    assert twins[0].control([-3.0, 0.0], 0.0) == pytest.approx([20.0])
    assert twins[0].last.active == ("force limit upper",)
    assert twins[0].control([-3.0, 0.0], end) == pytest.approx([4.0])
    assert twins[0].last.active == ("motor lower",)
    assert twins[0].control([-3.0, 1.0], end) == pytest.approx([3.0])


class OtherRope(Rope):
    """A rope whose slots lie in another order."""

    def __init__(self):
        base = Rope()
        ocp.ModelBase.__init__(self, "other rope", base.state, base.control, slots=base.slots[::-1])


def swinging(model, *extra):
    """The problem of ``tests.problems.rope`` with another model and further terms."""
    made = rope()
    objective = ocp.Objective(made.objective, *extra)
    return ocp.Problem(made.motion, model.until_end(dt=0.02), objective, made.constraints, initial=made.initial)


def test_models_may_have_other_parameters_in_other_places():
    """Contacts are those of a rope: its slot "taut" flags the tension."""
    problems = swinging(Rope()), swinging(OtherRope(), ocp.track("speed", 0.01), ocp.track("place", 0.1, at="end"))
    compiled = [ocp.compile_problem(problem) for problem in problems]
    plans = [SolvedPlan(MSiLQR(each, backend="numpy").solve(), each) for each in compiled]
    plan, rng = Joined(*plans), np.random.default_rng(0)
    modes = modes_of(plan)
    assert len({mode.layout.size for mode in modes}) == len({mode.layout.slots["taut"].start for mode in modes}) == 2
    gains = JointPD(2.0, 0.1, 3.0, (-1, 0))
    settings = MeasuredContacts(0.01, 0.02, 0.1, 0.05)
    twins = pair(plan, contacts=settings, contact_slot="taut", gains=gains, slots={"mass": 2.5})
    t, flag, end = 0.0, 1.0, plan.phases[-1].times[-1]
    differs = 0
    while t < end:
        t += rng.choice([0.0, 0.005, 0.01])
        flag = 1 - flag if rng.random() < 0.2 else flag
        compare(twins, stage_at(plan, t).x + 0.1 * rng.standard_normal(4), t, (flag,))
        np.testing.assert_array_equal(twins[0].in_contact, twins[1].in_contact)
        differs += twins[0].in_contact[0] != twins[0].contacts(t)[0]
    assert differs > 20
    for each in twins:
        each.measure({"mass": 1.0})
    for t in (0.2, 0.8, 1.2, 1.8):
        compare(twins, stage_at(plan, t).x, t, (1.0,))


def test_models_with_gains_must_all_have_the_joints():
    with pytest.raises(SolverError, match="joint gains, model 'mass': the state has no velocities of the controls"):
        Vwbc(Joined(plan_of(bounded), plan_of(heavy)), gains=JointPD())
