"""Compiled problems: layout, what is active where, and that a change of numbers rebuilds nothing."""

import casadi as cs
import mujoco
import numpy as np
import pytest

from piaffe import models, ocp, solvers
from piaffe.errors import ProblemError, ShapeError
from piaffe.models import base, feet, joints, stance
from piaffe.ocp import ParameterKey, Vectorised

CHEETAH = models.load("mini_cheetah")
BODY = models.WholeBody(CHEETAH)
RIGID = models.SingleRigidBody(CHEETAH)
ALL = stance("FL FR HL HR")


def fall(s):
    return {"z": s.vz, "vz": s.thrust - 9.81}


def height(s):
    return s.z


def speed(s):
    return s.vz


def slow(s):
    return s.vz


def push(s):
    return s.thrust


BALL = ocp.Model("ball", state={"z": 1, "vz": 1}, control={"thrust": 1}, modes={"fall": fall})
DROP = ocp.Phase("drop", "fall", 0.4)
RISE = ocp.Phase("rise", "fall", 0.2)
CHEAP = ocp.regularize("thrust", weight=0.1)


def ball(*terms, rows=(), phases=(DROP, RISE), dt=0.02, schedule=None, t0=0.0, **options):
    """Compile a problem of the ball."""
    problem = ocp.Problem(
        ocp.Motion(*phases), schedule or BALL.until_end(dt=dt), ocp.Objective(CHEAP, *terms), ocp.Constraints(*rows),
        initial=[1.0, 0.0], **options,
    )  # fmt: skip
    return ocp.compile_problem(problem, t0)


def walking(friction=0.6, torque=0.1, dt=0.01, motion=None, schedule=None, **options):
    """Compile a problem of the robot with a few terms."""
    motion = motion or ocp.Motion(ocp.Phase("stand", ALL, 0.04), ocp.Phase("pair", stance("FL HR"), 0.04))
    objective = ocp.Objective(ocp.track(base.position, weight=1.0), ocp.regularize(joints.torque, weight=torque))
    limits = ocp.Constraints(models.friction_cone(mu=friction), models.torque_limits())
    schedule = schedule or BODY.until_end(dt=dt)
    return ocp.compile_problem(ocp.Problem(motion, schedule, objective, limits, initial=BODY.state(), **options))


def part(phase, key, p=None):
    """Return a named part of a phase's parameters."""
    return (phase.p if p is None else p)[..., phase.mode.layout.slices[key]]


def columns(phase, group, name, compiled):
    """Return the columns of a term's rows in a group."""
    return [i for i, row in enumerate(phase.mode.rows[group]) if compiled.term_name(row) == name]


# ---- layout


def test_shapes_of_a_phase():
    compiled = ball(ocp.track("z", to=0.5), rows=[ocp.inequality(height, upper=2.0, lower=-1.0, unit="m")])
    drop, rise = compiled.phases
    assert (drop.num_stages, rise.num_stages, compiled.num_stages) == (20, 10, 30)
    assert drop.times == pytest.approx(np.linspace(0, 0.4, 21))
    assert rise.times[0] == drop.times[-1]
    assert drop.p.shape == (20, drop.mode.layout.size)
    assert drop.p_end.shape == (drop.mode.layout.size,)
    assert drop.weight.shape == (20, 2)
    assert drop.g_mask.shape == (20, 2)
    assert drop.end_g_mask.shape == (2,)
    assert drop.guess_states.shape == (21, 2)
    assert drop.guess_controls.shape == (20, 1)
    assert (drop.mode.nz, drop.mode.nu, drop.mode.state.nx) == (0, 1, 2)


def test_rows_know_their_term_component_unit_scale_and_side():
    row = ocp.inequality(height, upper=2.0, lower=-1.0, unit="m", scale=0.1, name="shaft", labels=("z",))
    compiled = ball(rows=[row])
    lower, upper = compiled.phases[0].mode.rows["stage_g"]
    assert (lower.unit, lower.scale, lower.side, upper.side) == ("m", 0.1, "lower", "upper")
    assert compiled.row_name(lower) == "shaft z lower"
    assert compiled.term_name(upper) == "shaft"
    assert compiled.terms[lower.term] is row


