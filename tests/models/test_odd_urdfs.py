"""Odd URDF files: each loads and is right, or raises one clear error, or is warned of; never is it read in silence."""

import re

import numpy as np
import pytest

from piaffe import models, ocp
from piaffe.errors import ModelError, UnknownNameError
from tests.urdf import FEET, cart, joint, link, robot

KNEE, SHANK = r'(<joint name="l_knee".*?', r'(<link name="l_shank">.*?'
THIGH = r'(<link name="l_thigh">.*?'


def written(tmp_path, *edits, text=None, encoding="utf-8"):
    """Return the path of a file after edits (pattern, replacement), each of which must apply."""
    text = cart() if text is None else text
    for pattern, replacement in edits:
        text, count = re.subn(pattern, replacement, text, count=1, flags=re.DOTALL)
        assert count == 1, pattern
    urdf = tmp_path / "odd.urdf"
    urdf.write_bytes(text.encode(encoding))
    return urdf


ERRORS = [
    ("comma in a mass", SHANK + r'<mass value=")0.3', r"\g<1>0,3", "link 'l_shank': <inertial> is not numeric"),
    ("comma in an inertia", SHANK + r'ixx=")0.002', r"\g<1>0,002", "link 'l_shank': <inertial> is not numeric"),
    ("comma in a place", KNEE + r'xyz=")0 0 -0.25', r"\g<1>0 0 -0,25", "joint 'l_knee': origin, axis or limit is not"),
    ("comma in a centre of mass", SHANK + r'xyz=")0 0 -0.11', r"\g<1>0 0 -0,11", "link 'l_shank': <inertial> is not"),
    ("negative mass", SHANK + r'<mass value=")0.3', r"\g<1>-0.3", "link 'l_shank': mass is impossible - got -0.3 kg"),
    ("infinite mass", SHANK + r'<mass value=")0.3', r"\g<1>inf", "link 'l_shank': mass is impossible - got inf kg"),
    ("negative inertia", SHANK + r'iyy=")0.002', r"\g<1>-0.002", "link 'l_shank': inertia is not positive"),
    ("no mass", SHANK + r'<mass value=")0.3', r"\g<1>0", "joint 'l_knee': moves no mass"),
    ("reversed range", KNEE + r')lower="-2" upper="2.5"', r'\1lower="2.5" upper="-2"', "'l_knee': range is reversed"),
    ("empty range", KNEE + r')lower="-2" upper="2.5"', r'\1lower="1" upper="1"', "'l_knee': range is empty"),
    ("negative torque", KNEE + r'effort=")25', r"\g<1>-25", "joint 'l_knee': torque limit is impossible - got -25 Nm"),
    ("NaN as limit", KNEE + r'upper=")2.5', r"\g<1>nan", "joint 'l_knee': range is not numeric - got -2 to nan"),
    ("no effort", KNEE + r') effort="25"', r"\1", "joint 'l_knee': its <limit> lacks numbers - got no effort"),
    ("no limit", KNEE + r")<limit.*?/>", r"\1", "joint 'l_knee': has no <limit>"),
    ("zero axis", KNEE + r'axis xyz=")0 1 0', r"\g<1>0 0 0", "'l_knee': axis is not a unit vector .* of length 0"),
    ("two numbers as axis", KNEE + r'axis xyz=")0 1 0', r"\g<1>0 1", "joint 'l_knee': axis is not a direction"),
    (
        "planar joint",
        KNEE + r'type=")revolute',
        r"\1planar",
        "joint 'l_knee': its type is not supported - got 'planar'",
    ),
    ("floating joint", KNEE + r'type=")revolute', r"\1floating", "type is not supported - got 'floating'.* remove it"),
    (
        "mimic",
        KNEE + r")(<limit)",
        r'\1<mimic joint="r_knee" multiplier="-1"/>\2',
        r"joint 'l_knee': mimics another joint - got <mimic joint='r_knee'>.* locked=\{'l_knee': 0.0\}",
    ),
    ("link twice", r'(link name=")l_thigh"', r'\1l_shank"', "link 'l_shank': its name is not unique - got 2"),
    ("joint twice", r'(joint name=")l_pitch"', r'\1l_knee"', "joint 'l_knee': its name is not unique - got 2"),
    ("no such link", KNEE + r'parent link=")l_thigh', r"\1thigh", "joint 'l_knee': names a link that does not exist"),
    (
        "space behind a mass",
        THIGH + r'<mass value=")0.7',
        r"\g<1>0.7 ",
        "link 'l_thigh': <inertial> is not .* got ''0.7 '",
    ),
    ("mass of Python", THIGH + r'<mass value=")0.7', r"\g<1>0_7", "link 'l_thigh': <inertial> is not numeric"),
    ("unit in a mass", THIGH + r'<mass value=")0.7', r"\g<1>0.7 kg", "link 'l_thigh': <inertial> is not numeric"),
    ("hexadecimal mass", THIGH + r'<mass value=")0.7', r"\g<1>0x1", "link 'l_thigh': <inertial> is not numeric"),
    ("comma in a limit", KNEE + r'upper=")2.5', r"\g<1>2,5", "joint 'l_knee': origin, axis or limit is not numeric"),
    ("infinite torque", KNEE + r'effort=")25', r"\g<1>inf", "'l_knee': torque limit is impossible - got inf Nm"),
    ("infinite range", KNEE + r'upper=")2.5', r"\g<1>inf", "joint 'l_knee': range is not numeric - got -2 to inf"),
    ("four numbers as place", KNEE + r'xyz=")0 0 -0.25', r"\g<1>0 0 0 -0.25", "xyz='0 0 0 -0.25' of <origin> is not"),
    ("no inertia", THIGH + r")<inertia .*?/>", r"\1", "link 'l_thigh': <inertial> is not complete .* no <inertia>"),
    ("no mass tag", THIGH + r")<mass .*?/>", r"\1", "link 'l_thigh': <inertial> is not complete - got no <mass"),
    ("no product of inertia", THIGH + r') ixz="0"', r"\1", "'l_thigh': <inertial> is not complete .* without ixz"),
    ("two inertials", THIGH + r"</inertial>)", r"\1<inertial/>", "link 'l_thigh': has several <inertial> - got 2 in"),
    ("two axes", KNEE + r'<axis xyz="0 1 0"/>)', r'\1<axis xyz="1 0 0"/>', "'l_knee': has several <axis> - got 2 in"),
    ("joint without a name", r'<joint name="l_knee"', "<joint", "joint '': has no name - got 1 of that name"),
    ("robot without a name", r'<robot name="cart"', "<robot", "robot: has no name - got <robot> without 'name'"),
    ("type in capitals", KNEE + r'type=")revolute', r"\1Revolute", "its type is not supported - got 'Revolute'"),
    ("joint to itself", KNEE + r'parent link=")l_thigh', r"\1l_shank", "'l_foot', 'l_shank': is not connected to the"),
    ("joint without a child", KNEE + r')<child link="l_shank"/>', r"\1", "'l_knee': names a link that does not exist"),
    ("xacro", r"<robot name", r"<model name", "is not XML|is not a URDF"),
]


