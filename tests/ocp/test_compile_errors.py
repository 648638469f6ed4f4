"""What the compiler refuses and what it tells: got, expected, and the file and line of the declaration.

Lines of this file are HERE in the expected texts.
"""

import re
from pathlib import Path

import casadi as cs
import numpy as np
import pytest

from piaffe import models, ocp, solvers
from piaffe.errors import ModelError, ProblemError, ShapeError, SolverError, UnknownNameError
from piaffe.models import base, feet, joints, stance

FILE = Path(__file__).name
BALL = ocp.Model(
    "ball", state={"z": 1, "vz": 1}, control={"thrust": 1}, modes={"fall": lambda s: {"z": s.vz, "vz": s.thrust - 9.81}}
)
CHEETAH = models.load("mini_cheetah")
BODY = models.WholeBody(CHEETAH)
RIGID = models.SingleRigidBody(CHEETAH)
DROP = ocp.Phase("drop", "fall", 0.4)
RISE = ocp.Phase("rise", "fall", 0.2)
CHEAP = ocp.Objective(ocp.regularize("thrust", weight=0.1))
STAND = ocp.Objective(ocp.regularize(joints.torque, weight=0.1))


def ball(*phases, objective=CHEAP, constraints=None, schedule=None, t0=0.0, **options):
    """Compile a problem of the ball."""
    motion = ocp.Motion(*(phases or (DROP,)))
    schedule = schedule or BALL.until_end(dt=0.02)
    problem = ocp.Problem(motion, schedule, objective, constraints, initial=[1.0, 0.0], **options)
    return ocp.compile_problem(problem, t0)


def robot(*terms, target=None, constraints=None, schedule=None, feet="FL FR HL HR", **options):
    """Compile a problem of a robot that stands."""
    motion = ocp.Motion(ocp.Phase("stand", stance(feet), 0.04, target))
    schedule = schedule or BODY.until_end(dt=0.02)
    problem = ocp.Problem(motion, schedule, STAND + ocp.Objective(*terms), constraints, initial=BODY.state(), **options)
    return ocp.compile_problem(problem)


def told(kind, compile_it):
    """Return the message of the error that a call raises."""
    with pytest.raises(kind) as caught:
        compile_it()
    return re.sub(rf"{re.escape(FILE)}:\d+", "HERE", str(caught.value))


def test_the_line_is_that_of_the_declaration():
    term = ocp.track("z", weight=(1, 2))
    line = term.source.line
    assert Path(__file__).read_text().splitlines()[line - 1].strip() == 'term = ocp.track("z", weight=(1, 2))'
    with pytest.raises(ShapeError, match=rf"\({FILE}:{line}\)"):
        ball(objective=CHEAP + term)


# ---- weights and targets of the wrong size


def test_weight_of_the_wrong_size():
    assert told(ShapeError, lambda: robot(ocp.track(base.position, weight=(1, 2)))) == (
        "term 'track base.position' (HERE): weight has the wrong size - got 2 entries, expected 1 or 3 (x, y, z) [m]; "
        "give one per component, a scalar, or a mapping by name"
    )


def test_weight_by_a_name_that_is_none():
    message = told(UnknownNameError, lambda: robot(ocp.track(joints.position, weight={"FL_HAB": 1.0})))
    assert message.startswith(
        "term 'track joints.position' (HERE): no component 'FL_HAB' - got 'FL_HAB', expected one of"
    )
    assert "did you mean 'FL_HAA' or" in message


def test_target_of_the_wrong_size():
    assert told(ShapeError, lambda: robot(ocp.track(base.position, to=(0, 0)))) == (
        "term 'track base.position' (HERE): target has the wrong size - got 2 entries, expected 3 (x, y, z) [m]; "
        "give one per component"
    )
    assert told(ShapeError, lambda: robot(ocp.track(base.orientation, to=(0, 0)))) == (
        "term 'track base.orientation' (HERE): target has the wrong size - got 2 entries, expected "
        "3 (roll, pitch, yaw) [rad]; give one per component"
    )


def test_keyframe_of_the_wrong_size():
    message = told(ProblemError, lambda: robot(target=ocp.Keyframe(position=(0, 0))))
    assert message == (
        "phase 'stand' (HERE): keyframe for model 'mini_cheetah', target 'position': wrong size - got shape (2,), "
        "expected (3,) for x, y, z [m]; give one per component"
    )
    assert told(ProblemError, lambda: ball(ocp.Phase("drop", "fall", 0.4, {"z": (1, 2)}))) == (
        "phase 'drop' (HERE): keyframe for model 'ball', target 'z': wrong size - got 2 entries, expected 1; give one "
        "per component"
    )


