"""Several motions: where one gives way to another, requests, ends; C does what NumPy does."""

from functools import lru_cache
from itertools import pairwise

import numpy as np
import pytest

from piaffe import models, ocp, solvers
from piaffe.errors import ProblemError, SolverError, UnknownNameError
from piaffe.models import stance
from piaffe.simulation import Plant, parse_commands, run_online
from piaffe.solvers.receding.changes import Changes
from tests.solvers.receding.test_ticks import problem, quadruped

RAIL = ocp.Model(
    "mass", state={"place": 1, "speed": 1}, control={"force": 1},
    modes={"slide": lambda s: {"place": s.speed, "speed": s.force}},
)  # fmt: skip
STEP = 0.02


def on_rail(*targets, cyclic=True, length=0.2, dt=STEP):
    """A mass that is driven to places, one after another."""
    phases = [ocp.Phase(f"to{i}", "slide", length, target={"place": each}) for i, each in enumerate(targets)]
    objective = ocp.Objective(ocp.track("place", 20.0), ocp.track("speed", 1.0), ocp.regularize("force", 0.1))
    limits = ocp.Constraints(ocp.inequality(lambda s: s.force, lower=-50, upper=50, name="force", unit="N"))
    return ocp.Problem(
        ocp.Motion(*phases, cyclic=cyclic), RAIL.over(0.2, dt=dt), objective, limits, initial=[targets[-1], 0.0]
    )


@lru_cache(maxsize=1)
def rail():
    return {"near": on_rail(0.1, 0.0), "far": on_rail(1.0, 0.0), "jump": on_rail(2.0, 0.5, 0.0, cyclic=False)}


def motions(**options):
    return solvers.Motions(rail(), **{"first_iterations": 20, "preparations": 2, **options})


def drive(mpc, commands, plans, first=0):
    """Return plans of a mass that follows its plans; commands by the number of a plan."""
    x, found = np.array(mpc.initial, dtype=float), []
    for k in range(first, first + plans):
        if k in commands:
            mpc.command(**commands[k])
        found.append(mpc.plan(x, k * mpc.period))
        acting = [each for each in found if each.start <= (k + 1) * mpc.period - 1e-7] or found[:1]
        part, t = acting[-1].parts[0], (k + 1) * mpc.period
        x = np.array([np.interp(t, part.times, column) for column in part.states.T]) + 1e-3 * np.sin(k)
    return found


def begins(plans):
    """Return the motions, and the starts of their first plans."""
    changes = [plans[0], *(b for a, b in pairwise(plans) if a.motion != b.motion)]
    return [(each.motion, round(each.start, 9)) for each in changes]


# ---- when a motion begins


def test_a_motion_begins_at_the_next_start_of_a_phase_for_which_there_is_time():
    plans = drive(motions(), {5: {"motion": "far"}}, 30)  # 5: 0.1 s; phases begin every 0.2 s
    assert begins(plans) == [("near", 0.0), ("far", 0.2)]
    assert [each.request for each in plans[4:11]] == ["", *["far"] * 5, ""]
    assert plans[10].parts[0].name == "to0"
    late = drive(motions(), {9: {"motion": "far"}}, 30)  # 0.18 s: one plan could be made ahead
    assert begins(late) == [("near", 0.0), ("far", 0.4)]
    assert begins(drive(motions(preparations=0), {9: {"motion": "far"}}, 30)) == [("near", 0.0), ("far", 0.2)]


def test_the_first_plan_of_a_motion_has_as_many_iterations_as_any():
    mpc = motions(iterations=2)
    plans = drive(mpc, {5: {"motion": "far"}}, 20)
    assert all(each.iterations <= 2 for each in plans[1:])
    assert plans[10].max_defect < 1e-6  # it was prepared
    assert plans[10].measured_at == pytest.approx(0.2)


