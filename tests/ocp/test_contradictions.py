"""Rows that exclude each other are found by their values, whoever wrote them; equalities out of reach by a search."""

import casadi as cs
import numpy as np
import pytest

from piaffe import ocp

CART = ocp.Model("cart", state={"x": 1, "v": 1}, control={"push": 1}, modes={"roll": lambda s: {"x": s.v, "v": s.push}})


def found(*rows, until=None):
    """Return the warnings of a cart with these constraints."""
    motion = ocp.Motion(ocp.Phase("go", "roll", 0.5, until=until), ocp.Phase("on", "roll", 0.5))
    objective = ocp.Objective(ocp.regularize("push"))
    problem = ocp.Problem(motion, CART.until_end(dt=0.1), objective, ocp.Constraints(*rows), initial=(0.0, 0.0))
    return problem.warnings()


def least(value, **more):
    return ocp.inequality(lambda s: 3 * s.v, lower=3 * value, **more)


def most(value, **more):
    return ocp.inequality(lambda s: -s.v / 2, lower=-value / 2, **more)


@pytest.mark.parametrize(
    ("rows", "gap"),
    [
        ((least(1.0, when="on"), most(0.8, when="on")), 0.1),  # of the second row, v / 2
        ((least(1.0, when="on"), ocp.equality(lambda s: s.v - 0.9, when="on")), 0.1),
        ((ocp.equality(lambda s: s.v - 0.9, at="end"), ocp.equality(lambda s: 2 * s.v - 2.0, at="end")), 0.2),
        ((ocp.equality(lambda s: 0.5 - s.v, at="end"), most(0.2, when="on")), 0.15),
    ],
)
def test_rows_that_exclude_each_other_are_reported_with_the_gap(rows, gap):
    (warning,) = (each for each in found(*rows) if "two rows exclude each other" in each.text)
    assert float(warning.text.split(")")[1].split()[1]) == pytest.approx(gap, rel=1e-2)
    assert str(rows[1].source) in warning.where
    assert str(rows[0].source) in warning.text


@pytest.mark.parametrize(
    "rows",
    [
        (least(0.8, when="on"), most(1.0, when="on")),
        (least(1.0, when="on"), most(0.8, when="go")),
        (least(-1.0), most(2.0), ocp.equality(lambda s: s.v - 0.9, at="end")),
        (ocp.equality(lambda s: s.v - 1.0, at="end"), ocp.equality(lambda s: 2 - 2 * s.v, at="end")),
        (ocp.inequality(lambda s: s.v, lower=-np.inf, upper=2.0), ocp.inequality(lambda s: s.x + s.v, lower=-3.0)),
    ],
)
def test_rows_that_one_state_meets_are_not(rows):
    assert found(*rows) == []


def test_the_same_constraint_in_other_phases_or_on_the_other_side_is_not_twice():
    def speed(s):
        return s.v

    def limit(**more):
        return ocp.inequality(speed, **more)

    assert found(limit(upper=1.0, when="go"), limit(upper=2.0, when="on")) == []
    assert found(limit(upper=1.0), limit(lower=-1.0)) == []
    assert found(limit(upper=2.0), limit(upper=1.0, when="on")) == []  # tighter in one phase is meant
    (warning,) = found(limit(upper=2.0), limit(upper=1.0))
    assert "the constraint is declared twice - got it with upper 2 and upper 1 here and at" in warning.text


def test_an_equality_at_a_phase_end_that_no_state_meets_is_reported():
    (warning,) = found(until=ocp.equality(lambda s: cs.sin(s.x) - 1.25, unit="m", name="wave"))
    assert "it is out of reach - got 0.25 m at the nearest state" in warning.text
    assert found(until=ocp.equality(lambda s: cs.sin(s.x) - 0.75)) == []


def test_float_of_a_symbol_raises_only_in_functions_of_terms():
    constant = ocp.inequality(lambda s: s.x + float(cs.SX(2.0)), lower=-9.0)
    assert found(constant) == []
    assert np.isnan(float(cs.SX.sym("x")))  # CasADi outside is as it was