def test_rows_are_margins_divided_by_the_scale():
    row = ocp.inequality(height, upper=2.0, lower=-1.0, scale=0.1)
    mode = ball(rows=[row]).phases[0].mode
    compiled = ball(rows=[row])
    *_, g, _ = Vectorised(mode.functions["stage"])(
        np.array([[0.5, 0.0]]), np.zeros((1, 1)), np.zeros((1, 0)), compiled.phases[0].p[:1]
    )
    assert g[0] == pytest.approx([15.0, 15.0])


def test_an_infinite_bound_is_masked():
    compiled = ball(rows=[ocp.inequality(height, lower=-np.inf, upper=1.0)])
    assert compiled.phases[0].g_mask[0].tolist() == [0, 1]
    assert np.all(np.isfinite(compiled.phases[0].p))


def test_bounds_that_exclude_each_other():
    with pytest.raises(
        ProblemError,
        match=r"row 0: bounds exclude each other - got lower 1 above upper 0 \[m\], expected lower ≤ upper",
    ):
        ball(rows=[ocp.inequality(height, lower=1.0, upper=0.0, unit="m")])


def test_the_discrete_step_and_its_derivatives():
    mode = ball().phases[0].mode
    x, u, z, p = np.array([[1.0, 2.0]]), np.array([[3.0]]), np.zeros((1, 0)), ball().phases[0].p[:1]
    step = Vectorised(mode.functions["stage"])(x, u, z, p)[0]
    assert step[0] == pytest.approx([1.04, 2.0 + 0.02 * (3.0 - 9.81)])
    d_w = Vectorised(mode.functions["stage_d"])(x, u, z, p, step)[1]
    assert d_w[0] == pytest.approx(np.array([[1, 0.02, 0], [0, 1, 0.02]]))


def test_the_guess_follows_the_path_from_the_initial_state():
    first, second = ball(phases=(ocp.Phase("drop", "fall", 0.4, {"z": 0.0}), RISE)).phases
    assert first.guess_states[:, 0] == pytest.approx(np.linspace(1.0, 0.0, 21))
    assert second.guess_states[:, 0] == pytest.approx(0.0)
    assert not first.guess_controls.any()


def test_the_guess_of_a_later_horizon_starts_in_the_initial_state_and_goes_on_along_the_path():
    first, second = ball(phases=(ocp.Phase("drop", "fall", 0.4, {"z": 0.0}), RISE), t0=0.2).phases
    assert first.guess_states[0].tolist() == [1.0, 0.0]
    assert first.guess_states[1:, 0] == pytest.approx(np.linspace(0.45, 0.0, 10))
    assert second.guess_states[0, 0] == pytest.approx(0.0)


# ---- what holds where


def test_running_terms_weigh_on_stages_and_ends_on_nodes():
    running, at_end = ocp.track("z", 2.0, to=0.0), ocp.track("vz", 3.0, to=0.0, at="end")
    at_phase_end = ocp.track("z", 5.0, to=0.0, at="phase_end")
    compiled = ball(running, at_end, at_phase_end)
    drop, rise = compiled.phases
    assert drop.weight == pytest.approx(np.tile([0.1, 2.0], (20, 1)))
    ends = [compiled.term_name(row) for row in drop.mode.rows["terminal_residual"]]
    assert ends == ["track vz at end", "track z at phase_end"]
    assert drop.end_weight.tolist() == [0, 5]
    assert rise.end_weight.tolist() == [3, 5]


def test_a_cut_by_the_schedule_is_no_phase_end():
    compiled = ball(ocp.track("z", 5.0, to=0.0, at="phase_end"), schedule=BALL.over(0.5, dt=0.02))
    drop, rise = compiled.phases
    assert (drop.ends_phase, rise.ends_phase) == (True, False)
    assert (drop.end_weight[0], rise.end_weight[0]) == (5, 0)


