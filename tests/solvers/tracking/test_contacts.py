"""Measured contacts: which points count as in contact, and what follows of it."""

import re
from dataclasses import replace

import numpy as np
import pytest

from piaffe import ocp
from piaffe.errors import ShapeError, SolverError, UnknownNameError
from piaffe.models import WholeBody, load, stance
from piaffe.solvers import FeedforwardPD, JointPD, MeasuredContacts, Riccati, Vwbc
from piaffe.solvers.tracking import contacts_at
from piaffe.solvers.tracking.contacts import ContactFilter, scheduled_soon
from tests.solvers.tracking.test_native import compare, pair
from tests.solvers.tracking.test_tracking import OneStage, bounded, plan_of, pushed, standing

MS = 1e-3
KD = (1.0, 0.5, 0.5) * 4


class Stages:
    """A plan of a standing robot with given contact flags; a stage lasts 10 ms, and a phase has three of them.

    Args:
        flags: per stage, the flags of the feet, as "1001".
    """

    def __init__(self, flags, seed=0):
        _, compiled, x, u = standing()
        one, rng = OneStage(compiled, x, u), np.random.default_rng(seed)
        mode = one.phases[0].mode
        self.row_name, self.phases = one.row_name, ()
        for start in range(0, len(flags), 3):
            own = flags[start : start + 3]
            stages = {
                name: np.repeat(getattr(one.phases[0], name), len(own), axis=0)
                for name in ("controls", "feedback", "Q_u", "Q_ux", "Q_uu", "p")
            }
            stages["p"][:, mode.layout.slots["contact"]] = [[float(c) for c in each] for each in own]
            stages["controls"] += 0.1 * rng.standard_normal(stages["controls"].shape)
            g_mask, h_mask = Vwbc(one, backend="numpy").rows[mode].masks(stages["p"])
            times = 0.01 * (start + np.arange(len(own) + 1))
            self.phases += (
                replace(
                    one.phases[0], times=times, states=np.repeat(x[None], len(own) + 1, axis=0), g_mask=g_mask,
                    h_mask=h_mask, **stages,
                ),
            )  # fmt: skip


def filtered(schedule, measured, early=0, **settings):
    """Return what counts for one point, a character per millisecond."""
    own = ContactFilter(MeasuredContacts(early=early * MS, **settings), 1)
    plan, read = ([float(c) for c in text] for text in (schedule, measured))
    found = []
    for i in range(len(plan)):
        soon = max(plan[i + 1 : i + early + 1], default=0.0)
        found.append(own(np.array([read[i]]), np.array([plan[i]]), np.array([soon]), i * MS)[0])
    return "".join(f"{each:.0f}" for each in found)


# ---- one point


@pytest.mark.parametrize(
    ("what", "schedule", "measured", "expected", "settings"),
    [
        ("in time", "000111111000", "000111111000", "000111111000", {"debounce": 0.0}),
        ("debounced", "000111111000", "000111111000", "000001111000", {"debounce": 2 * MS}),
        ("late", "000111111000", "000000111000", "000000111000", {"debounce": 0.0}),
        ("too late", "000111111111", "000000000000", "000000011111", {"debounce": 0.0, "late": 4 * MS}),
        ("early", "000000111000", "000111111000", "000011111000", {"debounce": 0.0, "early": 2}),
        ("early, not awaited", "000000111000", "000111111000", "000000111000", {"debounce": 0.0}),
        ("late lift-off", "111100000000", "111111110000", "111100000000", {"debounce": 0.0, "early": 2}),
        ("early lift-off", "111111110000", "111000000000", "111110000000", {"leave": 2 * MS}),
        ("bounce", "111111110000", "110011010000", "111111110000", {"leave": 2 * MS}),
        ("left in swing", "0000000000111", "1110000000000", "0000000000000", {"leave": np.inf, "early": 4}),
        ("stays", "111111110000", "100000000000", "111111110000", {"leave": np.inf}),
        ("one reading too many", "000111111000", "000101111000", "000000011000", {"debounce": 2 * MS, "leave": 2 * MS}),
        ("again", "111111111111", "110000001111", "111100000011", {"debounce": 2 * MS, "leave": 2 * MS}),
        ("again too late", "111111111111", "110000000000", "111100000000", {"leave": 2 * MS, "late": 4 * MS}),
    ],
)
def test_which_flags_count(what, schedule, measured, expected, settings):
    assert filtered(schedule, measured, **settings) == expected, what


def test_a_filter_starts_afresh_if_time_goes_back():
    own, one, zero = ContactFilter(MeasuredContacts(debounce=0.0), 1), np.ones(1), np.zeros(1)
    assert [own(zero, flag, zero, t)[0] for t, flag in ((1.0, zero), (1.1, one), (1.2, one))] == [0, 0, 0]
    assert own(zero, one, zero, 0.5)[0] == 1  # begun in stance: it stands
    assert own(zero, zero, zero, 0.6)[0] == 0


