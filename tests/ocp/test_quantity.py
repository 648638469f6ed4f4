"""Quantities and groups: names, units, labels, and what a wrong name is told."""

import casadi as cs
import pytest

from piaffe.errors import UnknownNameError
from piaffe.ocp.language.model import Quantities
from piaffe.ocp.language.quantity import Bound, Quantity, group, match_labels

BASE = group("base", position=("m", "point"), orientation=("rad", "rotation"), angular_velocity="rad/s")
LEGS = ("FL_HAA", "FL_KFE", "FR_HAA", "FR_KFE")


def test_group_members_carry_path_unit_and_kind():
    assert BASE.position == Quantity("base.position", "m", "point")
    assert BASE.angular_velocity == Quantity("base.angular_velocity", "rad/s", "vector")
    assert str(BASE.orientation) == "base.orientation"


def test_group_takes_quantities_that_exist_already():
    height = Quantity("height", "m")
    assert group("any", height=height).height is height


def test_wrong_member_names_the_nearest():
    with pytest.raises(UnknownNameError, match=r"no quantity 'positon' - got 'positon'.*did you mean 'position'"):
        _ = BASE.positon


def test_group_leaves_python_protocols_alone():
    """Copying and pickling ask for dunder names; a quantity error there would be a puzzle."""
    assert not hasattr(BASE, "__array__")


@pytest.mark.parametrize(
    ("key", "found"),
    [("FL_HAA", [0]), ("HAA", [0, 2]), ("FL", [0, 1]), ("KFE", [1, 3])],
)
def test_labels_match_whole_prefix_or_suffix(key, found):
    assert match_labels(LEGS, key, "here") == found


def test_labels_match_stacked_feet_by_foot_and_axis():
    labels = ("FL x", "FL y", "FL z", "FR x", "FR y", "FR z")
    assert match_labels(labels, "FL", "here") == [0, 1, 2]
    assert match_labels(labels, "z", "here") == [2, 5]
    assert match_labels(labels, "FR y", "here") == [4]


def test_labels_match_no_part_of_a_word():
    with pytest.raises(UnknownNameError, match=r"here: no component 'F' - got 'F', expected one of \['FL_HAA'"):
        match_labels(LEGS, "F", "here")


def test_an_angle_that_is_no_component_names_its_axis():
    with pytest.raises(UnknownNameError, match="the components are axes; for yaw write 'z'$"):
        match_labels(("x", "y", "z"), "yaw", "here")


def test_bound_quantity_counts_components_of_a_difference():
    bound = Bound(BASE.orientation, cs.SX.sym("q", 4), ("x", "y", "z"))
    assert bound.size == 3
    assert bound.indices("y") == [1]
    with pytest.raises(UnknownNameError, match="quantity 'base.orientation': no component 'w'"):
        bound.indices("w")


def test_quantities_are_extended_by_others_and_stay_as_they_were():
    def bound(path, value):
        return Bound(Quantity(path), cs.SX(value), ("",))

    first = Quantities("ball", {"z": lambda: bound("z", 1), "vz": lambda: bound("vz", 2)}, {"force": "it is unknown"})
    more = first.extended(bound("energy", 3), bound("vz", 4))
    assert more.paths == ("z", "vz", "energy")
    assert [float(more.bind(path).value) for path in more.paths] == [1, 4, 3]
    assert first.paths == ("z", "vz")
    assert float(first.bind("vz").value) == 2
    assert more.unknown("force").hint == " (it is unknown)"