@pytest.mark.parametrize(("pattern", "replacement", "message"), [e[1:] for e in ERRORS], ids=[e[0] for e in ERRORS])
def test_an_error_of_the_doctor_raises_at_load(pattern, replacement, message, tmp_path):
    urdf = written(tmp_path, (pattern, replacement))
    with pytest.raises(ModelError, match=message) as caught:
        models.load(urdf, feet=FEET)
    assert str(caught.value).startswith(f"URDF '{urdf}': ")
    errors = [str(finding) for finding in models.diagnose(urdf, feet=FEET) if finding.severity == "error"]
    assert any(re.search(message, error) for error in errors), errors


def test_a_closed_loop_names_its_joints(tmp_path):
    urdf = written(tmp_path, text=cart(joint("brace", "r_shank", "l_shank")))
    with pytest.raises(ModelError, match=r"joint 'l_knee', 'brace': closes a loop - got 2 joints to link 'l_shank'"):
        models.load(urdf, feet=FEET)


def test_a_ring_beside_the_tree_is_found(tmp_path):
    ring = link("a", 1.0) + link("b", 1.0) + joint("ab", "a", "b") + joint("ba", "b", "a")
    with pytest.raises(ModelError, match=r"link 'a', 'b': is not connected to the base - got no path from 'trunk'"):
        models.load(written(tmp_path, text=cart(ring)), feet=FEET)


def test_two_trees_are_refused(tmp_path):
    text = cart(link("island", 1.0))
    with pytest.raises(ModelError, match=r"does not have one base link - got \['island', 'trunk'\]"):
        models.load(written(tmp_path, text=text), feet=FEET)


def test_all_errors_are_told_at_once(tmp_path):
    edits = (SHANK + r'<mass value=")0.3', r"\g<1>-1"), (r'(<joint name="r_knee".*?axis xyz=")0 1 0', r"\g<1>0 0 0")
    with pytest.raises(ModelError, match=r"(?s)link 'l_shank': mass is impossible.*joint 'r_knee': axis is not"):
        models.load(written(tmp_path, *edits), feet=FEET)


