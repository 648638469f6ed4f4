"""One verb for parameters: the same names, values and errors on a problem and on what it is compiled to."""

import re

import casadi as cs
import numpy as np
import pytest

from piaffe import models, ocp
from piaffe.errors import ProblemError, ShapeError, UnknownNameError
from piaffe.ocp import CompiledProblem, ParameterKey, compile_problem
from piaffe.solvers import MSiLQR, Options

from ..problems import PROBLEMS, rope

TABLES = ("p", "p_end", "p_transition", "weight", "g_mask", "h_mask", "end_weight", "end_g_mask", "end_h_mask")


def assert_equal(one: CompiledProblem, other: CompiledProblem) -> None:
    for a, b in zip(one.phases, other.phases, strict=True):
        for name in (*TABLES, "applies", "guess_states"):
            np.testing.assert_array_equal(getattr(a, name), getattr(b, name), err_msg=f"{a.name}, {name}")
    np.testing.assert_array_equal(one.initial, other.initial)


def both(problem: ocp.Problem, values: object) -> tuple[CompiledProblem, CompiledProblem]:
    """Return a problem with other parameters, set before it is compiled and after."""
    return compile_problem(problem.with_parameters(values)), compile_problem(problem).with_parameters(values)


def near(s, reach):
    return reach - s.z


def lift(s, target):
    return s.z - target


G = ocp.parameter("g", 9.81)
DROP = ocp.Model(
    "drop", state={"z": 1, "v": 1}, control={"push": 1}, modes={"fall": lambda s: {"z": s.v, "v": s.push - G}}
)


def drop(*costs: ocp.Cost, name: str = "ceiling") -> ocp.Problem:
    """A mass falls for two phases; it has a parameter of every kind."""
    limits = ocp.Constraints(
        ocp.inequality(lambda s: s.z, lower=-9.0, upper=2.0, name=name),
        ocp.inequality(near, name="near", parameters={"reach": 3.0}),
    )
    terms = ocp.Objective(
        ocp.regularize("push", 0.1), ocp.track("z", 100.0, at="end", to=0.5, name="goal"), ocp.track("z", 0.1), *costs
    )
    motion = ocp.Motion(ocp.Phase("go", "fall", 0.3, {"z": 0.2}), ocp.Phase("rest", "fall", 0.1, {"z": 0.2}))
    return ocp.Problem(motion, DROP.until_end(dt=0.05), terms, limits, initial=[0.0, 0.0])


# ---- the same names and values


@pytest.mark.parametrize("name", PROBLEMS)
def test_every_parameter_gives_the_same_before_and_after_compiling(name: str) -> None:
    """A parameter at a time, each 1.25 times what it is, to the bit; bounds move apart."""
    problem = PROBLEMS[name]()
    compiled = compile_problem(problem)
    assert compiled.parameters
    for parameter, value in compiled.parameters.items():
        side = {"lower": -0.5, "upper": 0.5}.get(parameter.rpartition(".")[2], 0.0)
        other = {parameter: value * 1.25 + side}
        before, after = both(problem, other)
        assert_equal(before, after)
        np.testing.assert_array_equal(before.parameters[parameter], other[parameter])
        np.testing.assert_array_equal(after.parameters[parameter], other[parameter])
        if np.any(value) or side:
            pairs = zip(after.phases, compiled.phases, strict=True)
            assert any(np.any(getattr(a, t) != getattr(b, t)) for a, b in pairs for t in TABLES[:3]), parameter


def test_the_dictionary_lists_every_kind() -> None:
    assert dict(compile_problem(drop()).parameters) == {
        "g": 9.81, "regularize push.weight": 0.1, "goal.weight": 100.0, "goal.target": 0.5, "track z.weight": 0.1,
        "ceiling.lower": -9.0, "ceiling.upper": 2.0, "near.reach": 3.0, "near.lower": 0.0,
    }  # fmt: skip
    models = {name for name in compile_problem(rope()).parameters if name.startswith("rope.")}
    assert "rope.mass" in models
    assert "rope.taut" not in models  # follows from the motion


def test_names_that_are_words_may_be_keywords() -> None:
    problem = drop()
    one, other = problem.with_parameters(g=1.62), problem.with_parameters({"g": 1.62})
    assert one.parameters.keys() == other.parameters.keys() == {"g"}
    assert_equal(compile_problem(one), compile_problem(other))
    assert_equal(compile_problem(one), compile_problem(problem).with_parameters(g=1.62))
    mixed = problem.with_parameters({"near.reach": 2.0}, g=1.62).with_parameters(g=3.7)
    assert {name: value.tolist() for name, value in mixed.parameters.items()} == {"near.reach": [2.0], "g": [3.7]}
    assert problem.parameters == {}