def test_keyframe_of_what_no_model_has():
    message = told(ProblemError, lambda: ball(ocp.Phase("drop", "fall", 0.4, {"zz": 1})))
    assert message == (
        "phase 'drop' (HERE): keyframe for model 'ball': no target 'zz' - got 'zz', expected one of ['z', 'vz', "
        "'thrust']; did you mean 'z' or 'vz'?"
    )
    message = told(ProblemError, lambda: robot(target=ocp.Keyframe(joints="stan")))
    assert "phase 'stand' (HERE): robot 'mini_cheetah': no pose 'stan'" in message
    assert message.endswith("did you mean 'stand' or 'lean'?")


def test_target_that_the_motion_does_not_have():
    message = told(ProblemError, lambda: robot(ocp.track(feet.velocity)))
    assert message.startswith(
        "term 'track feet.velocity' (HERE): the motion has no target for it - got targets ['base.angular"
    )
    assert message.endswith("expected 'feet.velocity'; give to=..., or put it in the keyframes or the reference")


def test_initial_state_of_the_wrong_size():
    message = told(ShapeError, lambda: ocp.Problem(ocp.Motion(DROP), BALL.until_end(dt=0.02), CHEAP, initial=[1.0]))
    assert message == (
        "problem (HERE): initial state has the wrong size for model 'ball' - got shape (1,), expected (2,): z 1, vz 1; "
        "build it with the model's state()"
    )
    problem = ocp.Problem(ocp.Motion(DROP), BALL.until_end(dt=0.02), CHEAP, initial=[1.0, 0.0])
    assert told(ProblemError, lambda: problem.with_initial([np.nan, 0.0])) == (
        "problem (HERE): initial state is not finite - got nan at entry 0, 'z' of model 'ball', expected finite "
        "numbers; fix it"
    )


def test_bounds_of_the_wrong_size():
    row = ocp.inequality(lambda s: s.base.position, lower=(0, 0), name="box", unit="m")
    assert told(ShapeError, lambda: robot(constraints=ocp.Constraints(row))) == (
        "constraint 'box' (HERE): lower bound is unusable - got [0.0, 0.0], expected 1 or 3 numbers [m]; give one per "
        "row or a scalar"
    )


def test_labels_of_the_wrong_size():
    row = ocp.inequality(lambda s: s.base.position, labels=("x",), name="box")
    assert told(ShapeError, lambda: robot(constraints=ocp.Constraints(row))) == (
        "constraint 'box' (HERE): labels do not match the rows - got 1, expected 3; give one per row"
    )


# ---- steps


def test_phase_that_is_not_a_whole_number_of_steps():
    assert told(ProblemError, lambda: ball(ocp.Phase("drop", "fall", 0.45))) == (
        "phase 'drop' (HERE): not a whole number of steps - got 0.45 s with dt 0.02 s, expected 0.44 or 0.46 s; choose "
        "one, or another dt"
    )


def test_segment_that_is_not_a_whole_number_of_steps():
    schedule = BODY.over(0.02, dt=0.02) + RIGID.over(0.02, dt=0.03)
    assert told(ProblemError, lambda: robot(ocp.regularize(feet.force), schedule=schedule)) == (
        "schedule (HERE), model 'mini_cheetah rigid body': not a whole number of steps - got 0.02 s with dt 0.03 s, "
        "expected 0.03 s; choose one, or another dt"
    )


# ---- modes


def test_mode_that_a_model_does_not_have():
    assert told(ProblemError, lambda: ball(ocp.Phase("drop", "fly", 0.4))) == (
        "phase 'drop' (HERE): model 'ball' (HERE): no mode 'fly' - got 'fly', expected one of ['fall']; did you mean "
        "'fall'?"
    )


def test_mode_that_is_no_contact_set():
    message = told(ProblemError, lambda: robot(feet="FL RR"))
    assert message.startswith(
        "phase 'stand' (HERE): robot 'mini_cheetah': no foot 'RR' - got 'RR', expected one of ['FL', 'FR'"
    )


# ---- reset maps


def test_reset_map_of_the_wrong_size_for_the_next_model():
    bounce = ocp.reset(lambda s: {"vz": cs.vertcat(s.vz, s.vz)})
    drop = ocp.Phase("drop", "fall", 0.4, reset=bounce)
    assert told(ShapeError, lambda: ball(drop, RISE)) == (
        "phases 'drop' → 'rise' (HERE), reset (HERE): 'vz' has the wrong size for the next model 'ball' - got 2, "
        "expected 1 []; return 1"
    )


def test_state_that_the_model_before_does_not_supply():
    flat = ocp.Model("flat", state={"x": 2}, modes={"slide": lambda s: {"x": [1, 1]}})
    slide = ocp.Phase("slide", "slide", 0.2)
    schedule = BALL.over(0.4, dt=0.02) + flat.over(0.2, dt=0.02)
    assert told(ShapeError, lambda: ball(DROP, slide, schedule=schedule)) == (
        "phases 'drop' → 'slide' (HERE): the next model 'flat' has a state that 'ball' does not supply - got no 'x', "
        "expected 2 entries []; return it from a reset map on the phase"
    )