def test_bytes_that_are_not_utf_8_are_refused_unless_the_encoding_is_declared(tmp_path):
    text = cart().replace('name="cart"', 'name="Pfötchen"')
    with pytest.raises(ModelError, match=r"is not XML - got 'not well-formed"):
        models.load(written(tmp_path, text=text, encoding="latin-1"), feet=FEET)
    declared = text.replace('version="1.0"', 'version="1.0" encoding="ISO-8859-1"')
    loaded = models.load(written(tmp_path, text=declared, encoding="latin-1"), feet=FEET)
    assert loaded.name == "Pfötchen"
    assert "Pfötchen" in loaded.recipe["urdf"]


WARNINGS = [
    ("axis of length 2", KNEE + r'axis xyz=")0 1 0', r"\g<1>0 2 0", "joint 'l_knee'", "axis is not a unit vector"),
    ("no motor", KNEE + r'effort=")25', r"\g<1>0", "joint 'l_knee'", "torque limit is zero.*passive"),
    ("no speed", KNEE + r'velocity=")15', r"\g<1>0", "joint 'l_knee'", "speed limit is missing"),
    ("placeholder", KNEE + r'effort=")25', r"\g<1>1e5", "joint 'l_knee'", "torque limit looks like a placeholder"),
    ("no range", KNEE + r')lower="-2" upper="2.5"', r"\1", "joint 'l_knee'", "has no range: Piaffe treats it as unl"),
    ("range of zeros", KNEE + r')lower="-2" upper="2.5"', r'\1lower="0" upper="0"', "joint 'l_knee'", "has no range"),
    ("one end", KNEE + r') upper="2.5"', r"\1", "joint 'l_knee'", "range has one end - got lower alone: -2 to 0"),
    ("degrees", KNEE + r'xyz="0 0 -0.25")', r'\1 rpy="0 90 0"', "joint 'l_knee'", "an angle is beyond one turn .* rad"),
    ("turned body", SHANK + r'xyz="0 0 -0.11")', r'\1 rpy="180 0 0"', "link 'l_shank'", "an angle is beyond one turn"),
    ("flat body", SHANK + r'izz=")0.002', r"\g<1>0.02", "link 'l_shank'", "inertia is impossible for a rigid body"),
    ("turns", KNEE + r'upper=")2.5', r"\g<1>99", "joint 'l_knee'", "range looks like a placeholder"),
    (
        "grams",
        r'(name="trunk">.*?<mass value=")6.0',
        r"\g<1>6000",
        "robot",
        r"mass .* got 6e\+03 kg, expected .* units",
    ),
    (
        "g cm2",
        SHANK + r')ixx=".*?"/>',
        r'\g<1>ixx="20" iyy="20" izz="20" ixy="0" ixz="0" iyz="0"/>',
        "body 'l_shank'",
        "inertia does not fit",
    ),
    ("millimetres", SHANK + r'xyz=")0 0 -0.11', r"\g<1>0 0 -110", "body 'l_shank'", "centre of mass is outside"),
]


@pytest.mark.parametrize(
    ("pattern", "replacement", "where", "text"), [w[1:] for w in WARNINGS], ids=[w[0] for w in WARNINGS]
)
def test_a_warning_of_the_doctor_reaches_the_robot_and_describe(pattern, replacement, where, text, tmp_path):
    loaded = models.load(written(tmp_path, (pattern, replacement)), feet=FEET)
    (found,) = [one for one in loaded.warnings if re.search(text, one.text)]
    assert found.where == where
    body = models.SingleRigidBody(loaded)
    motion = ocp.Motion(ocp.Phase("rest", models.stance("l r"), 0.1, ocp.Keyframe(position=(0, 0, 0.4))))
    objective = ocp.Objective(
        ocp.track(models.base.position, weight=1.0), ocp.regularize(models.feet.force, weight=1e-3)
    )
    problem = ocp.Problem(motion, body.until_end(dt=0.05), objective, initial=body.state())
    described = ocp.describe(ocp.compile_problem(problem))
    assert f"robot 'cart', {where}: {found.text}" in described


def test_the_unchanged_file_has_no_warnings(tmp_path):
    assert models.load(written(tmp_path), feet=FEET).warnings == ()


def test_a_tiny_robot_is_warned_of(tmp_path):
    text = re.sub(r'mass value="(.*?)"', lambda m: f'mass value="{float(m[1]) * 1e-5}"', cart())
    found = models.load(written(tmp_path, text=text), feet=FEET).warnings
    assert any("its mass is not that of a robot - got 8.8e-05 kg" in one.text for one in found)