def test_what_the_constructor_takes_is_what_the_verb_takes() -> None:
    p = drop()
    again = ocp.Problem(
        p.motion, p.schedule, p.objective, p.constraints, initial=p.initial, parameters={"goal.weight": 3.0, "g": 1.0}
    )
    assert_equal(compile_problem(again), compile_problem(p.with_parameters({"goal.weight": 3.0}, g=1.0)))


def test_a_solve_is_that_of_a_declaration_with_the_numbers() -> None:
    declared = MSiLQR(rope(limit=2.5), Options(max_iterations=5)).solve()
    values = {"force limit.upper": [2.5, 2.5], "force limit.lower": [-2.5, -2.5]}
    for compiled in both(rope(), values):
        solution = MSiLQR(compiled, Options(max_iterations=5)).solve()
        np.testing.assert_array_equal(solution.trajectory.phases[0].states, declared.trajectory.phases[0].states)
        assert [limit["upper"] for limit in solution.limits if limit["name"] == "force limit"] == [[2.5, 2.5]]


def test_limits_of_a_solution_hold_the_parameters_it_was_solved_with() -> None:
    for compiled in both(drop(), {"near.reach": 2.0}):
        solution = MSiLQR(compiled, Options(max_iterations=1)).solve()
        (limit,) = (limit for limit in solution.limits if limit["name"] == "near")
        assert limit["parameters"] == {"reach": [2.0]}


# ---- weights


def test_a_weight_that_was_zero_may_be_raised() -> None:
    off = ocp.track("v", 0.0, to=0.0, name="slow")
    for compiled in both(drop(off), {"slow.weight": 2.0}):
        assert [phase.weight[:, -1].tolist() for phase in compiled.phases] == [[2.0] * 6, [2.0] * 2]
    silent = compile_problem(drop(off).with_parameters({"goal.weight": 0.0}))
    assert silent.phases[-1].end_weight.tolist() == [0.0]
    raised = silent.with_parameters({"goal.weight": 0.0}).with_parameters({"goal.weight": 7.0})
    assert raised.phases[-1].end_weight.tolist() == [7.0]
    assert raised.phases[0].end_weight.tolist() == [0.0]  # not the end of the horizon


@pytest.mark.parametrize("weight", [ocp.by_phase(0.0, rest=3.0), ocp.by_phase({"": 0.0}, rest={"": 3.0})])
def test_a_weight_by_phase_is_replaced_where_it_is_not_zero(weight: object) -> None:
    term = ocp.track("v", weight, to=0.0, name="slow")
    for compiled in both(drop(term), {"slow.weight": 5.0}):
        assert [phase.weight[:, -1].tolist() for phase in compiled.phases] == [[0.0] * 6, [5.0] * 2]
        assert compiled.parameters["slow.weight"].tolist() == [5.0]


def test_a_term_s_parameter_may_have_the_name_of_a_part_that_it_lacks() -> None:
    """A residual has no target of its own, so that a parameter ``target`` is no other number."""
    residual = ocp.residual(parameters={"target": 0.4})(lift)
    problem = drop(residual.weighted(1.0))
    assert compile_problem(problem).parameters["lift.target"].tolist() == [0.4]
    for compiled in both(problem, {"lift.target": 0.6}):
        key = ParameterKey("parameter", "target", term=3)
        assert compiled.phases[0].p[:, compiled.phases[0].mode.layout.slices[key]].ravel().tolist() == [0.6] * 6


def test_two_parameters_of_one_name_are_refused_when_one_is_set() -> None:
    def over(s, upper):
        return upper - s.z

    row = ocp.inequality(over, lower=0.0, upper=9.0, name="over", parameters={"upper": 1.0})
    base = drop()
    problem = ocp.Problem(base.motion, base.schedule, base.objective, ocp.Constraints(row), initial=base.initial)
    compiled = compile_problem(problem)
    for call in (lambda: problem.with_parameters({"over.upper": 2.0}), lambda: compiled.parameters["over.upper"]):
        with pytest.raises(ProblemError, match="parameter 'over.upper': two parameters share a name"):
            call()


# ---- the same errors