def test_reset_of_states_that_do_not_exist():
    drop = ocp.Phase("drop", "fall", 0.4, reset=ocp.reset(lambda s: {"v": 0}))
    assert told(ProblemError, lambda: ball(drop, RISE)) == (
        "phases 'drop' → 'rise' (HERE), reset (HERE): unknown state names - got ['v'], expected some of ['z', 'vz']; "
        "rename them"
    )


def test_reset_that_returns_no_mapping():
    drop = ocp.Phase("drop", "fall", 0.4, reset=ocp.reset(lambda s: -s.vz))
    assert told(ProblemError, lambda: ball(drop, RISE)) == (
        "phases 'drop' → 'rise' (HERE), reset (HERE): result is unusable - got SX, expected a mapping of state names; "
        "return a dict"
    )


def test_reset_that_depends_on_the_control():
    drop = ocp.Phase("drop", "fall", 0.4, reset=ocp.reset(lambda s: {"vz": s.thrust}))
    assert told(ProblemError, lambda: ball(drop, RISE)) == (
        "phases 'drop' → 'rise' (HERE), reset (HERE): depends on control or contact force where there is none - got an "
        "expression of them at the end of a phase, expected one of the state; change it"
    )


def test_reset_that_a_model_runs_past():
    here = stance("FL FR HL HR")
    stop = ocp.Phase("stop", here, 0.1, reset=ocp.reset(lambda s: {"base.linear_velocity": cs.SX.zeros(3)}))
    motion = ocp.Motion(stop, ocp.Phase("go", here, 0.1))
    effort = ocp.Objective(ocp.regularize(feet.force, weight=0.01))
    problem = ocp.Problem(motion, RIGID.until_end(dt=0.05), effort, initial=RIGID.state())
    assert told(ProblemError, lambda: ocp.compile_problem(problem)) == (
        "phase 'stop' (HERE): its end is inside a phase of model 'mini_cheetah rigid body' - got a reset at 0.1 s, "
        "while 'mini_cheetah rigid body' covers 0 to 0.2 s, expected none there; remove it, or schedule another model "
        "at the phase's end"
    )


# ---- terms where there is no control or force


@pytest.mark.parametrize("at", ["phase_end", "end"])
@pytest.mark.parametrize("quantity", [joints.torque, feet.force, joints.acceleration])
def test_term_that_depends_on_u_or_z_at_an_end(at, quantity):
    term = ocp.regularize(quantity, at=at)
    assert told(ProblemError, lambda: robot(term)) == (
        f"term 'regularize {quantity} at {at}' (HERE): depends on control or contact force where there is none - got "
        f"at='{at}', expected at='running' or an expression of the state; change one"
    )


def test_switching_constraint_that_depends_on_the_control():
    drop = ocp.Phase("drop", "fall", 0.4, until=ocp.equality(lambda s: s.thrust, name="off"))
    assert told(ProblemError, lambda: ball(drop)).startswith(
        "term 'off' (HERE): depends on control or contact force where there is none"
    )


# ---- symbols from elsewhere


def leaked():
    return cs.SX.sym("mass_of_another")


def test_closure_leak_in_a_term():
    other = leaked()
    expected = (
        "(HERE): a symbol is not from the node's quantities - got 'mass_of_another', expected only what the function's "
        "argument supplies (or an ocp.parameter); compute it inside the function from its argument"
    )
    cost = ocp.residual(lambda s: other * s.z)
    assert told(ProblemError, lambda: ball(objective=CHEAP + cost.weighted(1.0))) == f"term 'residual' {expected}"
    row = ocp.inequality(lambda s: other * s.z, name="leak")
    assert told(ProblemError, lambda: ball(constraints=ocp.Constraints(row))) == f"term 'leak' {expected}"


def test_closure_leak_in_a_reset_map():
    other = leaked()
    drop = ocp.Phase("drop", "fall", 0.4, reset=ocp.reset(lambda s: {"vz": -other * s.vz}))
    assert told(ProblemError, lambda: ball(drop, RISE)).startswith(
        "phases 'drop' → 'rise' (HERE), reset (HERE): a symbol is not from the node's quantities - got "
        "'mass_of_another'"
    )


def test_closure_leak_in_dynamics():
    other = leaked()
    heavy = ocp.Model("heavy", state={"z": 1}, control={"push": 1}, modes={"go": lambda s: {"z": s.push / other}})
    problem = ocp.Problem(
        ocp.Motion(ocp.Phase("go", "go", 0.1)),
        heavy.until_end(dt=0.1),
        ocp.Objective(ocp.regularize("push")),
        initial=[0.0],
    )
    assert told(ProblemError, lambda: ocp.compile_problem(problem)).startswith(
        "model 'heavy' (HERE), mode 'go': a symbol is not from the node's quantities - got 'mass_of_another'"
    )