def test_stages_that_begin_soon_are_found_across_phases():
    plan = Stages(["0000", "1000", "0000", "0100", "0010", "0001"])
    for until, expected in ((0.0, "0000"), (0.009, "0000"), (0.01, "1000"), (0.03, "1100"), (9.0, "1111")):
        soon = scheduled_soon(plan.phases, (0, 0), until, "contact")
        assert "".join(f"{flag:.0f}" for flag in soon) == expected
    assert list(scheduled_soon(plan.phases, (1, 0), 9.0, "contact")) == [0, 0, 1, 1]


# ---- controllers


@pytest.mark.parametrize(
    ("contacts", "gains"),
    [
        ("measured", None),
        ("measured", JointPD(3.0, KD, 0.25, (0, 0, 0, 1, 1, -1, 2, 2, 2, 3, 3, 3))),
        (MeasuredContacts(0.003, 0.004, 0.015, 0.008), JointPD((3, 4, 5) * 4, 0.5, 2.0, (0,) * 12)),
        ("schedule", JointPD(3.0, KD, 0.0, (3, 2, 1, 0) * 3)),
    ],
)
def test_a_thousand_ticks_with_contacts_equal_those_of_the_twin(contacts, gains):
    rng = np.random.default_rng(3)
    plan = Stages(["".join(map(str, rng.integers(0, 2, 4))) for _ in range(60)])
    twins, (_, compiled, x, _) = pair(plan, contacts=contacts, gains=gains), standing()
    flags, t, seen, changed = np.ones(4), 0.0, set(), 0
    for tick in range(1000):
        t = 0.0 if tick == 600 else t + rng.choice([0.0, 1e-3, 2e-3])
        flags = np.where(rng.random(4) < 0.15, 1 - flags, flags)
        given = () if contacts == "schedule" else (tuple(flags),)
        compare(twins, pushed(compiled, x, 0.1, tick), t, *given)
        in_contact = [each.in_contact for each in twins]
        np.testing.assert_array_equal(*in_contact)
        seen.add(tuple(in_contact[0]))
        changed += (in_contact[0] != contacts_at(plan, t)).any()
    assert len(seen) > 10
    assert (changed > 100) == (contacts != "schedule")


@pytest.mark.parametrize("backend", ["native", "numpy"])
def test_a_foot_that_does_not_touch_has_no_force_in_the_program(backend):
    _, compiled, x, _ = standing()
    late = Vwbc(Stages(["0000", "1001", "1001"]), contacts=MeasuredContacts(debounce=0.0), backend=backend)
    planned = Vwbc(Stages(["0000", "1001", "1001"]), backend=backend)
    air = Vwbc(Stages(["0000", "0000", "0000"]), backend=backend)

    def presses(state):
        planned.control(state, 0.01)
        return any("friction cone" in name for name in planned.last.active)

    state = next(s for s in (pushed(compiled, x, 0.3, seed) for seed in range(20)) if presses(s))
    late.control(state, 0.0, np.zeros(4))
    np.testing.assert_allclose(late.control(state, 0.01, np.zeros(4)), air.control(state, 0.01), atol=1e-12)
    assert len(late.program(state, 0.01).d) == 24  # limits of torques alone
    np.testing.assert_allclose(late.control(state, 0.02, (1, 0, 0, 1)), planned.control(state, 0.02), atol=1e-12)
    assert list(late.in_contact) == [1, 0, 0, 1]
    assert np.abs(planned.control(state, 0.01) - air.control(state, 0.01)).max() > 0.01


@pytest.mark.parametrize("backend", ["native", "numpy"])
def test_gains_in_stance_are_those_of_the_joints_whose_foot_is_in_contact(backend):
    _, compiled, x, u = standing()
    plan, delta = OneStage(compiled, x, u), np.zeros(36)
    delta[6:18], delta[24:36] = 0.02, 0.1
    state = compiled.phases[0].mode.state.np_plus(x, delta)
    of = load("mini_cheetah").foot_of_joint
    none, full, quarter = (
        Vwbc(plan, gains=gains, backend=backend).control(state, 0.0)
        for gains in (None, JointPD(3.0, KD), JointPD(3.0, KD, 0.25, of))
    )
    np.testing.assert_allclose(full - none, -3.0 * 0.02 - 0.1 * np.array(KD), atol=1e-12)
    stands = np.array([1.0, 0.0, 0.0, 1.0])[list(of)]  # FL and HR
    np.testing.assert_allclose(quarter - none, (full - none) * (1 - 0.75 * stands), atol=1e-12)
    pd = FeedforwardPD(plan, kp=3.0, kd=KD, in_stance=0.25, contact_of=of)
    np.testing.assert_allclose(pd.control(state, 0.0) - u, quarter - none, atol=1e-12)


