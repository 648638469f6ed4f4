"""Warnings that the compiled problem itself gives: orientation residuals near half a turn."""

from math import pi

import numpy as np
import pytest

from piaffe import ocp
from piaffe.ocp import rotation
from piaffe.ocp.compiler.guess_checks import Guess


def spin(s):
    return {"turn": s.rate}


def problem(*terms, angle=0.0):
    top = ocp.Model("top", state={"turn": "rotation"}, control={"rate": 3}, modes={"spin": spin})
    motion = ocp.Motion(ocp.Phase("first", "spin", 0.2), ocp.Phase("second", "spin", 0.2))
    objective = ocp.Objective(ocp.regularize("rate", weight=0.1), *terms)
    initial = rotation.np_from_rpy(np.array([angle, 0.0, 0.0]))
    return ocp.Problem(motion, top.until_end(dt=0.05), objective, initial=initial)


@pytest.mark.parametrize("angle", [2.9, -2.9, pi])
def test_a_residual_near_half_a_turn_is_reported_by_name(angle):
    term = ocp.track("turn", to=(0, 0, 0), when="second")
    (warning,) = ocp.find_warnings(ocp.compile_problem(problem(term, angle=angle)))
    assert warning.where == f"term 'track turn' ({term.source}), phase 'second', node 0"
    assert warning.text == (
        f"the residual is near half a turn - got {abs(angle):.2f} rad, expected less than 2.84 rad; beyond π the cost "
        "turns in the other direction: add a keyframe in between, or lengthen the phase"
    )


def test_it_is_shown_by_the_description():
    text = str(problem(ocp.track("turn", to=(0, 0, 0), at="end"), angle=3.0))
    assert "phase 'second', node 4: the residual is near half a turn - got 3.00 rad" in text


def test_a_smaller_residual_is_not():
    assert not ocp.find_warnings(ocp.compile_problem(problem(ocp.track("turn", to=(0, 0, 0)), angle=2.8)))


def test_a_residual_that_weighs_nothing_is_not():
    assert not ocp.find_warnings(ocp.compile_problem(problem(ocp.track("turn", weight=0.0, to=(0, 0, 0)), angle=3.0)))


def test_following_the_path_is_not():
    assert not ocp.find_warnings(ocp.compile_problem(problem(ocp.track("turn"), angle=3.0)))


def test_a_solver_asks_about_its_own_iterate():
    compiled = ocp.compile_problem(problem(ocp.track("turn", to=(0, 0, 0)), angle=0.0))
    stages = [Guess(phase).stage["residual"] for phase in compiled.phases]
    ends = [Guess(phase).terminal["residual"] for phase in compiled.phases]
    assert not ocp.half_turns(compiled, stages, [end[0] for end in ends])
    stages[1][2, 3:] = (0.0, 2.0, 2.3)
    (warning,) = ocp.half_turns(compiled, stages, [end[0] for end in ends])
    assert warning.where.endswith("phase 'second', node 2")
    assert "got 3.05 rad" in warning.text


# ---- constraints that the initial state breaks


def falling(*rows):
    ball = ocp.Model(
        "ball", state={"z": 1, "vz": 1}, control={"push": 1}, modes={"fall": lambda s: {"z": s.vz, "vz": s.push}}
    )
    motion = ocp.Motion(ocp.Phase("drop", "fall", 0.4), ocp.Phase("rise", "fall", 0.4))
    objective = ocp.Objective(ocp.regularize("push"))
    return ocp.compile_problem(
        ocp.Problem(motion, ball.until_end(dt=0.1), objective, ocp.Constraints(*rows), initial=[1.0, -2.0])
    )


def test_a_constraint_that_the_initial_state_violates_is_reported():
    high = ocp.inequality(lambda s: [s.z, s.vz], lower=(1.5, -1.0), unit="m", scale=0.5, name="high", labels=("z", "v"))
    (warning,) = ocp.find_warnings(falling(high))
    assert warning.where == f"term 'high v lower' ({high.source}), phase 'drop', node 0"
    assert warning.text == (
        "the initial state violates it - got 1 m, expected no violation; no control can change it: change the initial "
        "state or the bound, or restrict the term with when="
    )
    still = ocp.equality(lambda s: s.vz, name="still")
    (warning,) = ocp.find_warnings(falling(still))
    assert "got 2, expected" in warning.text


def test_constraints_that_do_not_hold_at_the_start_are_not_reported():
    def below(s):
        return -s.z

    assert not ocp.find_warnings(
        falling(
            ocp.inequality(below, at="end"),
            ocp.inequality(below, when="rise"),
            ocp.inequality(lambda s: -s.z + s.push),
            ocp.inequality(lambda s: s.z, lower=-1.0),
        )
    )


def test_a_warning_of_a_model_without_a_place_gets_that_of_the_problem():
    class Warned(ocp.Model):
        def warnings(self, path):
            return [ocp.ProblemWarning("model 'ball'", "is red - got red, expected green; paint it")]

    ball = Warned("ball", state={"z": 1}, control={"push": 1}, modes={"fall": lambda s: {"z": s.push}})
    motion = ocp.Motion(ocp.Phase("drop", "fall", 0.4))
    problem = ocp.Problem(motion, ball.until_end(dt=0.1), ocp.Objective(ocp.regularize("push")), initial=[1.0])
    (warning,) = problem.warnings()
    assert str(warning) == "model 'ball': is red - got red, expected green; paint it"
    assert warning.source == problem.source