def test_two_parameters_of_one_name():
    one, two = ocp.parameter("gap", 0.1), ocp.parameter("gap", 0.2)
    rows = ocp.Constraints(ocp.inequality(lambda s: s.z - one), ocp.inequality(lambda s: s.z - two))
    assert told(ProblemError, lambda: ball(constraints=rows)) == (
        "term 'inequality' (HERE), parameter 'gap': two parameters share a name - got two objects, expected one; "
        "rename one"
    )


# ---- NaN and infinity at the initial guess


def test_value_that_is_nan():
    cost = ocp.residual(lambda s: cs.sqrt(s.z - 2)).weighted(1.0, name="depth")
    assert told(ProblemError, lambda: ball(objective=CHEAP + cost)) == (
        "term 'depth' (HERE), phase 'drop', node 0: value at the initial guess is not finite - got NaN, expected "
        "finite numbers; move the guess or the term away from the singularity"
    )


def test_value_that_is_infinite_at_a_later_node():
    row = ocp.inequality(lambda s: 1 / (s.z - 0.5), name="wall")
    drop = ocp.Phase("drop", "fall", 0.4, {"z": 0.0})
    assert told(ProblemError, lambda: ball(drop, constraints=ocp.Constraints(row))) == (
        "term 'wall lower' (HERE), phase 'drop', node 10: value at the initial guess is not finite - got infinity, "
        "expected finite numbers; move the guess or the term away from the singularity"
    )


def test_derivative_that_is_infinite():
    cost = ocp.residual(lambda s: cs.sqrt(s.vz)).weighted(1.0, name="root")
    assert told(ProblemError, lambda: ball(objective=CHEAP + cost)) == (
        "term 'root' (HERE), phase 'drop', node 0: derivative at the initial guess is not finite - got infinity, "
        "expected finite numbers; move the guess or the term away from the singularity"
    )


def test_nan_at_the_last_node():
    cost = ocp.residual(lambda s: cs.log(s.z)).weighted(1.0, name="depth", at="end")
    drop = ocp.Phase("drop", "fall", 0.4, {"z": -0.1})
    assert told(ProblemError, lambda: ball(drop, objective=CHEAP + cost)).startswith(
        "term 'depth' (HERE), phase 'drop', node 20: value at the initial guess is not finite - got NaN"
    )


def test_nan_in_the_dynamics_names_the_state():
    model = ocp.Model("tank", state={"h": 1}, control={"tap": 1}, modes={"run": lambda s: {"h": s.tap - cs.sqrt(s.h)}})
    problem = ocp.Problem(
        ocp.Motion(ocp.Phase("run", "run", 0.2)),
        model.until_end(dt=0.1),
        ocp.Objective(ocp.regularize("tap")),
        initial=[-1.0],
    )
    assert told(ProblemError, lambda: ocp.compile_problem(problem)) == (
        "dynamics of model 'tank' (HERE), next 'h', phase 'run', node 0: value at the initial guess is not finite - "
        "got NaN, expected finite numbers; move the guess or the term away from the singularity"
    )


def test_nan_in_a_reset_map():
    drop = ocp.Phase("drop", "fall", 0.4, reset=ocp.reset(lambda s: {"vz": cs.sqrt(-1 - s.vz)}))
    assert told(ProblemError, lambda: ball(drop, RISE)).startswith(
        "reset of model 'ball' (HERE), phase 'drop', node 20: value at the initial guess is not finite - got NaN"
    )


# ---- numbers that are none


def test_what_is_no_number_is_refused_by_name():
    track = ocp.track("z", weight="high", to=0.5)
    assert told(ProblemError, lambda: ball(objective=CHEAP + track)) == (
        "term 'track z' (HERE): weight is unusable - got 'high', expected numbers; give some"
    )
    assert told(ProblemError, lambda: ocp.track("z", to="high")) == (
        "term 'track z' (HERE): target is unusable - got 'high', expected numbers; give some"
    )
    assert told(ProblemError, lambda: ocp.track(3)).startswith(
        "term (HERE): is not a quantity - got 3, expected one like"
    )
    bounds = ocp.Constraints(ocp.inequality(lambda s: s.z, lower="ground", name="g"))
    assert told(ProblemError, lambda: ball(constraints=bounds)) == (
        "constraint 'g' (HERE): lower bound is unusable - got 'ground', expected numbers; give some"
    )
    assert told(ProblemError, lambda: ocp.inequality(lambda s: s.z, name="g", unit="m", scale=0)) == (
        "constraint 'g' (HERE): scale is out of range - got 0, expected a positive number [m]; give one"
    )
    assert told(ProblemError, lambda: ball(parameters={"mass": "heavy"})) == (
        "problem (HERE): parameter 'mass' is unusable - got 'heavy', expected numbers; give some"
    )
    assert told(ProblemError, lambda: ball(parameters={"mass": np.nan})).startswith(
        "problem (HERE), parameter 'mass': is not finite - got nan at entry 0"
    )