def test_measured_contacts_choose_the_gains_of_every_controller():
    _, compiled, x, _ = standing()
    plan, delta = Stages(["1001"] * 2), np.zeros(36)
    delta[6:18] = 0.02
    state, of = compiled.phases[0].mode.state.np_plus(x, delta), load("mini_cheetah").foot_of_joint
    settings = MeasuredContacts(debounce=0.0, leave=0.0)
    own = {"gains": JointPD(10.0, 0.0, 0.0, of), "contacts": settings}
    for controller in (Riccati(plan, **own), Vwbc(plan, **own)):
        without = type(controller)(plan, contacts=settings)
        diff = controller.control(state, 0.0, (0, 1, 1, 1)) - without.control(state, 0.0, (0, 1, 1, 1))
        np.testing.assert_allclose(diff, [-0.2] * 9 + [0.0] * 3, atol=1e-12)
    pd = FeedforwardPD(plan, kp=10.0, kd=0.0, in_stance=0.0, contact_of=of, contacts=settings)
    assert pd.measures_contacts
    np.testing.assert_allclose(
        pd.control(state, 0.0, (0, 1, 1, 1)) - plan.phases[0].controls[0], [-0.2] * 9 + [0.0] * 3, atol=1e-12
    )


def test_scheduled_contacts_are_told_for_any_time():
    plan = Stages(["1001", "0110", "0000", "1111"])
    for controller in (Vwbc(plan), Riccati(plan)):
        for t, expected in (
            (-1.0, "1001"),
            (0.0, "1001"),
            (0.01, "0110"),
            (0.029, "0000"),
            (0.03, "1111"),
            (9, "1111"),
        ):
            assert "".join(f"{flag:.0f}" for flag in controller.contacts(t)) == expected
    with pytest.raises(UnknownNameError, match="contacts, model 'mass': no slot 'contact'"):
        Riccati(plan_of(bounded)).contacts(0.0)


# ---- errors


def test_settings_that_do_not_fit_are_refused():
    _, compiled, x, u = standing()
    plan = OneStage(compiled, x, u)
    for make, message in (
        (
            lambda: Vwbc(plan, contacts="touched"),
            "Vwbc: contacts are unknown - got 'touched', expected 'schedule', ",
        ),
        (
            lambda: MeasuredContacts(early=-1.0),
            "measured contacts, early: out of range - got -1.0, expected a time ≥ 0",
        ),
        (lambda: MeasuredContacts(late=np.nan), "measured contacts, late: out of range - got nan, expected a time"),
        (
            lambda: Vwbc(plan_of(bounded), contacts="measured"),
            "Vwbc, measured contacts: the models have no common contact flags - got 0 of model 'mass'",
        ),
        (
            lambda: Riccati(plan, gains=JointPD(3, 1, 0.5, (0,) * 12), contact_slot="feet"),
            "Riccati, gains by contact",
        ),
        (
            lambda: JointPD(in_stance=0.25),
            "in_stance without contact_of - got 0.25, expected the index of a cont",
        ),
        (lambda: JointPD(in_stance=-1.0, contact_of=(0,)), "in_stance out of range - got -1.0, expected a finite numb"),
        (
            lambda: Vwbc(plan, gains=JointPD(3, 1, 0.5, (4,) * 12)),
            "no such contact flag - got [4, 4, 4, ",
        ),
        (lambda: Vwbc(plan, gains=JointPD(3, 1, 0.5, (-2,) * 12)), "expected numbers from -1 to 3; fix it"),
        (
            lambda: Vwbc(plan, contacts="measured", slots={"contact": 1.0}),
            "vwbc: two sources of contacts - got slot 'contact' and contacts='measured', expected one",
        ),
        (lambda: Vwbc(plan, contacts="measured").measure({"contact": 1.0}), "vwbc: two sources of contacts"),
        (
            lambda: Vwbc(plan, contacts="measured").control(x, 0.0),
            "Vwbc: contacts do not fit - got none, expected",
        ),
        (lambda: Riccati(plan).control(x, 0.0, np.ones(4)), "Riccati: contacts do not fit - got flags, expected none"),
    ):
        with pytest.raises(SolverError, match=re.escape(message)):
            make()
    for controller in (Vwbc(plan, contacts="measured"), Riccati(plan, contacts="measured")):
        with pytest.raises(ShapeError, match=re.escape("wrong size - got shape (3,), expected (4,); give one")):
            controller.control(x, 0.0, np.ones(3))
    with pytest.raises(ShapeError, match=re.escape("joint gains, kd: wrong size - got shape (3,), expected a num")):
        Vwbc(plan, gains=JointPD(3.0, (1, 2, 3)))


def test_the_slot_of_the_flags_may_have_another_name():
    """A whole body whose slot "landing" is taken for the flags."""
    body = WholeBody(load("mini_cheetah"))
    problem = ocp.Problem(
        ocp.Motion(ocp.Phase("stand", stance("FL HR"), 0.02)), body.until_end(dt=0.01),
        ocp.Objective(ocp.regularize("joints.torque", weight=1.0)), initial=body.state(joints="stand"),
    )  # fmt: skip
    compiled = ocp.compile_problem(problem)
    plan = OneStage(compiled, compiled.initial, compiled.phases[0].guess_controls[0])
    assert list(Riccati(plan).contacts(0.0)) == [1, 0, 0, 1]
    assert list(Riccati(plan, contact_slot="landing").contacts(0.0)) == [0, 0, 0, 0]
