"""The report of units and sizes."""

import pytest

from piaffe import ocp
from piaffe.ocp.reports.units import report, weight_unit


@pytest.mark.parametrize(
    ("unit", "at", "expected"),
    [
        ("m", "running", "1/(m^2 s)"),
        ("m/s", "running", "1/((m/s)^2 s)"),
        ("Nm", "phase_end", "1/(Nm)^2"),
        ("rad", "end", "1/rad^2"),
        ("", "running", "1/s"),
        ("", "end", "1"),
    ],
)
def test_weights_have_the_unit_that_makes_the_cost_a_number(unit: str, at: str, expected: str) -> None:
    assert weight_unit(unit, at) == expected


def test_costs_and_constraints_are_measured_at_the_guess() -> None:
    cart = ocp.Model("cart", state={"p": 1, "v": 1}, control={"a": 1}, modes={"go": lambda s: {"p": s.v, "v": s.a}})
    motion = ocp.Motion(ocp.Phase("go", "go", 1.0))
    far = ocp.residual(lambda s: s.p - 3.0, unit="m").weighted(2.0, name="far")
    rail = ocp.inequality(lambda s: s.p, lower=0.5, name="rail", unit="m", scale=10.0)
    halt = ocp.equality(lambda s: s.v - 0.2, at="end", name="halt", unit="m/s")
    problem = ocp.Problem(
        motion, cart.until_end(dt=0.1), ocp.Objective(far, ocp.regularize("a", 0.1)), ocp.Constraints(rail, halt),
        initial=[1.0, 0.0],
    )  # fmt: skip
    (cost, effort), (inequality, equality) = report(ocp.compile_problem(problem))
    assert cost.cost == pytest.approx(0.5 * 2.0 * 2.0**2 * 1.0)  # p stays 1 along the guess, for one second
    assert (cost.largest, cost.weights, cost.weight_unit) == (pytest.approx(2.0), (2.0, 2.0), "1/(m^2 s)")
    assert (effort.cost, effort.largest) == (0.0, 0.0)
    assert (inequality.counted, inequality.missed, inequality.scale) == (11, 0, 10.0)
    assert (equality.counted, equality.missed, equality.worst) == (1, 1, pytest.approx(0.2))