def test_rows_of_the_state_alone_hold_at_every_node_of_every_phase():
    compiled = ball(
        rows=[
            ocp.inequality(height, name="floor"),
            ocp.inequality(push, name="pull"),
            ocp.equality(speed, name="still"),
        ]
    )
    for phase in compiled.phases:
        rows = {
            group: [compiled.term_name(r) for r in phase.mode.rows[group]]
            for group in ("stage_g", "terminal_g", "stage_h", "terminal_h")
        }
        assert rows == {
            "stage_g": ["floor", "pull"],
            "terminal_g": ["floor"],
            "stage_h": ["still"],
            "terminal_h": ["still"],
        }
        assert phase.g_mask.all()
        assert phase.end_g_mask.tolist() == [1]
        assert phase.end_h_mask.tolist() == [1]


def test_rows_at_the_end_hold_there_alone():
    last, every = ocp.equality(height, at="end", name="last"), ocp.equality(speed, at="phase_end", name="every")
    drop, rise = ball(rows=[last, every]).phases
    assert drop.h_mask.shape == (20, 0)
    assert drop.end_h_mask.tolist() == [0, 1]
    assert rise.end_h_mask.tolist() == [1, 1]


def test_when_masks_the_other_phases():
    floor = ocp.inequality(height, when="rise", name="floor")
    drop, rise = ball(ocp.track("z", 2.0, to=0.0, when=("rise",)), rows=[floor]).phases
    assert not drop.g_mask.any()
    assert not drop.end_g_mask.any()
    assert rise.g_mask.all()
    assert drop.weight[0].tolist() == [0.1, 0]
    assert rise.weight[0].tolist() == [0.1, 2]


def test_weights_by_phase():
    drop, rise = ball(ocp.track("z", ocp.by_phase(1.0, rise=7.0), to=0.0)).phases
    assert drop.weight[0].tolist() == [0.1, 1]
    assert rise.weight[0].tolist() == [0.1, 7]


def test_a_phase_s_own_terms_hold_in_it_alone():
    own = ocp.Phase(
        "drop", "fall", 0.4, until=ocp.equality(height, name="ground"),
        constraints=ocp.Constraints(ocp.inequality(push, name="up")),
        objective=ocp.Objective(ocp.track("vz", 4.0, to=0.0)),
    )  # fmt: skip
    compiled = ball(phases=(own, RISE))
    drop, rise = compiled.phases
    assert drop.g_mask.all()
    assert not rise.g_mask.any()
    assert (drop.end_h_mask.tolist(), rise.end_h_mask.tolist()) == ([1], [0])
    assert drop.weight[0].tolist() == [0.1, 4]
    assert rise.weight[0].tolist() == [0.1, 0]
    assert "drop" in next(line for line in ocp.describe(compiled).splitlines() if line.startswith("ground"))
    assert "all phases" not in next(line for line in ocp.describe(compiled).splitlines() if line.startswith("ground"))


def test_two_phases_of_one_name_are_two_phases_to_their_own_terms():
    own = ocp.Phase("go", "fall", 0.2, constraints=ocp.Constraints(ocp.inequality(height)))
    first, second = ball(phases=(own, ocp.Phase("go", "fall", 0.2))).phases
    assert first.g_mask.all()
    assert not second.g_mask.any()


def test_rows_of_feet_in_the_air_are_masked():
    compiled = walking()
    stand, pair = compiled.phases
    friction = columns(stand, "stage_g", "friction cone", compiled)
    assert stand.g_mask[0, friction].tolist() == [1] * 20
    assert pair.g_mask[0, friction].tolist() == [1] * 5 + [0] * 10 + [1] * 5
    assert pair.mode is stand.mode


