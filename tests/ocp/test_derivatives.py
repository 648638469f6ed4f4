"""Every derivative of every model, mode, term and reset agrees with differences at the rate that differences allow."""

import inspect
import math
from dataclasses import replace
from functools import cache
from typing import Any

import casadi as cs
import numpy as np
import pytest

from piaffe import models, ocp
from piaffe.errors import ProblemError
from piaffe.models import constraints, stance
from piaffe.ocp.compiler.compiled import CompiledProblem
from piaffe.ocp.compiler.functions import is_smooth
from piaffe.ocp.compiler.vectorised import Vectorised
from piaffe.ocp.reports.derivative_check import DerivativeCheck, check_derivatives
from tests.robots import ROBOTS

SHIPPED = {
    "friction_cone": constraints.friction_cone(mu=0.6),
    "torque_limits": constraints.torque_limits(),
    "joint_limits": constraints.joint_limits(),
    "joint_speed_limits": constraints.joint_speed_limits(),
    "joint_range": constraints.joint_range("FL_HAA", limit=0.5),
    "base_height": constraints.base_height(minimum=0.1, maximum=0.6),
    "foot_clearance": constraints.foot_clearance(),
}
SLOPE = models.terrain.incline(0.2, start=-math.inf, direction=0.5)
NOT_TRACKED = ("feet.contact", "feet.landing", "feet.normal")  # numbers of the node


def quantities(model: ocp.ModelBase) -> list[str]:
    """Return the paths of all quantities of a model, of two of its frames only."""
    sizes = (model.state.nx, model.control.nx, model.implicit_size("contact"))
    slots = {slot.name: cs.SX.sym(slot.name, slot.size) for slot in model.slots}
    x, u, z = (cs.SX.sym(name, size) for name, size in zip("xuz", sizes, strict=True))
    paths = model.dynamics("contact", x, u, z, {**slots, "dt": cs.SX.sym("dt")}).quantities.paths
    frames = sorted({path.split(".")[1] for path in paths if path.startswith("frames.")})
    kept = frames[:1] + frames[-1:]
    return [p for p in paths if p not in NOT_TRACKED and (not p.startswith("frames.") or p.split(".")[1] in kept)]


@ocp.residual(mask=lambda s: s.feet.landing)
def push(s: ocp.NodeView) -> cs.SX:
    """Return rows that mix impulses with the state before the impact."""
    return s.feet.impulse[2::3] * (1 + s.feet.velocity[2::3] ** 2) + s.base.position[2]


CONTROLLED = ("feet.force", "feet.contact_force", "joints.torque", "joints.acceleration", "joints.commanded_velocity")


def needs_control(path: str, model: ocp.ModelBase) -> bool:
    """Return whether a quantity depends on the control; legs without mass have no velocities in the state."""
    moves = path.endswith("velocity") and not path.startswith(("base.", "com."))
    driven = isinstance(model, models.HybridKinodynamic) and (moves or path == "feet.normal_speed")
    return path in CONTROLLED or driven


def everything(*given: ocp.ModelBase) -> ocp.Objective:
    """Return costs on every quantity that one of the models has, tracked or kept small, running and at ends."""
    paths = list(dict.fromkeys(path for model in given for path in quantities(model)))
    moving = ("base.position", "base.orientation", "base.linear_velocity", "base.angular_velocity")
    terms = [ocp.track(path) if path in moving else ocp.regularize(path) for path in paths]
    terms += [ocp.track("base.orientation", to=(0.3, -0.2, 0.1), name="tilt")]
    terms += [
        ocp.regularize(path, at="phase_end") for path in paths if not any(needs_control(path, model) for model in given)
    ]
    if any(isinstance(model, models.WholeBody) for model in given):
        terms += [ocp.regularize("feet.impulse", 0.1, at="phase_end"), push.weighted(0.1, at="phase_end")]
        terms += [models.soft_landing(0.1)]
    return ocp.Objective(*terms)


@cache
def robot(name: str) -> models.Robot:
    """Return a robot with rotors, damping and dry friction, so that no derivative of them is zero."""
    damping, friction = np.tile([0.05, 0.1, 0.2], 4), np.tile([0.2, 0.4, 1.0], 4)
    loaded = models.load(name, joint_damping=damping, joint_friction=friction)
    return replace(loaded, armature=np.tile([0.002, 0.005, 0.01], 4))