def test_a_joint_of_effort_zero_is_passive_and_one_without_range_is_unlimited(tmp_path):
    edits = (KNEE + r'effort=")25', r"\g<1>0"), (r'(<joint name="r_knee".*?<limit) lower="-2" upper="2.5"', r"\1")
    loaded = models.load(written(tmp_path, *edits), feet=FEET)
    knee, free = loaded.joint_names.index("l_knee"), loaded.joint_names.index("r_knee")
    assert loaded.torque_limit[knee] == 0.0
    assert loaded.torque_limit[free] == 25.0
    assert (loaded.joint_lower[free], loaded.joint_upper[free]) == (-np.inf, np.inf)


def test_an_axis_of_another_length_is_the_same_joint(tmp_path):
    plain = models.load(written(tmp_path), feet=FEET)
    scaled = models.load(written(tmp_path, (KNEE + r'axis xyz=")0 1 0', r"\g<1>0 2 0")), feet=FEET)
    index = 2 + plain.joint_names.index("l_knee")
    assert scaled.joint_axis(index) == pytest.approx(plain.joint_axis(index))


def test_a_locked_joint_is_part_of_its_link(tmp_path):
    edit = KNEE + r")(<limit)", r'\1<mimic joint="r_knee"/>\2'
    loaded = models.load(written(tmp_path, edit), feet=FEET, locked={"l_knee": 0.4})
    assert loaded.joint_names == ("l_roll", "l_pitch", "r_roll", "r_pitch", "r_knee")
    free = models.load(written(tmp_path), feet=FEET)
    angles = np.array([0.1, -0.2, 0.3, 0.2, -0.1])
    all_angles = np.array([0.1, -0.2, 0.4, 0.3, 0.2, -0.1])
    expected = models.Kinematics(free).feet(all_angles)
    assert models.Kinematics(loaded).feet(angles) == pytest.approx(expected, abs=1e-12)
    assert loaded.mass == pytest.approx(free.mass)
    with pytest.raises(UnknownNameError, match=r"locked: no joint 'knee' - got 'knee', expected one of .*'l_knee'"):
        models.load(written(tmp_path), feet=FEET, locked={"knee": 0.0})
    with pytest.raises(ModelError, match=r"locked, joint 'l_knee': not a position - got '0'"):
        models.load(written(tmp_path), feet=FEET, locked={"l_knee": "0"})


def test_links_without_mass_between_joints_are_no_error(tmp_path):
    """A universal joint is often written as joints with links without mass between them."""
    edit = r'<link name="l_hip">.*?</link>', '<link name="l_hip"/>'
    loaded = models.load(written(tmp_path, edit), feet=FEET)
    assert loaded.mass == pytest.approx(6.0 + 2 * 1.4 - 0.4)


def test_a_point_mass_on_its_axis_has_no_inertia(tmp_path):
    text = cart(
        '<link name="dot"><inertial><mass value="0.1"/><inertia ixx="0" iyy="0" izz="0" ixy="0" ixz="0" iyz="0"/>'
        "</inertial></link>" + joint("spin", "trunk", "dot", axis="0 0 1")
    )
    with pytest.raises(ModelError, match=r"joint 'spin': moves no inertia - got no inertia about its axis"):
        models.load(written(tmp_path, text=text), feet=FEET)


def test_a_base_without_mass_is_asked_for(tmp_path):
    for root in (link("world"), link("mount")):
        name = re.search(r'"(.*?)"', root)[1]
        text = robot(root + link("bar", 1.0) + joint("turn", name, "bar"))
        with pytest.raises(ModelError, match=rf"base: is not clear - got a root link '{name}' without mass.*'fixed'"):
            models.load(written(tmp_path, text=text), feet=("bar",))
        with pytest.raises(ModelError, match=r"joint 'root_joint': moves no mass"):
            models.load(written(tmp_path, text=text), feet=("bar",), base="free")
    with pytest.raises(ModelError, match=r"unknown base - got 'pinned', expected 'free' or 'fixed'"):
        models.load(written(tmp_path), feet=FEET, base="pinned")


def test_a_root_without_mass_that_is_fixed_to_the_trunk_floats(tmp_path):
    text = cart(link("base_footprint") + joint("mount", "base_footprint", "trunk", kind="fixed"))
    assert models.load(written(tmp_path, text=text), feet=FEET).mass == pytest.approx(8.8)


