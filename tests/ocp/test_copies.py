"""A declaration copies the arrays, lists and mappings that it gets: changing them afterwards changes nothing."""

import numpy as np
import pytest

from piaffe import models, ocp, sampling

CART = ocp.Model("cart", state={"x": 1}, control={"push": 1}, modes={"roll": lambda s: {"x": s.push}})


def roll(s):
    return s.x


def first(value):
    """Return the first number in arrays, lists and mappings."""
    if isinstance(value, dict):
        return first(next(iter(value.values())))
    return first(value[0]) if isinstance(value, list) else float(np.ravel(value)[0])


@pytest.mark.parametrize(
    ("given", "declared"),
    [
        (np.ones(3), lambda given: ocp.track("x", weight=given).weight),
        ({"HAA": np.ones(1)}, lambda given: ocp.track("x", weight=given).weight),
        ([1.0, 2.0], lambda given: ocp.track("x", weight=ocp.by_phase(given, roll=given)).weight.default),
        ([1.0, 2.0], lambda given: ocp.track("x", weight=ocp.by_phase(2.0, roll=given)).weight.phases),
        (np.ones(1), lambda given: ocp.track("x", to=given).target),
        (np.ones(1), lambda given: ocp.inequality(roll, lower=given).lower),
        ([1.0], lambda given: ocp.inequality(roll, upper=given).upper),
        ({"gap": np.ones(1)}, lambda given: ocp.equality(roll, parameters=given).parameters),
        ({"gap": np.ones(1)}, lambda given: ocp.residual(parameters=given)(roll).weighted(1.0).parameters),
        ({"HAA": [1.0]}, lambda given: ocp.Keyframe(joints=given).values["joints"]),
        (np.array([1.0, 2.0]), lambda given: ocp.FromArrays(given, {"x": np.zeros(2)}).times),
        (np.ones((2, 1)), lambda given: next(iter(ocp.FromArrays([0.0, 1.0], {"x": given}).columns.values()))),
        (np.ones(2), lambda given: ocp.parameter("gap", given).value),
        ({"friction cone": 1.0}, lambda given: sampling.Options(p_max=given).p_max),
        (np.ones(1), lambda given: declare(initial=given).initial),
        ({"regularize push.weight": np.ones(1)}, lambda given: declare().with_parameters(given).parameters),
    ],
)
def test_a_declaration_keeps_its_numbers(given, declared):
    kept = declared(given)
    before = first(kept)
    overwrite(given)
    assert first(kept) == before == 1.0


def overwrite(value):
    if isinstance(value, dict):
        for key, entry in value.items():
            if isinstance(entry, float):
                value[key] = 0.25
            else:
                overwrite(entry)
    else:
        value[0] = 9.0


def declare(initial=(0.0,)):
    motion = ocp.Motion(ocp.Phase("go", "roll", 1.0))
    return ocp.Problem(motion, CART.until_end(dt=0.1), ocp.Objective(ocp.regularize("push")), initial=initial)


def test_labels_and_modes_are_copied():
    labels, modes = ["here"], {"roll": lambda s: {"x": s.push}}
    row = ocp.inequality(roll, labels=labels)
    other = ocp.Model("other", state={"x": 1}, modes=modes)
    labels[0] = "there"
    modes.clear()
    assert row.labels == ["here"]
    assert list(other.modes) == ["roll"]


def test_the_arrays_of_a_robot_cannot_be_written_to():
    robot = models.load("solo12")
    for values in (robot.poses["stand"], robot.torque_limit, robot.joint_lower, robot.joint_damping):
        with pytest.raises(ValueError, match="read-only"):
            values[0] = 9.0
    robot.pose("stand")[0] = 9.0
    assert robot.pose("stand")[0] != 9.0