def hop(feet: tuple[str, ...]) -> ocp.Motion:
    """Stand, fly, land on two feet, then on all of them: every kind of contact set and touchdown."""
    two = " ".join((feet[0], feet[-1]))
    return ocp.Motion(
        ocp.Phase("stand", stance(" ".join(feet)), 0.04, {"rpy": (0.2, 0.1, -0.3), "joints": "crouch"}),
        ocp.Phase("flight", stance(""), 0.04, {"rpy": (0.5, -0.2, 0.2), "joints": "stand"}),
        ocp.Phase("half", stance(two), 0.04, {"rpy": (0.2, 0.3, 0.2), "joints": "crouch"}),
        ocp.Phase("stand again", stance(" ".join(feet)), 0.04, {"rpy": (0.0, 0.0, 0.0), "joints": "stand"}),
    )


def whole_body(name: str, **options: Any) -> ocp.Problem:
    body = models.WholeBody(robot(name), **options)
    limits = {**SHIPPED, "joint_range": constraints.joint_range(body.robot.joint_names[0], limit=0.5)}
    return ocp.Problem(
        hop(body.robot.foot_names), body.until_end(dt=0.02), everything(body), ocp.Constraints(*limits.values()),
        initial=body.state(joints="stand", rpy=(0.1, 0.2, 0.3)),
    )  # fmt: skip


def rigid_body(name: str, **options: Any) -> ocp.Problem:
    body = models.SingleRigidBody(robot(name), **options)
    limits = ocp.Constraints(SHIPPED["friction_cone"], SHIPPED["base_height"])
    return ocp.Problem(
        hop(body.robot.foot_names), body.until_end(dt=0.02), everything(body), limits,
        initial=body.state(rpy=(0.1, 0.2, 0.3)),
    )  # fmt: skip


def kinodynamic(name: str, **options: Any) -> ocp.Problem:
    body = models.HybridKinodynamic(robot(name), **options)
    names = ("friction_cone", "base_height", "joint_limits", "joint_speed_limits", "foot_clearance")
    return ocp.Problem(
        hop(body.robot.foot_names), body.until_end(dt=0.02), everything(body),
        ocp.Constraints(*(SHIPPED[limit] for limit in names)),
        initial=body.state(joints="stand", rpy=(0.1, 0.2, 0.3)),
    )  # fmt: skip


def cascade_of_three() -> ocp.Problem:
    """The whole body lands on two feet and becomes kinodynamic, which becomes a single rigid body."""
    chosen = (models.WholeBody, models.HybridKinodynamic, models.SingleRigidBody)
    body, legs, rest = (kind(robot("mini_cheetah")) for kind in chosen)
    objective = ocp.Objective(
        ocp.regularize("joints.torque"), ocp.regularize("joints.commanded_velocity", 0.1),
        ocp.regularize("joints.velocity", 0.1), ocp.regularize("feet.force", 0.01), ocp.track("base.orientation"),
    )  # fmt: skip
    schedule = body.over(0.08, dt=0.02) + legs.over(0.04, dt=0.02) + rest.over(0.04, dt=0.02)
    limits = ocp.Constraints(SHIPPED["friction_cone"])
    return ocp.Problem(hop(body.robot.foot_names), schedule, objective, limits, initial=body.state(joints="stand"))


def cascade() -> ocp.Problem:
    """The models meet where feet touch down: an impact, then the projection."""
    body, rest = models.WholeBody(robot("mini_cheetah")), models.SingleRigidBody(robot("mini_cheetah"))
    objective = ocp.Objective(
        ocp.regularize("joints.torque"), ocp.regularize("feet.force", 0.01), ocp.track("base.orientation"),
        push.weighted(0.1, at="phase_end"),
    )  # fmt: skip
    schedule = body.over(0.08, dt=0.02) + rest.over(0.08, dt=0.02)
    limits = ocp.Constraints(SHIPPED["friction_cone"])
    return ocp.Problem(hop(body.robot.foot_names), schedule, objective, limits, initial=body.state(joints="stand"))