def test_symbols_instead_of_numbers():
    high = ocp.parameter("high", 2.0)
    message = (
        "got the symbol 'high', expected numbers; give numbers: they can change without a new compilation, as an "
        "ocp.parameter can"
    )
    assert told(ProblemError, lambda: ball(objective=CHEAP + ocp.track("z", weight=high))) == (
        f"term 'track z' (HERE): weight is unusable - {message}"
    )
    bounds = ocp.Constraints(ocp.inequality(lambda s: s.z, upper=2 * high, name="g"))
    assert told(ProblemError, lambda: ball(constraints=bounds)).startswith(
        "constraint 'g' (HERE): upper bound is unusable - got a CasADi expression, expected numbers"
    )


def test_weights_by_name_of_the_wrong_size():
    weights = {"FL": (1, 2), "FR": (1, 2, 3)}
    assert told(ShapeError, lambda: robot(ocp.regularize(joints.velocity, weight=weights))) == (
        "term 'regularize joints.velocity' (HERE): weight of 'FL' has the wrong size - got 2 entries, expected 1 or 3 "
        "(FL_HAA, FL_HFE, FL_KFE); give one per component or a scalar"
    )


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ("high", ", keyframe: target 'z' is unusable - got 'high', expected numbers; give some"),
        (np.inf, ": keyframe, target 'z': is not finite - got [inf], expected finite numbers; fix it"),
    ],
)
def test_keyframes_that_are_no_numbers(value, message):
    assert told(ProblemError, lambda: ball(ocp.Phase("drop", "fall", 0.4, {"z": value}))) == (
        f"phase 'drop' (HERE){message}"
    )


def test_initial_state_without_an_orientation():
    motion = ocp.Motion(ocp.Phase("stand", stance("FL FR HL HR"), 0.04))
    assert told(ProblemError, lambda: ocp.Problem(motion, BODY.until_end(dt=0.02), STAND, initial=np.zeros(37))) == (
        "problem (HERE): initial state has an invalid 'base.orientation' - got a quaternion of zeros, expected one of "
        "unit length, (1, 0, 0, 0) for no rotation; build it with the model's state()"
    )


@pytest.mark.parametrize("t0", [np.nan, np.inf])
def test_start_that_is_no_time(t0):
    assert told(ProblemError, lambda: ball(t0=t0)).startswith("horizon: start is outside the motion - got t0 = ")


def test_two_models_of_one_name():
    other = models.WholeBody(CHEETAH, baumgarte=5.0)
    assert told(ProblemError, lambda: robot(schedule=BODY.over(0.02, dt=0.02) + other.over(0.02, dt=0.02))) == (
        "schedule (HERE): two models share a name - got 'mini_cheetah' twice, expected one model, or another name; use "
        "one object, or give one of them name="
    )
    robot(schedule=BODY.over(0.02, dt=0.02) + BODY.over(0.02, dt=0.01))


# ---- what applies nowhere


def test_reset_after_which_nothing_follows():
    reset = ocp.reset(lambda s: {"vz": 0.0})
    last = ocp.Phase("rise", "fall", 0.2, reset=reset)
    assert told(ProblemError, lambda: ball(DROP, last)) == (
        "phase 'rise' (HERE): its reset applies nowhere - got the motion's last phase, expected another after it; add "
        "one, or remove the reset"
    )
    motion = ocp.Motion(DROP, last).cycles(2)  # between the cycles it applies
    ocp.compile_problem(ocp.Problem(motion, BALL.until_end(dt=0.02), CHEAP, initial=[1.0, 0.0]))


def test_component_that_a_quantity_lacks():
    row = ocp.Constraints(ocp.inequality(lambda s: s.joints.position["FL_KNEE"], name="knee"))
    assert told(ProblemError, lambda: robot(constraints=row)).startswith(
        "term 'knee' (HERE): applies nowhere - got quantity 'joints.position' of model 'mini_cheetah' has no component "
        "'FL_KNEE'"
    )


def test_term_whose_quantity_no_model_has():
    assert told(ProblemError, lambda: ball(objective=CHEAP + ocp.regularize(joints.torque))) == (
        "term 'regularize joints.torque' (HERE): applies nowhere - got model 'ball' cannot supply 'joints.torque', "
        "expected at least one model and phase; correct it or remove it"
    )


