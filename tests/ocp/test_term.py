"""Terms as values: weights in every form, phases, bounds, names and where they were declared."""

from pathlib import Path

import numpy as np
import pytest

from piaffe import ocp
from piaffe.errors import ProblemError, ShapeError, UnknownNameError

JOINTS = ("FL_HAA", "FL_KFE", "FR_HAA", "FR_KFE")
HERE = Path(__file__).name


def test_a_scalar_weight_is_for_every_row():
    assert ocp.track("q", weight=2.0).weights("any", JOINTS) == pytest.approx([2, 2, 2, 2])


def test_a_weight_per_row():
    assert ocp.track("q", weight=(1, 2, 3, 4)).weights("any", JOINTS) == pytest.approx([1, 2, 3, 4])


def test_a_weight_by_name_leaves_the_others_at_zero():
    term = ocp.track("q", weight={"HAA": 3.0, "FL_KFE": 0.5})
    assert term.weights("any", JOINTS) == pytest.approx([3, 0.5, 3, 0])


def test_a_weight_by_phase():
    term = ocp.track("q", weight=ocp.by_phase(1.0, flight={"KFE": 2.0}))
    assert term.weights("stance", JOINTS) == pytest.approx([1, 1, 1, 1])
    assert term.weights("flight", JOINTS) == pytest.approx([0, 2, 0, 2])


@pytest.mark.parametrize(
    ("when", "phases"),
    [
        (None, {"push", "flight", "land"}),
        ("flight", {"flight"}),
        (("push", "land"), {"push", "land"}),
        (lambda name: name.startswith("l"), {"land"}),
    ],
)
def test_when_chooses_phases(when, phases):
    term = ocp.regularize("u", weight=1.0, when=when)
    assert {name for name in ("push", "flight", "land") if term.weights(name, ("",))[0]} == phases


def test_wrong_weight_names_term_size_components_and_unit():
    term = ocp.track(ocp.Quantity("base.position", "m"), weight=(1, 2))
    with pytest.raises(
        ShapeError,
        match=rf"term 'track base\.position' \({HERE}:\d+\): weight has the wrong size - got 2 entries, "
        r"expected 1 or 3 \(x, y, z\) \[m\]; give one per component",
    ):
        term.weights("any", ("x", "y", "z"))


def test_weight_for_a_component_that_does_not_exist():
    with pytest.raises(UnknownNameError, match=r"no component 'FL_KFA'.*did you mean 'FL_KFE'"):
        ocp.track("q", weight={"FL_KFA": 1.0}).weights("any", JOINTS)


@pytest.mark.parametrize("weight", [-1.0, float("nan"), float("inf")])
def test_weights_that_are_no_weights(weight):
    with pytest.raises(ProblemError, match=r"weight is unusable - got \[(-1.0|nan|inf)\], expected finite numbers ≥ 0"):
        ocp.track("q", weight=weight).weights("any", ("x",))


def test_unknown_at():
    with pytest.raises(ProblemError, match=r"at= is unknown - got 'always', expected 'running', 'phase_end' or 'end'"):
        ocp.track("q", at="always")


def test_terms_know_their_line_and_their_function():
    @ocp.residual
    def hip_symmetry(s):
        return s.q

    @ocp.inequality(lower=0.03, unit="m")
    def knee_clearance(s):
        return s.z

    tracked = ocp.track("z")
    assert hip_symmetry.weighted(0.1).name == "hip_symmetry"
    assert knee_clearance.name == "knee_clearance"
    assert [str(t.source).split(":")[0] for t in (tracked, knee_clearance, hip_symmetry.weighted(1.0))] == [HERE] * 3
    assert tracked.source.line > hip_symmetry.source.line
    assert ocp.inequality(lambda s: s.z).name == "inequality"
    assert ocp.equality(lambda s: s.z, name="touch").name == "touch"
    assert ocp.residual(lambda s: s.z).weighted(1.0).name == "residual"
    assert ocp.track("z", at="end").name == "track z at end"


def test_an_inequality_without_bounds_is_positive():
    row = ocp.inequality(lambda s: s.z)
    assert (row.lower, row.upper) == (0.0, None)
    assert ocp.inequality(lambda s: s.z, upper=1.0).lower is None


def test_bounds_may_ask_the_model():
    class Model:
        limit = np.array([1.0, 2.0])

    row = ocp.inequality(lambda s: s.z, upper=lambda model: model.limit)
    assert row.bound("upper", Model(), 2) == pytest.approx([1, 2])


def test_bounds_of_the_wrong_size_name_unit_and_side():
    row = ocp.inequality(lambda s: s.z, upper=(1.0, 2.0), unit="m")
    with pytest.raises(ShapeError, match=r"upper bound is unusable - got \[1.0, 2.0\], expected 1 or 3 numbers \[m\]"):
        row.bound("upper", None, 3)


def test_bounds_that_a_model_does_not_have():
    row = ocp.inequality(lambda s: s.z, upper=lambda model: model.robot.torque_limit, name="torque limits")
    ball = ocp.Model("ball", state={"z": 1}, modes={"fall": lambda s: {"z": 0}})
    with pytest.raises(ProblemError, match=r"constraint 'torque limits' .*: model 'ball' has no such limits"):
        row.bound("upper", ball, 1)


def test_sets_add_and_flatten():
    a, b, c = ocp.track("a"), ocp.track("b"), ocp.track("c")
    assert list(ocp.Objective(a) + b + ocp.Objective(c)) == [a, b, c]
    row = ocp.inequality(lambda s: s.z)
    assert list(ocp.Constraints(ocp.Constraints(row)) + row) == [row, row]


def test_sets_refuse_what_is_no_term():
    @ocp.residual
    def height(s):
        return s.z

    with pytest.raises(
        ProblemError, match=r"objective \(.*\): not a term - got .*; give it a weight with \.weighted\(w\)"
    ):
        ocp.Objective(height)
    with pytest.raises(
        ProblemError,
        match=r"constraints \(.*\): not a term - got the cost .track z. .*, expected a Constraint; make it with",
    ):
        ocp.Constraints(ocp.track("z"))


def test_terms_of_equal_structure_share_code_whatever_their_numbers():
    def rows(s, mu):
        return mu * s.z

    def term(mu, **options):
        return ocp.inequality(rows, parameters={"mu": mu}, **options).structure()

    assert term(0.6) == term(0.7, when="flight", name="other", lower=0.3)
    assert term(0.6) != term((0.6, 0.7))
    assert term(0.6) != term(0.6, at="end")
    assert ocp.track("z", 1.0).structure() == ocp.track("z", {"": 2.0}, when="push").structure()
    assert ocp.track("z").structure() != ocp.regularize("z").structure()