def test_a_request_is_replaced_or_taken_back():
    assert begins(drive(motions(), {3: {"motion": "far"}, 6: {"motion": "near"}}, 30)) == [("near", 0.0)]
    again = {3: {"motion": "far"}, 12: {"motion": "near"}, 14: {"motion": "far"}, 16: {"motion": "near"}}
    assert begins(drive(motions(), again, 30)) == [("near", 0.0), ("far", 0.2), ("near", 0.4)]
    mpc = motions()
    mpc.command(motion="far")
    mpc.reset()
    assert begins(drive(mpc, {}, 20)) == [("near", 0.0)]


@pytest.mark.parametrize("latency", [0.0, 0.01, STEP])
@pytest.mark.parametrize("period", [0.02, 0.06])
def test_plans_in_c_are_those_of_numpy(latency, period):
    """Boundaries lie between the starts of plans if the period is 0.06 s."""
    commands = {4: {"motion": "far"}, 12: {"motion": "jump"}, 24: {"motion": "near"}, 26: {"motion": "jump"}}
    options = {"latency": latency, "period": period}
    native, readable = (drive(motions(backend=each, **options), commands, 60) for each in ("native", "numpy"))
    assert begins(native) == begins(readable)
    assert {name for name, _ in begins(native)} == {"near", "far", "jump"}
    for got, expected in zip(native, readable, strict=True):
        assert (got.motion, got.request, got.iterations, got.status) == (
            expected.motion, expected.request, expected.iterations, expected.status
        )  # fmt: skip
        for own, other in zip(got.parts, expected.parts, strict=True):
            np.testing.assert_allclose(own.times, other.times, atol=1e-12)
            np.testing.assert_allclose(own.states, other.states, atol=1e-8)
            np.testing.assert_allclose(own.controls, other.controls, atol=1e-7)
            np.testing.assert_allclose(own.feedback, other.feedback, atol=1e-7)


def test_between_two_starts_of_plans_a_motion_begins_at_the_boundary():
    plans = drive(motions(period=0.06), {1: {"motion": "far"}}, 12)
    assert begins(plans) == [("near", 0.0), ("far", 0.2)]
    change = next(each for each in plans if each.motion == "far")
    assert change.measured_at == pytest.approx(0.18)


def test_steps_of_other_lengths_have_a_clock_of_their_own():
    mpc = solvers.Motions({"near": on_rail(0.1, 0.0), "fine": on_rail(0.3, 0.0, dt=0.01)}, preparations=1)
    plans = drive(mpc, {3: {"motion": "fine"}, 20: {"motion": "near"}}, 40)
    assert begins(plans) == [("near", 0.0), ("fine", 0.2), ("near", 0.6)]
    assert plans[-1].start == pytest.approx(39 * STEP)


@pytest.mark.parametrize("backend", ["native", "numpy"])
def test_a_motion_whose_first_plan_is_not_finite_does_not_begin(backend):
    far = rail()["far"]  # its path goes beyond 0.5
    root = ocp.residual(lambda s: (0.5 - s.place) ** 0.5).weighted(1.0)
    broken = ocp.Problem(far.motion, RAIL.over(0.2, dt=STEP), far.objective + root, initial=[0.0, 0.0])
    mpc = solvers.Motions({"near": rail()["near"], "broken": broken}, preparations=2, backend=backend)
    with np.errstate(invalid="ignore"):  # of the readable reference
        plans = drive(mpc, {5: {"motion": "broken"}}, 40)
    assert begins(plans) == [("near", 0.0)]
    assert {each.request for each in plans[5:]} == {"broken"}
    assert all(np.isfinite(each.cost) for each in plans)


# ---- ends


def test_a_motion_with_an_end_is_finished_first():
    plans = drive(motions(), {2: {"motion": "jump"}, 20: {"motion": "far"}}, 60)
    assert begins(plans) == [("near", 0.0), ("jump", 0.2), ("far", 0.8)]
    back = drive(motions(start="far"), {2: {"motion": "jump"}}, 60)
    assert begins(back) == [("far", 0.0), ("jump", 0.2), ("far", 0.8)]
    named = drive(motions(after={"jump": "near"}, start="far"), {2: {"motion": "jump"}}, 60)
    assert begins(named)[-1] == ("near", 0.8)