def ball() -> ocp.Problem:
    restitution = ocp.parameter("restitution", 0.8)
    model = ocp.Model(
        "ball", state={"z": 1, "vz": 1}, control={"thrust": 1},
        modes={"fall": lambda s: {"z": s.vz, "vz": s.thrust - 9.81 - 0.1 * s.vz**3}},
    )  # fmt: skip
    bounce = ocp.Motion(
        ocp.Phase("drop", "fall", 0.3, until=ocp.equality(lambda s: s.z, name="ground"),
                  reset=ocp.reset(lambda s: {"vz": -restitution * s.vz * cs.exp(-0.1 * s.vz**2)})),
        ocp.Phase("rise", "fall", 0.2, {"z": 0.6}),
    )  # fmt: skip
    objective = ocp.Objective(ocp.track("z", at="end"), ocp.regularize("thrust", 0.01))
    return ocp.Problem(bounce, model.until_end(dt=0.1), objective, initial=[1.0, 0.0])


def tumbling(integrator: str) -> ocp.Problem:
    """A state with a rotation between vectors, without control."""
    inertia = cs.DM([1.0, 2.0, 4.0])

    def free(s: ocp.NodeView) -> dict[str, cs.SX]:
        return {"h": -s.h, "q": s.w, "w": -cs.cross(s.w, inertia * s.w) / inertia}

    model = ocp.Model("tumbling", state={"h": 1, "q": "rotation", "w": 3}, modes={"free": free}, integrator=integrator)  # type: ignore[arg-type]  # one of three
    motion = ocp.Motion(ocp.Phase("free", "free", 0.4, {"q": (0.4, -0.2, 3.0)}))
    objective = ocp.Objective(ocp.track("q"), ocp.track("q", at="end"), ocp.track("w", 0.1))
    return ocp.Problem(motion, model.until_end(dt=0.1), objective, initial=[1.0, 1.0, 0, 0, 0, 0.5, -1.0, 2.0])


PROBLEMS = {
    **{f"whole body of {name}": lambda name=name: whole_body(name) for name in ROBOTS},
    **{
        f"whole body, {step}": lambda step=step: whole_body("mini_cheetah", integrator=step)
        for step in ("euler", "semi_implicit")
    },
    **{f"single rigid body of {name}": lambda name=name: rigid_body(name) for name in ROBOTS},
    "single rigid body, euler": lambda: rigid_body("mini_cheetah", integrator="euler"),
    "whole body on a slope": lambda: whole_body("go2", terrain=SLOPE),
    "single rigid body on a slope": lambda: rigid_body("go2", terrain=SLOPE),
    **{f"kinodynamic model of {name}": lambda name=name: kinodynamic(name) for name in ROBOTS},
    "kinodynamic model, euler": lambda: kinodynamic("mini_cheetah", integrator="euler"),
    "kinodynamic model on a slope": lambda: kinodynamic("go2", terrain=SLOPE),
    "whole body to rigid body": cascade,
    "cascade of three models": cascade_of_three,
    "ball with a reset": ball,
    "rotation, euler": lambda: tumbling("euler"),
    "rotation, rk4": lambda: tumbling("rk4"),
}


@cache
def compiled(name: str) -> CompiledProblem:
    return ocp.compile_problem(PROBLEMS[name](), checks=False)


@cache
def findings(name: str) -> list[DerivativeCheck]:
    return check_derivatives(compiled(name), points=2)


@pytest.mark.parametrize("name", PROBLEMS)
def test_every_derivative_agrees_with_differences(name: str) -> None:
    assert [finding for finding in findings(name) if not finding.agrees] == []


@pytest.mark.parametrize("name", PROBLEMS)
def test_differences_approach_every_derivative_at_second_order(name: str) -> None:
    rates = {(f.output, f.by, f.term): f.rate for f in findings(name) if f.rate is not None}
    assert {key: rate for key, rate in rates.items() if rate < 1.9} == {}


@pytest.mark.parametrize("name", ["whole body of mini_cheetah", "whole body to rigid body", "ball with a reset"])
def test_every_term_mode_and_reset_is_compared(name: str) -> None:
    problem = compiled(name)
    where = {finding.where for finding in findings(name)}
    assert {f"model '{p.mode.model.name}', mode '{p.mode.key}'" for p in problem.phases} <= where
    assert {
        f"reset '{a.name}' → '{b.name}'"
        for a, b in zip(problem.phases[:-1], problem.phases[1:], strict=True)
        if a.resets
    } <= where
    bound = {problem.terms[k].name for phase in problem.phases for k in phase.mode.bound}
    assert bound <= {finding.term for finding in findings(name)}
    at_resets = {
        (f"reset '{a.name}' → '{b.name}'", problem.terms[k].name)
        for a, b in zip(problem.phases[:-1], problem.phases[1:], strict=True)
        if a.resets and a.transition is not None
        for k in a.transition.bound
    }
    assert at_resets <= {(finding.where, finding.term) for finding in findings(name)}
    assert {"x", "u"} <= {finding.by for finding in findings(name)}