def test_a_mask_with_an_entry_per_foot_holds_for_all_rows_of_the_foot():
    places = ocp.inequality(lambda s: s.feet.position, mask=lambda s: s.feet.contact, lower=-9.0, name="places")
    motion = ocp.Motion(ocp.Phase("pair", stance("FL HR"), 0.04))
    terms = ocp.Objective(ocp.regularize(feet.force, weight=0.01))
    problem = ocp.Problem(motion, RIGID.until_end(dt=0.02), terms, ocp.Constraints(places), initial=RIGID.state())
    mask = ocp.compile_problem(problem).phases[0].g_mask
    assert mask.tolist() == [[1, 1, 1, 0, 0, 0, 0, 0, 0, 1, 1, 1]] * 2  # FL, FR, HL, HR: x, y, z each


def test_a_term_binds_to_every_model_that_has_its_quantity():
    motion = ocp.Motion(ocp.Phase("stand", ALL, 0.08))
    objective = ocp.Objective(
        ocp.track(base.position, weight=1.0),
        ocp.regularize(joints.torque, weight=0.1),
        ocp.regularize(feet.force, weight=0.01),
    )
    limits = ocp.Constraints(models.friction_cone(mu=0.6), models.torque_limits())
    schedule = BODY.over(0.04, dt=0.02) + RIGID.over(0.04, dt=0.02).without(limits)
    compiled = ocp.compile_problem(ocp.Problem(motion, schedule, objective, limits, initial=BODY.state()))
    assert compiled.unbound == {
        ("mini_cheetah rigid body", 1): "model 'mini_cheetah rigid body' cannot supply 'joints.torque'",
        ("mini_cheetah rigid body", 3): "left out by the schedule",
        ("mini_cheetah rigid body", 4): "left out by the schedule",
    }
    body, rigid = (phase.mode for phase in compiled.phases)
    assert body.bound == (0, 1, 2, 3, 4)
    assert rigid.bound == (0, 2)
    text = ocp.describe(compiled)
    assert "cannot supply 'joints.torque'" in text
    assert "left out by the schedule" in text


def test_what_one_segment_leaves_out_holds_in_another_of_the_same_model():
    floor, ceiling = ocp.inequality(height, name="floor"), ocp.inequality(speed, name="slow")
    schedule = (
        BALL.over(0.2, dt=0.02).without(floor) + BALL.over(0.2, dt=0.02) + BALL.over(0.2, dt=0.02).without(ceiling)
    )
    compiled = ball(rows=[floor, ceiling], phases=(ocp.Phase("drop", "fall", 0.6),), schedule=schedule)
    names = [[compiled.term_name(row) for row in phase.mode.rows["stage_g"]] for phase in compiled.phases]
    assert names == [["slow"], ["floor", "slow"], ["floor"]]


# ---- resets


def test_states_that_a_reset_leaves_out_are_kept():
    bounce = ocp.reset(lambda s: {"vz": -0.5 * s.vz})
    drop, rise = ball(phases=(ocp.Phase("drop", "fall", 0.4, reset=bounce), RISE)).phases
    (after,) = Vectorised(drop.transition.functions["reset"])(
        np.array([[0.1, -4.0]]), np.zeros((1, 0)), drop.p_transition[None]
    )
    assert after[0] == pytest.approx([0.1, 2.0])
    assert drop.resets
    assert not rise.resets


def test_phases_without_a_reset_are_joined():
    drop, _ = ball().phases
    (after,) = Vectorised(drop.transition.functions["reset"])(
        np.array([[0.1, -4.0]]), np.zeros((1, 0)), drop.p_transition[None]
    )
    assert after[0] == pytest.approx([0.1, -4.0])
    assert not drop.resets


def test_a_reset_in_a_cut_phase_waits_for_the_phase_s_end():
    bounce = ocp.reset(lambda s: {"vz": -0.5 * s.vz})
    schedule = BALL.over(0.2, dt=0.02) + BALL.over(0.4, dt=0.01)
    first, second, _ = ball(phases=(ocp.Phase("drop", "fall", 0.4, reset=bounce), RISE), schedule=schedule).phases
    assert (first.resets, second.resets) == (False, True)