def test_a_request_just_before_an_end_waits_for_the_next_boundary():
    plans = drive(motions(), {2: {"motion": "jump"}, 39: {"motion": "far"}}, 60)  # the jump ends at plan 40
    assert begins(plans) == [("near", 0.0), ("jump", 0.2), ("near", 0.8), ("far", 1.0)]


def test_a_motion_with_an_end_may_be_the_first():
    assert begins(drive(motions(start="jump"), {}, 60)) == [("jump", 0.0), ("near", 0.6)]


def test_something_follows_each_end():
    with pytest.raises(ProblemError, match="nothing follows the end of 'jump' - got no motion without an end"):
        solvers.Motions({"jump": rail()["jump"]})
    with pytest.raises(ProblemError, match="nothing follows the end of 'jump' - got no change to far"):
        motions(changes=[("near", "jump"), ("jump", "near")])


# ---- contacts


@lru_cache(maxsize=1)
def gaits():
    kinds = ("trot", "pace", "bound", "pronk", "flying_trot")
    return {kind: ocp.Horizon(problem(getattr(models.gaits, kind)(speed=0.4))) for kind in kinds}


def entries(*names, allowed=None):
    """Return the phases with which the second motion begins, by the phase of the first that would begin then."""
    chosen = {name: gaits()[name] for name in names}
    table = Changes(chosen, allowed).entries[0][:-1, 1]
    first, second = (chosen[name].calendar.entries for name in names)
    return {first[i].phase.name: "" if e < 0 else second[e].phase.name for i, e in enumerate(table) if i}


def test_a_motion_begins_where_its_feet_stand_or_land():
    assert entries("trot", "pace") == {"left_diagonal": "stand", "right_diagonal": "stand"}
    flights = entries("flying_trot", "pronk", allowed=[("flying_trot", "pronk")])
    assert set(flights.values()) == {"", "flight"}
    assert {name for name, entry in flights.items() if entry} == {name for name in flights if "flight" in name}


def test_a_motion_that_never_can_follow_is_named():
    with pytest.raises(ProblemError, match="'trot' never begins after 'bound' - got phases 'stand', .* of 'bound'"):
        Changes({name: gaits()[name] for name in ("trot", "bound")})
    Changes({name: gaits()[name] for name in ("trot", "bound")}, [("trot", "bound")])


# ---- what is refused


def test_commands_are_checked():
    mpc = motions()
    with pytest.raises(UnknownNameError, match="motions, command: no motion 'fra'"):
        mpc.command(motion="fra")
    with pytest.raises(UnknownNameError, match="motions: no command 'speed'"):
        mpc.command(speed=0.4)
    with pytest.raises(UnknownNameError, match="motions, start: no motion 'fra'"):
        motions(start="fra")
    with pytest.raises(UnknownNameError, match="motions, after 'jump': no motion 'fra'"):
        motions(after={"jump": "fra"})
    with pytest.raises(SolverError, match="preparations is out of range - got -1"):
        motions(preparations=-1)
    with pytest.raises(SolverError, match="motion 'near': .*period is out of range - got 0.03 s"):
        motions(period=0.03)


def test_motions_are_of_one_robot():
    other = ocp.Model(
        "other", state={"height": 1, "speed": 1}, control={"force": 1},
        modes={"slide": lambda s: {"height": s.speed, "speed": s.force}},
    )  # fmt: skip
    motion = ocp.Motion(ocp.Phase("up", "slide", 0.2, target={"height": 1.0}), cyclic=True)
    effort = ocp.regularize("force", 1.0)
    lift = ocp.Problem(
        motion, other.over(0.2, dt=STEP), ocp.Objective(ocp.track("height", 1.0), effort), initial=[0.0, 0.0]
    )
    with pytest.raises(ProblemError, match="'near' and 'lift' do not fit - got other states of the first models"):
        solvers.Motions({"near": rail()["near"], "lift": lift})
    with pytest.raises(ProblemError, match="a name is unusable - got 'Far away'"):
        solvers.Motions({"Far away": rail()["far"]})
    with pytest.raises(ProblemError, match="motions, 'far': is not a problem - got int"):
        solvers.Motions({"far": 3})