def test_the_whole_body_is_compared_through_its_implicit_part() -> None:
    found = {(finding.output, finding.by) for finding in findings("whole body of mini_cheetah")}
    assert {("r", "x"), ("r", "u"), ("r", "z"), ("d", "z"), ("g", "z"), ("d (z)", "x"), ("d (z)", "u")} <= found
    impulses = {(f.output, f.by) for f in findings("whole body of mini_cheetah") if f.where.startswith("reset")}
    assert {("g", "z"), ("g (z)", "x"), ("residual", "x"), ("residual", "z"), ("residual (z)", "x")} <= impulses


SPLIT = [name for name in PROBLEMS if "body" in name and not name.endswith("euler")]


@pytest.mark.parametrize("name", SPLIT)
def test_the_parts_of_a_step_have_the_derivatives_of_the_whole(name: str) -> None:
    """The derivative of the whole step is taken at once, by CasADi."""
    for phase in compiled(name).phases:
        mode, model, state, rng = phase.mode, phase.mode.model, phase.mode.state, np.random.default_rng(0)
        keys = [ocp.ParameterKey("slot", slot.name, model=model.name) for slot in model.slots]
        places = [mode.layout.slices[key] for key in (*keys, ocp.ParameterKey("dt"))]
        p = {slot.name: cs.SX.sym(slot.name, slot.size) for slot in model.slots} | {"dt": cs.SX.sym("dt")}
        sizes = (state.nx, mode.nu, mode.nz, state.nx)
        x, u, z, xn = (cs.SX.sym(symbol, size) for symbol, size in zip(("x", "u", "z", "xn"), sizes, strict=True))
        dx, step = cs.SX.sym("dx", state.ndx), model.dynamics(mode.key, x, u, z, p)
        assert step.split is not None
        defect = cs.substitute(state.minus(step.next_state, xn), x, state.plus(x, dx))
        by_w, by_z = cs.jacobian(defect, cs.vertcat(dx, u)), cs.jacobian(defect, z)
        whole = cs.Function("whole", [x, u, z, cs.vertcat(*p.values()), xn, dx], [by_w, by_z])
        numbers = np.concatenate([phase.p[0][place] for place in places])
        stage_d = Vectorised(mode.functions["stage_d"])
        for _ in range(3):
            before, after = (state.np_normalise(rng.normal(size=state.nx)) for _ in range(2))
            control, implicit = rng.normal(size=mode.nu), 10 * rng.normal(size=mode.nz)
            found = stage_d(*(a[None] for a in (before, control, implicit, phase.p[0], after)))
            for index, expected in zip((1, 5), whole(before, control, implicit, numbers, after, 0), strict=True):
                np.testing.assert_allclose(found[index][0], expected.full(), rtol=1e-10, atol=1e-10)


def test_a_part_of_a_step_that_needs_another_ones_state_is_refused() -> None:
    class Wrong(models.SingleRigidBody):
        def dynamics(self, key: str, x: cs.SX, *others: cs.SX) -> ocp.Dynamics:  # type: ignore[override]  # shorter
            right = super().dynamics(key, x, *others)  # type: ignore[call-arg, arg-type]
            assert right.split is not None
            return replace(right, split=replace(right.split, finish=lambda w: w + x))

    body = Wrong(robot("solo12"))
    objective = ocp.Objective(ocp.regularize("feet.force"))
    problem = ocp.Problem(hop(body.robot.foot_names), body.until_end(dt=0.02), objective, initial=body.state())
    with pytest.raises(ProblemError, match="'finish' of the step in parts depends on more than its own state - got"):
        ocp.compile_problem(problem)


def test_every_shipped_constraint_is_among_those_compared() -> None:
    public = {
        name
        for name, function in inspect.getmembers(constraints, inspect.isfunction)
        if not name.startswith("_") and function.__module__ == constraints.__name__
    }
    assert public == set(SHIPPED)