def test_phases_of_models_with_other_modes_follow_each_other():
    """A model is asked about its own modes alone: those before and after may be another's."""
    tank = ocp.Model("tank", state={"h": 1}, modes={"drain": lambda s: {"h": -s.h}})
    catch = ocp.Phase("drop", "fall", 0.4, reset=ocp.reset(lambda s: {"h": s.z}))
    compiled = ball(
        phases=(catch, ocp.Phase("out", "drain", 0.2)), schedule=BALL.over(0.4, dt=0.02) + tank.over(0.2, dt=0.02)
    )
    assert [phase.mode.state.nx for phase in compiled.phases] == [2, 1]
    assert [phase.mode.nu for phase in compiled.phases] == [1, 0]


# ---- a change of numbers rebuilds nothing


def test_the_first_of_a_kind_is_built():
    other = ocp.Model("other", state={"z": 1, "vz": 1}, control={"thrust": 1}, modes={"fall": fall})
    problem = ocp.Problem(ocp.Motion(DROP, RISE), other.until_end(dt=0.02), ocp.Objective(CHEAP), initial=[1.0, 0.0])
    assert ocp.compile_problem(problem).lowered == 2  # a mode and a transition
    assert ocp.compile_problem(problem).lowered == 0


@pytest.mark.parametrize(
    "changed",
    [
        {"torque": 0.5},
        {"torque": {"HAA": 0.5, "HFE": 0.2, "KFE": 0.1}},
        {"friction": 0.3},
        {"dt": 0.02},
        {"motion": ocp.Motion(ocp.Phase("flight", stance(""), 0.1), ocp.Phase("land", ALL, 0.06))},
        {"motion": models.gaits.bound(speed=0.3).cycles(1)},
        {"motion": models.gaits.pronk(speed=0.3).cycles(1)},
        {"parameters": {"mini_cheetah.terrain": 0.1, "mini_cheetah.link_mass": 1.1 * BODY.tree.mass}},
        {"schedule": BODY.over(0.06, dt=0.02)},
    ],
    ids=["weight", "weights", "mu", "step", "contacts", "bound", "pronk", "masses", "horizon"],
)
def test_another_number_rebuilds_nothing(changed):
    walking()
    assert walking(**changed).lowered == 0


def test_another_bound_or_target_rebuilds_nothing():
    ball(ocp.track("z", to=0.0), rows=[ocp.inequality(height, lower=0.0)])
    changed = ball(ocp.track("z", 3.0, to=1.0, when="drop"), rows=[ocp.inequality(height, lower=-2.0, name="other")])
    assert changed.lowered == 0
    assert part(changed.phases[0], ParameterKey("target", term=1))[0].tolist() == [1.0]
    assert part(changed.phases[0], ParameterKey("lower", term=2))[0].tolist() == [-2.0]


def test_another_term_is_built():
    ball()
    assert ball(rows=[ocp.inequality(lambda s: s.z - s.vz)]).lowered > 0


# ---- parameters of the user's


def test_parameters_reach_terms_and_resets():
    gap, restitution = ocp.parameter("gap", 0.1), ocp.parameter("restitution", 0.8)
    bounce = ocp.reset(lambda s: {"vz": -restitution * s.vz})
    rows = ocp.Constraints(ocp.inequality(lambda s: s.z - gap, name="bar"))
    motion = ocp.Motion(ocp.Phase("drop", "fall", 0.4, reset=bounce), RISE)
    problem = ocp.Problem(motion, BALL.until_end(dt=0.02), ocp.Objective(CHEAP), rows, initial=[1.0, 0.0])
    drop = ocp.compile_problem(problem).phases[0]
    assert part(drop, ParameterKey("parameter", "gap"))[3].tolist() == [0.1]
    assert drop.p_transition[drop.transition.layout.slices[ParameterKey("parameter", "restitution")]].tolist() == [0.8]
    changed = ocp.compile_problem(problem.with_parameters(gap=0.3, restitution=0.5))
    assert changed.lowered == 0
    assert part(changed.phases[0], ParameterKey("parameter", "gap"))[3].tolist() == [0.3]
    x, p = np.array([[0.0, -4.0]]), changed.phases[0].p_transition[None]
    assert Vectorised(drop.transition.functions["reset"])(x, np.zeros((1, 0)), p)[0][0] == pytest.approx([0.0, 2.0])
    assert problem.parameters == {}