WRONG: dict[str, tuple[object, type[Exception], str]] = {
    "size": (
        {"g": [1.0, 2.0]},
        ShapeError,
        "wrong size - got 2 entries, expected 1; give as many as the present value",
    ),
    "NaN": ({"near.reach": np.nan}, ProblemError, "is not finite - got nan at entry 0, expected finite numbers"),
    "infinite target": ({"goal.target": np.inf}, ProblemError, "is not finite - got inf at entry 0"),
    "negative weight": ({"goal.weight": -1.0}, ProblemError, "weight is unusable - got [-1.0], expected numbers ≥ 0"),
    "text": ({"goal.weight": "high"}, ProblemError, "is unusable - got 'high', expected numbers; give some"),
    "name of a term's": ({"near.reech": 1.0}, UnknownNameError, "no parameter 'near.reech' - got 'near.reech'"),
    "name": ({"gg": 1.0}, UnknownNameError, "no parameter 'gg' - got 'gg', expected one of ['g', "),
    "path": ({"track z.target": 1.0}, UnknownNameError, "no parameter 'track z.target'"),
    "bounds": ({"ceiling.lower": 3.0}, ProblemError, "model 'drop', row 0: bounds exclude each other - got lower 3"),
    "a number": (3.0, ProblemError, "parameters are unusable - got 3.0, expected a mapping from names to numbers"),
}


@pytest.mark.parametrize("what", WRONG)
def test_errors_are_the_same_before_and_after_compiling(what: str) -> None:
    values, kind, told = WRONG[what]
    problem, compiled = drop(), compile_problem(drop())
    texts = []
    for call in (lambda: compile_problem(problem.with_parameters(values)), lambda: compiled.with_parameters(values)):
        with pytest.raises(kind, match=re.escape(told)) as caught:
            call()
        where = r"^(problem \(test_parameters\.py:\d+\)|compiled problem \(test_parameters\.py:\d+\))"
        texts.append(re.sub(where, "", re.sub(r"expected one of \[.*\]", "expected one of them", str(caught.value))))
    assert texts[0] == texts[1]


@pytest.mark.parametrize("name", ["near.reech", "goal.wait", "drop.mass", "dorp.mass", "track z.target"])
def test_unknown_names_with_a_dot_are_refused_at_the_call(name: str) -> None:
    with pytest.raises(UnknownNameError, match=re.escape(f"no parameter '{name}'")) as caught:
        drop().with_parameters({name: 1.0})
    assert "'near.reach'" in str(caught.value)
    assert "'goal.weight'" in str(caught.value)


def test_values_are_refused_at_the_call() -> None:
    for values in ({"near.reach": np.nan}, {"goal.weight": -1.0}, {"g": np.inf}):
        with pytest.raises(ProblemError):
            drop().with_parameters(values)
    assert drop().with_parameters({"ceiling.upper": np.inf}).parameters["ceiling.upper"].tolist() == [np.inf]


def test_a_parameter_given_twice_is_refused() -> None:
    with pytest.raises(ProblemError, match=r"a parameter is given twice - got \['g'\]"):
        drop().with_parameters({"g": 1.0}, g=2.0)


def test_slots_that_follow_from_the_motion_are_no_parameters() -> None:
    problem, compiled = rope(), compile_problem(rope())
    told = "parameter 'rope.taut': follows from the motion - got a number for it, expected none"
    for call in (lambda: compile_problem(problem.with_parameters({"rope.taut": 1.0})),
                 lambda: compiled.with_parameters({"rope.taut": 1.0})):  # fmt: skip
        with pytest.raises(ProblemError, match=told):
            call()
    assert "rope.taut" not in compiled.parameters


def test_another_schedule_checks_the_parameters_again() -> None:
    problem = rope().with_parameters({"rope.mass": 1.5})
    assert problem.with_schedule(problem.schedule).parameters.keys() == {"rope.mass"}
    other = ocp.Model(
        "stone", state={"place": 2, "speed": 2}, control={"force": 2},
        modes=dict.fromkeys(("fly", "swing"), lambda s: {"place": s.speed, "speed": s.force}),
    )  # fmt: skip
    with pytest.raises(UnknownNameError, match=r"no parameter 'rope\.mass'"):
        problem.with_schedule(other.until_end(dt=0.01))


def test_names_of_parameters_have_no_dot() -> None:
    with pytest.raises(ProblemError, match=r"parameter 'track z\.weight' \(.*py:\d+\): name is unusable - got 'track"):
        ocp.parameter("track z.weight", 1.0)


def test_a_term_of_another_size_in_each_model_has_no_common_value() -> None:
    one = ocp.Model("one", state={"a": 1}, control={"push": 1}, modes={"go": lambda s: {"a": s.push}})
    two = ocp.Model("two", state={"b": 2}, control={"push": 2}, modes={"go": lambda s: {"b": s.push}})
    widen = ocp.reset(lambda s: {"b": cs.vertcat(s.a, s.a)})
    motion = ocp.Motion(ocp.Phase("first", "go", 0.1, reset=widen), ocp.Phase("second", "go", 0.1))
    terms = ocp.Objective(ocp.regularize("push", 0.1))
    problem = ocp.Problem(motion, one.over(0.1, dt=0.05) + two.over(0.1, dt=0.05), terms, initial=[0.0])
    for call in (lambda: compile_problem(problem.with_parameters({"regularize push.weight": 1.0})),
                 lambda: compile_problem(problem).with_parameters({"regularize push.weight": 1.0})):  # fmt: skip
        with pytest.raises(ShapeError, match="'regularize push.weight': wrong size - got 1 entries, expected 2"):
            call()