def test_quantity_that_a_robot_s_model_cannot_supply():
    motion = ocp.Motion(ocp.Phase("stand", stance("FL FR HL HR"), 0.04))
    objective = ocp.Objective(ocp.regularize(feet.force), ocp.regularize(joints.acceleration))
    problem = ocp.Problem(motion, RIGID.until_end(dt=0.02), objective, initial=RIGID.state())
    assert told(ProblemError, lambda: ocp.compile_problem(problem)) == (
        "term 'regularize joints.acceleration' (HERE): applies nowhere - got model 'mini_cheetah rigid body' cannot "
        "supply 'joints.acceleration', expected at least one model and phase; correct it or remove it"
    )


def test_misspelt_quantity_in_a_function():
    row = ocp.inequality(lambda s: s.joints.positon, name="bend")
    assert told(ProblemError, lambda: robot(constraints=ocp.Constraints(row))).startswith(
        "term 'bend' (HERE): applies nowhere - got model 'mini_cheetah' cannot supply 'joints.positon' (did you mean "
        "'joints.position'"
    )


def test_term_of_a_phase_that_does_not_exist():
    assert told(UnknownNameError, lambda: ball(objective=CHEAP + ocp.track("z", when="dorp"))) == (
        "term 'track z' (HERE): no phase 'dorp' - got 'dorp', expected one of ['drop']; did you mean 'drop'?"
    )
    weight = ocp.by_phase(1.0, raise_=2.0)
    assert told(UnknownNameError, lambda: ball(DROP, RISE, objective=CHEAP + ocp.track("z", weight))) == (
        "term 'track z' (HERE): no phase 'raise_' - got 'raise_', expected one of ['drop', 'rise']; did you mean "
        "'rise'?"
    )


def test_term_whose_predicate_selects_no_phase():
    term = ocp.track("z", when=lambda name: name == "fly")
    assert told(ProblemError, lambda: ball(objective=CHEAP + term)) == (
        "term 'track z' (HERE): applies nowhere - got it is declared for phases that its when= selects at 'running', "
        "and no such phase among 'drop' has a model that supplies it, expected at least one model and phase; correct "
        "it or remove it"
    )


def test_a_part_of_the_motion_may_lack_what_the_rest_has():
    """A receding horizon sees every part in its turn."""
    term = ocp.track("z", when="rise", to=0.5)
    ball(DROP, RISE, objective=CHEAP + term, schedule=BALL.over(0.2, dt=0.02))
    ball(DROP, RISE, objective=CHEAP + ocp.track("z", at="phase_end", to=0.5), schedule=BALL.over(0.2, dt=0.02))


def test_schedule_that_leaves_out_what_is_not_there():
    row = ocp.inequality(lambda s: s.z, name="floor")
    assert told(ProblemError, lambda: ball(schedule=BALL.until_end(dt=0.02).without(row))) == (
        "schedule (HERE), model 'ball': leaves out a term that is not in the problem - got 'floor' (HERE), expected "
        "one of its terms; pass the same object as the problem has"
    )
    assert told(ProblemError, lambda: BALL.until_end(dt=0.02).without("floor")) == (
        "schedule (HERE): without takes terms - got 'floor', expected costs, constraints or sets of them; pass the "
        "objects"
    )


def test_a_term_may_be_left_out_everywhere_on_purpose():
    row = ocp.inequality(lambda s: s.z, name="floor")
    compiled = ball(constraints=ocp.Constraints(row), schedule=BALL.until_end(dt=0.02).without(row))
    assert "left out by the schedule" in ocp.describe(compiled)


# ---- parameters


def test_parameter_that_does_not_exist():
    gap = ocp.parameter("gap", 0.1)
    rows = ocp.Constraints(ocp.inequality(lambda s: s.z - gap))
    assert told(UnknownNameError, lambda: ball(constraints=rows, parameters={"gab": 0.2})) == (
        "problem (HERE): no parameter 'gab' - got 'gab', expected one of ['gap', 'regularize thrust.weight', "
        "'inequality.lower']; did you mean 'gap'?"
    )
    message = told(UnknownNameError, lambda: robot(parameters={"mini_cheetah.terain": 0.1}))
    assert "did you mean 'mini_cheetah.terrain'" in message


def test_parameter_of_the_wrong_size():
    gap = ocp.parameter("gap", 0.1)
    rows = ocp.Constraints(ocp.inequality(lambda s: s.z - gap))
    assert told(ShapeError, lambda: ball(constraints=rows, parameters={"gap": (1, 2)})) == (
        "problem (HERE), parameter 'gap': wrong size - got 2 entries, expected 1; give as many as the present value has"
    )
    assert told(ShapeError, lambda: robot(parameters={"mini_cheetah.gravity": 9.81})) == (
        "problem (HERE), parameter 'mini_cheetah.gravity': wrong size - got 1 entries, expected 3; give as many as "
        "the present value has"
    )


def test_parameter_that_is_no_number():
    assert told(ProblemError, lambda: ocp.parameter("gap", np.nan)).startswith(
        "parameter 'gap' (HERE): value is unusable - got nan"
    )


# ---- controls without cost