def test_another_schedule_takes_the_place_of_the_first():
    problem = ocp.Problem(ocp.Motion(RISE), BALL.until_end(dt=0.02), ocp.Objective(CHEAP), initial=[1.0, 0.0])
    finer = problem.with_schedule(BALL.until_end(dt=0.01))
    assert [ocp.compile_problem(each).num_stages for each in (problem, finer)] == [10, 20]
    other = ocp.Model("other", state={"z": 1}, control={"thrust": 1}, modes={"fall": lambda s: {"z": s.thrust}})
    with pytest.raises(ShapeError, match="wrong size for model 'other' - got shape \\(2,\\), expected \\(1,\\)"):
        problem.with_schedule(other.until_end(dt=0.01))


def test_parameters_may_be_columns():
    place = ocp.parameter("place", (1.0, 2.0))
    compiled = ball(
        ocp.residual(lambda s: place - cs.vertcat(s.z, s.vz)).weighted(1.0), parameters={"place": (3.0, 4.0)}
    )
    assert part(compiled.phases[0], ParameterKey("parameter", "place"))[0].tolist() == [3.0, 4.0]


def test_parameters_of_a_model():
    compiled = walking(parameters={"mini_cheetah.gravity": (0, 0, -1.62)})
    assert part(compiled.phases[0], ParameterKey("slot", "gravity", model="mini_cheetah"))[0].tolist() == [0, 0, -1.62]


def test_what_the_motion_decides_is_no_parameter():
    with pytest.raises(
        ProblemError,
        match=r"parameter 'mini_cheetah\.contact': follows from the motion - got a number for it, expected none",
    ):
        walking(parameters={"mini_cheetah.contact": np.ones(4)})


def test_a_term_s_own_numbers_are_parameters():
    compiled = walking(friction=0.35)
    k = next(k for k, term in enumerate(compiled.terms) if term.name == "friction cone")
    assert part(compiled.phases[0], ParameterKey("parameter", "mu", term=k))[0].tolist() == [0.35]


# ---- targets


def test_targets_follow_the_path_node_by_node():
    compiled = ball(ocp.track("z", 1.0), phases=(ocp.Phase("drop", "fall", 0.4, {"z": 0.0}), RISE))
    assert part(compiled.phases[0], ParameterKey("target", term=1)).ravel() == pytest.approx(np.linspace(1.0, 0.05, 20))


def test_a_quantity_by_path_tracks_as_the_quantity_itself():
    motion = ocp.Motion(ocp.Phase("stand", ALL, 0.04, ocp.Keyframe(rpy=(0, 0, 0.4))))
    torque = ocp.regularize(joints.torque, weight=0.1)
    by_name, by_quantity = (
        ocp.compile_problem(
            ocp.Problem(motion, BODY.until_end(dt=0.02), ocp.Objective(torque, ocp.track(q)), initial=BODY.state())
        ).phases[0]
        for q in ("base.orientation", base.orientation)
    )
    assert part(by_name, ParameterKey("target", term=1)) == pytest.approx(
        part(by_quantity, ParameterKey("target", term=1))
    )
    assert [row.unit for row in by_name.mode.rows["stage_residual"][12:]] == ["rad"] * 3


