"""Natural sizes: of units, of the components of a state, and of rows that declare a unit."""

import pytest

from piaffe import models, ocp
from piaffe.errors import ModelError
from piaffe.ocp import Sizes

from ..robots import scaled

SIZES = Sizes(length=2.0, time=3.0, mass=5.0)


@pytest.mark.parametrize(
    ("unit", "size"),
    [
        ("m", 2.0), ("m/s", 2 / 3), ("m/s^2", 2 / 9), ("rad", 1.0), ("rad/s", 1 / 3), ("rad/s^2", 1 / 9),
        ("N", 5 * 2 / 9), ("Nm", 5 * 4 / 9), ("N m", 5 * 4 / 9), ("N s", 5 * 2 / 3), ("kg m^2/s", 5 * 4 / 3),
        ("kg", 5.0), ("1/kg", 0.2), ("s^-1", 1 / 3), ("W", 5 * 4 / 27), ("", 1.0), ("furlong", 1.0),
        ("furlong/s", 1.0),
    ],
)  # fmt: skip
def test_the_size_of_a_unit_follows_from_length_time_and_mass(unit: str, size: float) -> None:
    assert SIZES.of(unit) == pytest.approx(size, rel=1e-15)
    assert Sizes().of(unit) == 1.0


@pytest.mark.parametrize("value", [0.0, -1.0, float("inf"), float("nan"), "1"])
def test_a_size_that_is_not_positive_is_refused(value: object) -> None:
    with pytest.raises(ModelError, match="sizes: time is out of range - got .*, expected a positive number"):
        Sizes(time=value)  # type: ignore[arg-type]


def test_a_state_has_the_sizes_of_its_units() -> None:
    body = models.WholeBody(models.load("mini_cheetah"))
    expected = [2.0] * 3 + [1.0] * 3 + [1.0] * 12 + [2 / 3] * 3 + [1 / 3] * 3 + [1 / 3] * 12
    assert SIZES.of_space(body.state).tolist() == pytest.approx(expected)
    assert SIZES.of_space(body.control).tolist() == pytest.approx([5 * 4 / 9] * 12)


@pytest.mark.parametrize(("scale", "size"), [(None, 0.1), (0.7, 0.7)])
def test_rows_are_divided_by_the_size_of_their_unit_unless_they_declare_a_scale(
    scale: float | None, size: float
) -> None:
    """The standing base is 0.236 lengths high."""
    body = models.WholeBody(scaled(models.load("mini_cheetah"), 0.1))
    row = ocp.inequality(lambda s: s.base.position[2], unit="m", scale=scale, name="belly")
    same = ocp.equality(lambda s: s.base.position[2] - 0.0236, unit="m", scale=scale, name="same")
    unknown = ocp.inequality(lambda s: s.base.position[2], name="no unit")
    motion = ocp.Motion(ocp.Phase("stand", models.stance(roles="all"), 0.03, ocp.Keyframe(joints="stand")))
    cost = ocp.Objective(ocp.regularize(models.joints.torque))
    problem = ocp.Problem(
        motion, body.until_end(dt=0.003), cost, ocp.Constraints(row, same, unknown), initial=body.state(joints="stand")
    )
    mode = ocp.compile_problem(problem).phases[0].mode
    assert [r.scale for r in (*mode.rows["stage_g"], *mode.rows["stage_h"])] == pytest.approx([size, 1.0, size])