# ---- loops


def test_a_loop_makes_the_plans_that_are_made_one_by_one():
    """Its controls are those of Python, with a thread and without one, and it goes on from its last plan."""
    commands = {4: {"motion": "far"}, 30: {"motion": "jump"}}
    found = []
    for way in ("by hand", "within", "thread"):
        mpc = motions(latency=STEP)
        low = solvers.Riccati(mpc.plan(mpc.initial, 0.0))
        mpc.reset()
        x, controls, told = np.array(mpc.initial), [], []
        loop = mpc.running(low, thread=way == "thread")
        waits = None
        if way != "by hand":
            loop.start()
            loop.begin(x, 0.0)
        else:
            low.follow(mpc.plan(x, 0.0))
        for k in range(60):
            t = STEP * k
            if k in commands:
                mpc.command(**commands[k])
            if way == "by hand":
                if waits is not None and waits.start <= t + 1e-7:
                    low.follow(waits)
                    waits = None
                controls.append(low.control(x, t))
                if k:
                    waits = mpc.plan(x, t)
            else:
                controls.append(loop.control(x, t))
                while loop.is_planning:
                    pass
                told.append((loop.acting.motion, loop.acting.request))
            x = x + STEP * np.array([x[1], controls[-1][0]])
        found.append(np.array(controls))
        if way != "by hand":
            assert [name for name, _ in dict.fromkeys(each for each in told if not each[1])] == ["near", "far", "jump"]
            loop.stop()
            assert mpc.plan(x, 60 * STEP).motion == mpc.active == "jump"
    np.testing.assert_array_equal(found[1], found[0])
    np.testing.assert_array_equal(found[2], found[0])


class ByHand:
    """Motions that have no loops, so that Python decides when they plan."""

    def __init__(self, mpc):
        self.period, self.initial, self.velocity = mpc.period, mpc.initial, mpc.velocity
        self.reset, self.plan, self.command = mpc.reset, mpc.plan, mpc.command


def test_a_robot_changes_its_gait_on_command():
    declared = {kind: problem(getattr(models.gaits, kind)(speed=0.2)) for kind in ("trot", "pace")}
    mpc, episodes = solvers.Motions(declared, latency=0.02, preparations=1), []
    for wrap in (ByHand, lambda each: each):
        mpc.reset()
        low = solvers.Vwbc(mpc.plan(mpc.initial, 0.0), leave_out=("base.position x", "base.position y"))
        plant = Plant(quadruped()[0].robot, friction=0.7)
        commands = parse_commands("vx=0.3@0 motion=pace@0.31")
        episodes.append(run_online(wrap(mpc), low, plant, seconds=0.7, latency=0.02, commands=commands))
    by_hand, episode = episodes
    assert [name for _, name in episode.motions] == ["trot", "pace"]
    assert episode.success
    np.testing.assert_array_equal(episode.controls, by_hand.controls)
    boundary = episode.motions[1][0]
    flags = np.array([episode.planned[np.searchsorted(episode.times, boundary + t)] for t in (-0.01, 0.01)])
    four = stance("FL FR HL HR")
    assert len(four.feet) == 4
    assert flags[0].sum() == 2
    assert flags[1].all()  # all feet stand before it paces
    assert "pace" in episode.plans.requests
    assert episode.summary()["motions"] == [list(each) for each in episode.motions]
    assert mpc.velocity(0.0)[0] == 0.3