def test_a_fixed_orientation_may_be_given_by_its_angles():
    motion = ocp.Motion(ocp.Phase("stand", ALL, 0.04))
    for to in ((0, 0, np.pi / 2), (2.0, 0, 0, 2.0)):
        terms = ocp.Objective(ocp.regularize(joints.torque, weight=0.1), ocp.track(base.orientation, to=to))
        phase = ocp.compile_problem(ocp.Problem(motion, BODY.until_end(dt=0.02), terms, initial=BODY.state())).phases[0]
        assert part(phase, ParameterKey("target", term=1))[0] == pytest.approx([np.sqrt(0.5), 0, 0, np.sqrt(0.5)])


def test_a_term_asks_for_targets_only_where_it_applies():
    """A gait has footholds, keyframes have none: the term is for the gait alone."""
    pace = models.gaits.pace(speed=0.2).cycles(1)
    roll = ocp.Motion(ocp.Phase("rest", ALL, 0.1, ocp.Keyframe(position=(0, 0, 0.2))))
    objective = ocp.Objective(
        ocp.regularize(joints.torque, weight=0.1), ocp.track(feet.position, when=("left", "right"))
    )
    compiled = ocp.compile_problem(ocp.Problem(pace + roll, BODY.until_end(dt=0.01), objective, initial=BODY.state()))
    assert compiled.phases[1].weight[0, -12:].all()
    assert not compiled.phases[-1].weight[:, -12:].any()


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_residual_of_an_orientation_is_the_rotation_vector_in_body_axes_from_target_to_state(sign):
    target, turn = np.array([0.3, -0.2, 1.1]), np.array([0.2, -0.5, 0.4])  # roll, pitch, yaw; a rotation vector [rad]
    q = ocp.rotation.np_from_rpy(target)
    mujoco.mju_quatIntegrate(q, turn, 1.0)
    x = RIGID.state()
    x[3:7] = sign * q
    terms = ocp.Objective(ocp.regularize(feet.force, weight=0.01), ocp.track(base.orientation, to=target, at="end"))
    motion = ocp.Motion(ocp.Phase("stand", ALL, 0.04))
    phase = ocp.compile_problem(ocp.Problem(motion, RIGID.until_end(dt=0.02), terms, initial=RIGID.state())).phases[0]
    assert phase.mode.functions["terminal"](x, phase.p_end)[0].full().ravel() == pytest.approx(turn, abs=1e-12)


# ---- description


def test_a_problem_prints_its_phases_and_terms():
    row = ocp.inequality(height, name="floor", unit="m")
    bounce = ocp.reset(lambda s: {"vz": -s.vz})
    motion = ocp.Motion(ocp.Phase("drop", "fall", 0.4, reset=bounce), RISE)
    limits = ocp.Constraints(row)
    problem = ocp.Problem(motion, BALL.until_end(dt=0.02), ocp.Objective(CHEAP), limits, initial=[1.0, 0.0])
    lines = str(problem).splitlines()
    assert lines[0].split()[:4] == ["phase", "mode", "model", "from"]
    assert lines[2].split() == ["drop", "fall", "ball", "0.000", "0.400", "0.02", "20", "2/2", "1", "reset"]
    assert lines[3].split() == ["rise", "fall", "ball", "0.400", "0.600", "0.02", "10", "2/2", "1", "end"]
    assert "30 stages over 0.600 s" in lines
    floor = next(line for line in lines if line.startswith("floor"))
    assert floor.split()[:7] == ["floor", "inequality", "running", "m", "1", "ball", "all"]
    assert f"test_compile.py:{row.source.line}" in floor


def test_a_compilation_tells_its_phases():
    problem = ocp.Problem(
        ocp.Motion(DROP, RISE), BALL.until_end(dt=0.02), ocp.Objective(CHEAP), initial=[1.0, 0.0]
    )  # fmt: skip
    told = []
    ocp.compile_problem(problem, progress=lambda *each: told.append(each))
    assert told == [(0, 2, "drop"), (1, 2, "rise")]
    told.clear()
    solvers.MSiLQR(problem, backend="numpy", compiling=lambda *each: told.append(each))
    assert told == [(0, 2, "drop"), (1, 2, "rise")]