def test_control_without_cost():
    assert told(ProblemError, lambda: ball(objective=ocp.Objective(ocp.track("z", to=0.5)))) == (
        "phase 'drop' (HERE), model 'ball', mode 'fall': a control has no running cost - got none on "
        "'thrust', expected at least a small "
        "one; add ocp.regularize('thrust', weight=...) to the objective"
    )


def test_one_joint_without_cost():
    motion = ocp.Motion(ocp.Phase("stand", stance("FL FR HL HR"), 0.04))
    objective = ocp.Objective(
        ocp.regularize(joints.torque, weight={"FL": 1.0, "FR": 1.0, "HL": 1.0, "HR_HAA": 1.0, "HR_HFE": 1.0})
    )
    problem = ocp.Problem(motion, BODY.until_end(dt=0.02), objective, initial=BODY.state())
    assert told(ProblemError, lambda: ocp.compile_problem(problem)).startswith(
        "phase 'stand' (HERE), model 'mini_cheetah', mode 'contact': a control has no running cost - got none on "
        "'joints.torque HR_KFE'"
    )


def test_the_small_model_s_forces_without_cost():
    """A cost that binds to the whole body alone leaves the rigid body's control free."""
    schedule = BODY.over(0.02, dt=0.02) + RIGID.over(0.02, dt=0.02)
    assert told(ProblemError, lambda: robot(schedule=schedule)).startswith(
        "phase 'stand' (HERE), model 'mini_cheetah rigid body', mode 'contact': a control has no running cost - got "
        "none on 'feet.force FL "
        "x', expected at least a small one; add ocp.regularize('feet.force', weight=...)"
    )


def test_a_cost_on_what_the_control_causes_is_a_cost():
    """Joint accelerations depend on the torque through the implicit part alone."""
    motion = ocp.Motion(ocp.Phase("fly", stance(""), 0.04))
    objective = ocp.Objective(ocp.regularize(joints.acceleration, weight=1.0))
    ocp.compile_problem(ocp.Problem(motion, BODY.until_end(dt=0.02), objective, initial=BODY.state()))


# ---- models by hand


@pytest.mark.parametrize(
    ("returned", "message"),
    [
        (
            {"z": 0},
            "{M} a state has no derivative - got ['z'], expected ['z', 'w']; return exactly these",
        ),
        (
            {"z": 0, "w": [1, 2]},
            "{M} 'w' has the wrong size - got 2, expected 1; return 1",
        ),
        (
            {"z": 0, "w": 0, "v": 0},
            "{M} unknown states - got ['v', 'w', 'z'], expected ['z', 'w']; return exactly these",
        ),
    ],
)
def test_derivatives_that_do_not_fit_the_state(returned, message):
    model = ocp.Model("m", state={"z": 1, "w": 1}, modes={"go": lambda s: returned})
    problem = ocp.Problem(
        ocp.Motion(ocp.Phase("a", "go", 0.1)), model.until_end(dt=0.1), ocp.Objective(), initial=[0, 0]
    )
    assert told((ModelError, ShapeError), lambda: ocp.compile_problem(problem)) == message.replace(
        "{M}", "model 'm' (HERE), mode 'go':"
    )


def test_models_that_are_none():
    go = {"go": lambda s: {"z": 0}}
    assert told(ModelError, lambda: ocp.Model("m", state={"z": 1}, modes={})).startswith(
        "model 'm' (HERE): no modes - got none"
    )
    assert told(ModelError, lambda: ocp.Model("m", state={"z": 1}, control={"z": 1}, modes=go)) == (
        "model 'm' (HERE): names are not unique - got ['z'] twice, expected each state, control and quantity once; "
        "rename one"
    )
    assert told(ModelError, lambda: ocp.Model("m", state={"z": 1}, modes=go, integrator="rk5")) == (
        "model 'm' (HERE): integrator is unknown - got 'rk5', expected 'euler', 'rk4' or 'discrete'; choose one"
    )


# ---- functions of terms


def test_functions_that_return_no_numbers():
    row = ocp.inequality(lambda s: s.base, name="all")
    assert told(ProblemError, lambda: robot(constraints=ocp.Constraints(row))).startswith(
        "term 'all' (HERE): the function returned a group - got a group of quantities, expected numbers; name one of "
        "them"
    )
    assert told(
        ProblemError, lambda: ball(constraints=ocp.Constraints(ocp.inequality(lambda s: None, name="none")))
    ) == ("term 'none' (HERE): the function's result is unusable - got NoneType, expected a CasADi column; return one")
    assert told(
        ShapeError, lambda: ball(constraints=ocp.Constraints(ocp.inequality(lambda s: [], name="nothing")))
    ) == ("term 'nothing' (HERE): the function returned no rows - got 0, expected at least one; return some")