# ---- starts, old names, keys


def test_another_start_leaves_targets_and_guess() -> None:
    compiled = compile_problem(drop())
    moved = compiled.with_start([0.1, 0.0])
    assert moved.initial.tolist() == [0.1, 0.0]
    assert moved.phases[0].guess_states[0].tolist() == [0.1, 0.0]
    np.testing.assert_array_equal(moved.phases[0].guess_states[1:], compiled.phases[0].guess_states[1:])
    np.testing.assert_array_equal(moved.phases[0].p, compiled.phases[0].p)
    followed = compile_problem(drop().with_initial([0.1, 0.0]))
    assert np.any(followed.phases[0].p != compiled.phases[0].p)
    with pytest.raises(
        ShapeError, match=r"compiled problem \(.*py:\d+\): initial state has the wrong size for model 'drop'"
    ):
        compiled.with_start([0.1])


def test_old_verbs_say_the_new_ones() -> None:
    compiled = compile_problem(drop())
    with pytest.raises(AttributeError, match="CompiledProblem: 'numbers' was renamed - got 'numbers', expected 'param"):
        _ = compiled.numbers
    with pytest.raises(AttributeError, match=r"expected 'with_parameters\(values\), and with_start\(initial\) after"):
        compiled.with_numbers({"g": 1.0}, [0.0, 0.0])
    with pytest.raises(AttributeError, match="object has no attribute 'number'"):
        _ = compiled.number
    for old in ("named_numbers", "find_number", "check_value", "NamedNumber"):
        with pytest.raises(ImportError, match=f"'{old}' was renamed - got '{old}', expected 'piaffe.ocp."):
            getattr(ocp, old)


def test_keys_are_values() -> None:
    key = ParameterKey("lower", term=3)
    assert key == ParameterKey("lower", term=3)
    assert len({key, ParameterKey("lower", term=3), ParameterKey("lower", term=4)}) == 2
    assert key.is_bound
    assert key.has_bound == ParameterKey("has_lower", term=3)
    assert not ParameterKey("parameter", "lower", term=3).is_bound


def test_the_dictionary_is_a_mapping() -> None:
    parameters = compile_problem(drop()).parameters
    assert len(parameters) == len(list(parameters)) == 9
    assert "g" in parameters
    assert "h" not in parameters
    assert parameters.get("h") is None
    assert parameters.size("near.reach") == 1
    with pytest.raises(UnknownNameError, match=r"no parameter 'near\.rech' .*did you mean 'near\.reach'"):
        parameters["near.rech"]
    assert repr(parameters).startswith("Parameters({'")
    parameters["g"][:] = 0.0  # a copy
    assert parameters["g"].tolist() == [9.81]


def test_parameters_are_a_mapping_for_those_that_follow_from_the_motion_too() -> None:
    robot = models.load("mini_cheetah")
    body = models.WholeBody(robot)
    motion = ocp.Motion(ocp.Phase("stand", models.stance("FL FR HL HR"), 0.1))
    objective = ocp.Objective(ocp.regularize(models.joints.torque))
    compiled = compile_problem(ocp.Problem(motion, body.until_end(dt=0.05), objective, initial=body.state()))
    assert "mini_cheetah.contact" not in compiled.parameters
    assert compiled.parameters.get("mini_cheetah.contact") is None
    with pytest.raises(ProblemError, match="'mini_cheetah.contact': follows from the motion"):
        compiled.with_parameters({"mini_cheetah.contact": np.ones(4)})


@pytest.mark.parametrize(
    ("given", "told"),
    [([1], "parameters are unusable - got "), ({1: 2.0}, "the name of a parameter is unusable - got 1, expected text")],
)
def test_parameters_of_another_type_are_refused(given: object, told: str) -> None:
    problem = drop()
    with pytest.raises(ProblemError, match=re.escape(told)):
        problem.with_parameters(given)  # type: ignore[arg-type]  # that is what is tested
    with pytest.raises(ProblemError, match=re.escape(told)):
        compile_problem(problem).with_parameters(given)  # type: ignore[arg-type]
    with pytest.raises(ProblemError, match=re.escape(told)):
        ocp.Problem(
            problem.motion, problem.schedule, problem.objective, initial=problem.initial, parameters=given,  # type: ignore[arg-type]
        )  # fmt: skip