def test_missing_meshes_do_not_stop_a_robot(tmp_path):
    mesh = '<visual><geometry><mesh filename="package://none/trunk.stl"/></geometry></visual>'
    text = cart().replace('<link name="trunk">', f'<link name="trunk">{mesh}')
    loaded = models.load(written(tmp_path, text=text), feet=FEET)
    assert loaded.visual is None
    (finding,) = [one for one in models.diagnose(loaded.urdf, feet=FEET) if "visual" in one.where]
    assert finding.severity == "note"


def test_a_robot_of_fixed_joints_has_no_joints(tmp_path):
    text = robot(link("a", 1.0) + link("b", 1.0) + joint("ab", "a", "b", kind="fixed"))
    with pytest.raises(ModelError, match=r"has no joints - got none that moves"):
        models.load(written(tmp_path, text=text), feet=("b",))


def test_feet_that_are_not_where_their_names_say_are_warned_of(tmp_path):
    urdf = written(tmp_path)
    crossed = models.load(urdf, feet={"left": "r_foot", "right": "l_foot"}).warnings
    assert [one.where for one in crossed] == ["foot 'left', 'right'"] or len(crossed) == 2
    assert "its name and its place differ - got frame 'r_foot', right, expected a left foot" in crossed[0].text
    assert models.load(urdf, feet={"R": "r_foot", "L": "l_foot"}).warnings == ()
    assert models.load(urdf, feet={"toe": "r_foot", "heel": "l_foot"}).warnings == ()
    cheetah = models.load("mini_cheetah")
    swapped = {"FL": "HL_FOOT", "FR": "FR_FOOT", "HL": "FL_FOOT", "HR": "HR_FOOT"}
    found = models.load("mini_cheetah", feet=swapped).warnings
    assert [one.where for one in found] == ["foot 'FL'", "foot 'HL'"]
    assert "got frame 'HL_FOOT', hind, expected a front foot" in found[0].text
    assert cheetah.warnings == ()
    chosen = [models.Foot("left", "r_foot", frozenset({"left"})), models.Foot("right", "l_foot", frozenset({"right"}))]
    assert models.load(urdf, feet=chosen).warnings == ()


def test_a_foot_that_is_a_joint_s_and_a_link_s_name_is_the_link(tmp_path):
    edit = r'<joint name="l_ankle"', '<joint name="l_foot"'
    loaded = models.load(written(tmp_path, edit), feet=FEET)
    plain = models.load(written(tmp_path), feet=FEET)
    assert models.Kinematics(loaded).feet(np.full(6, 0.2)) == pytest.approx(
        models.Kinematics(plain).feet(np.full(6, 0.2))
    )


@pytest.mark.parametrize(
    ("feet", "message"),
    [
        (("l_foot", "l_foot"), r"robot 'cart', feet: are not distinct - got 'l' twice"),
        (("l_foot", "trunk"), r"foot 'trunk': is fixed to the base - got no joint between base and foot"),
    ],
)
def test_feet_that_are_none_are_refused(feet, message, tmp_path):
    with pytest.raises(ModelError, match=message):
        models.load(written(tmp_path), feet=feet)


def test_feet_that_share_a_leg_or_have_a_radius_in_millimetres_are_warned_of(tmp_path):
    found = models.load(written(tmp_path), feet=("l_foot", "l_shank", "r_foot")).warnings
    assert any("shares joints with another foot" in one.text for one in found)
    (large,) = models.load(written(tmp_path), feet=FEET, foot_radius=20).warnings
    assert "the radius is that of no foot - got 20 m, expected less than the robot's size" in large.text


def test_a_locked_position_is_within_the_range_and_the_proposed_one_is(tmp_path):
    with pytest.raises(ModelError, match=r"locked, joint 'l_knee': is beyond its range - got 2.6, expected -2 to 2.5"):
        models.load(written(tmp_path), feet=FEET, locked={"l_knee": 2.6})
    edit = KNEE + r')<limit lower="-2"', r'\1<mimic joint="r_knee"/><limit lower="0.5"'
    with pytest.raises(ModelError, match=r"locked=\{'l_knee': 0.5\}"):
        models.load(written(tmp_path, edit), feet=FEET)
    assert models.load(written(tmp_path, edit), feet=FEET, locked={"l_knee": 0.5}).num_joints == 5


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
def test_other_encodings_that_xml_declares_are_read(encoding, tmp_path):
    text = cart().replace('version="1.0"', f'version="1.0" encoding="{encoding.removesuffix("-sig")}"')
    assert models.load(written(tmp_path, text=text, encoding=encoding), feet=FEET).mass == pytest.approx(8.8)