def test_functions_that_fail_name_the_line_that_failed():
    def helper(value):
        return value / 0

    term = ocp.residual(lambda s: helper(1)).weighted(1.0, name="own")
    assert told(ProblemError, lambda: ball(objective=CHEAP + term)) == (
        "term 'own' (HERE): the function fails at HERE - got ZeroDivisionError: division by zero, expected an "
        "expression made with CasADi's functions; fix it"
    )
    other = cs.MX.sym("other")
    for function in (lambda s: s.z + other, lambda s: s.z[3], lambda s: 1 if s.z > 0 else 0):
        row = ocp.Constraints(ocp.inequality(function, name="own"))
        assert told(ProblemError, lambda row=row: ball(constraints=row)).startswith(
            "term 'own' (HERE): the function fails at HERE - got "
        )
    reset = ocp.Phase("drop", "fall", 0.4, reset=ocp.reset(lambda s: {"vz": helper(1)}))
    assert told(ProblemError, lambda: ball(reset, RISE)).startswith(
        "phases 'drop' → 'rise' (HERE), reset (HERE): the function fails at HERE - got ZeroDivisionError"
    )
    model = ocp.Model("m", state={"z": 1}, modes={"go": lambda s: {"z": helper(1)}})
    go = ocp.Motion(ocp.Phase("go", "go", 0.1))
    problem = ocp.Problem(go, model.until_end(dt=0.1), ocp.Objective(ocp.track("z")), initial=[0.0])
    assert told(ProblemError, lambda: ocp.compile_problem(problem)).startswith(
        "model 'm' (HERE), mode 'go': the function fails at HERE - got ZeroDivisionError"
    )


def test_masks_that_are_none():
    row = ocp.inequality(lambda s: s.feet.height, mask=lambda s: s.feet.height, name="m")
    assert told(ProblemError, lambda: robot(constraints=ocp.Constraints(row))).startswith(
        "constraint 'm' (HERE): mask depends on state or control - got an expression of x, u or z"
    )
    row = ocp.inequality(lambda s: s.feet.height, mask=lambda s: [1, 0, 1], name="m")
    assert told(ShapeError, lambda: robot(constraints=ocp.Constraints(row))).startswith(
        "constraint 'm' (HERE): mask has the wrong size - got 3 entries, expected a divisor of 4 rows"
    )
    row = ocp.inequality(lambda s: s.feet.height, mask=lambda s: 0.5 * s.feet.contact, name="m")
    assert told(ProblemError, lambda: robot(constraints=ocp.Constraints(row))).startswith(
        "term 'm 0 lower' (HERE), phase 0 'stand' (HERE), node 0: mask is invalid - got 0.5 at entry 0, expected 0 or 1"
    )


# ---- solvers and models that do not go together


class Simulator(ocp.Model):
    """A model that can only be called."""

    @property
    def has_derivatives(self):
        return False


def test_model_without_derivatives():
    simulator = Simulator("plant", state={"z": 1}, control={"push": 1}, modes={"go": lambda s: {"z": s.push}})
    problem = ocp.Problem(
        ocp.Motion(ocp.Phase("go", "go", 0.1)),
        simulator.until_end(dt=0.1),
        ocp.Objective(ocp.regularize("push")),
        initial=[0.0],
    )
    expected = (
        ", model 'plant': has no derivatives - got a model that can only be simulated, expected one whose dynamics is "
        "an expression, for MSiLQR; schedule another model, or use a sampling controller"
    )
    assert told(ProblemError, lambda: solvers.MSiLQR(problem)) == f"schedule (HERE){expected}"
    compiled = ocp.compile_problem(problem)
    assert told(ProblemError, lambda: solvers.MSiLQR(compiled)) == f"phase 'go' (HERE){expected}"


def test_a_solver_wants_a_problem():
    assert told(SolverError, lambda: solvers.MSiLQR("roll")) == (
        "MSiLQR: not a problem - got str, expected an ocp.Problem; declare one"
    )


def test_only_like_follows_like():
    assert told(ProblemError, lambda: ocp.Motion(DROP) + RISE) == (
        "motion (HERE): can be followed by a motion only - got Phase, expected an ocp.Motion; write "
        "ocp.Motion(phase, ...)"
    )
    assert told(ProblemError, lambda: BODY.over(0.1, dt=0.01) + RIGID) == (
        "schedule (HERE): can be followed by a schedule only - got SingleRigidBody, expected the schedule of a "
        "model; write model.over(duration, dt) or model.until_end(dt)"
    )
    assert told(ProblemError, lambda: BALL.until_end(dt="0.1")).startswith(
        "schedule (HERE), model 'ball': dt is out of range - got '0.1'"
    )


def test_problem_of_the_wrong_kinds():
    assert told(ProblemError, lambda: ocp.Problem(DROP, BALL.until_end(dt=0.02), CHEAP, initial=[1, 0])) == (
        "problem (HERE): motion is unusable - got Phase, expected ocp.Motion; make one"
    )