@pytest.mark.parametrize("name", ["whole body of mini_cheetah", "ball with a reset"])
def test_at_the_guess_derivatives_are_left_out_only_of_a_smooth_implicit_part(name: str) -> None:
    phase = compiled(name).phases[0]
    stage_d, guess_d = (Vectorised(phase.mode.functions[key]) for key in ("stage_d", "guess_d"))
    z = np.full((phase.num_stages, phase.mode.nz), 0.3)
    x = phase.guess_states
    every, some = (f(x[:-1], phase.guess_controls, z, phase.p, x[1:]) for f in (stage_d, guess_d))
    by_state = slice(phase.mode.state.ndx)
    assert not np.any(some[0][:, :, by_state])
    every[0] = every[0].copy()
    every[0][:, :, by_state] = 0.0
    for all_of_it, kept in zip(every, some, strict=True):
        np.testing.assert_allclose(kept, all_of_it, rtol=1e-12, atol=1e-12)


def test_a_square_root_is_smooth_if_it_is_only_divided_by() -> None:
    x, y = cs.SX.sym("x"), cs.SX.sym("y")
    root = cs.sqrt(x)
    divided, others = (
        (1 / root, y / root, (y + 1 / root) * (2 / root)),
        (root, root / y, root + y / root, y / (1 + root)),
    )
    assert [is_smooth(cs.Function("f", [x, y], [each])) for each in divided] == [True] * 3
    assert [is_smooth(cs.Function("f", [x, y], [each])) for each in others] == [False] * 4
    assert not is_smooth(cs.Function("f", [x, y], [cs.fabs(x) * y]))


def spoilt(problem: CompiledProblem, output: str) -> CompiledProblem:
    """Return a problem in which one entry of one derivative of its first mode is off by 1e-4."""
    mode = problem.phases[0].mode
    good = mode.functions["stage_d"]
    arguments = good.sx_in()
    outputs = dict(zip(good.name_out(), good.call(arguments), strict=True))
    wrong = np.zeros(outputs[output].shape)
    wrong[0, 0] = 1e-4
    outputs[output] = outputs[output] + wrong
    bad = cs.Function("stage_d", arguments, list(outputs.values()), good.name_in(), good.name_out())
    changed = replace(mode, functions={**mode.functions, "stage_d": bad})
    phases = tuple(replace(phase, mode=changed) if phase.mode is mode else phase for phase in problem.phases)
    return replace(problem, phases=phases)


@pytest.mark.parametrize("output", ["d_w", "residual_w"])
def test_a_wrong_derivative_is_found_and_named(output: str) -> None:
    found = [f for f in check_derivatives(spoilt(compiled("ball with a reset"), output)) if not f.agrees]
    assert [f.output for f in found] == [output[:-2]]
    assert found[0].error == pytest.approx(1e-4, rel=1e-3)
    assert found[0].allowed < 1e-7


@pytest.mark.parametrize("beside", [0.0, 2e-5])
def test_a_kink_is_found(beside: float) -> None:
    model = ocp.Model("cart", state={"p": 1}, control={"v": 1}, modes={"go": lambda s: {"p": s.v}})
    motion = ocp.Motion(ocp.Phase("go", "go", 0.2))
    kink = ocp.residual(lambda s: cs.fmax(s.p - 1.0 - beside, 0)).weighted(1.0, name="kink")
    problem = ocp.Problem(motion, model.until_end(dt=0.1), ocp.Objective(kink, ocp.regularize("v")), initial=[1.0])
    found = [f for f in check_derivatives(ocp.compile_problem(problem)) if not f.agrees]
    assert [(f.term, f.by) for f in found] == [("kink", "x")]
    assert not found[0].smooth
    assert found[0].source.startswith("test_derivatives.py:")


def test_a_value_that_is_not_finite_does_not_agree() -> None:
    model = ocp.Model("cart", state={"p": 1}, control={"v": 1}, modes={"go": lambda s: {"p": s.v}})
    motion = ocp.Motion(ocp.Phase("go", "go", 0.2))
    root = ocp.residual(lambda s: cs.vertcat(cs.sqrt(s.p), 1 / s.p)).weighted(1.0, name="root")
    problem = ocp.Problem(motion, model.until_end(dt=0.1), ocp.Objective(root, ocp.regularize("v")), initial=[0.0])
    found = [f for f in check_derivatives(ocp.compile_problem(problem, checks=False)) if not f.agrees]
    assert {f.term for f in found} == {"root"}
